//! Fault of the catalogue: its name, its run and the permitted outcomes.

use super::bench::FaultBench;
use super::{AXLE, Campaign, frame};
use crate::virtual_robot::Options;
use core_algos::safety::Condition;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::world::faults::Fault;
use virtual_board::chip::ChipVariation;

/// Set of boards: true for a member.
pub type Boards = fn(Role) -> bool;
/// All boards.
pub const ALL: Boards = |_| true;
/// Axle boards.
pub const AXLES: Boards = |board| !board.is_beam();
/// Beam boards.
pub const BEAM: Boards = Role::is_beam;

/// List of faults: each has a name, the component or signal at fault, a run with its acts, then permitted outcomes.
macro_rules! entries {
    ($($name:literal, $seam:literal, $run:ident($acts:expr)$(.$end:ident($($argument:expr),*))*;)*) => {
        vec![$($crate::virtual_robot::faults::entry::Entry::$run($name, $seam, $acts)
            $(.$end($($argument),*))*),*]
    };
}

pub(super) use entries;

/// Act of a fault on the robot, such as a cut wire.
pub type Act = fn(&mut FaultBench);

/// An act at `after_ms` after the start of the fault.
#[derive(Clone, Copy, Debug)]
pub struct TimedAct {
    pub after_ms: u64,
    pub act: Act,
}

/// An act at `after_ms` after the start of the fault.
pub const fn at(after_ms: u64, act: Act) -> TimedAct {
    TimedAct { after_ms, act }
}

/// Trial of a single board. Outer error: the trial could not run. Inner result: number of cases, or description of the
/// failure.
pub type BoardTrial = fn(&Campaign, u64) -> Result<Result<usize, String>, Error>;

/// Check of the robot at the end of a run: description of the problem; `None` without one.
pub type Check = fn(&mut FaultBench) -> Option<String>;

/// How a fault is run, with its acts.
#[derive(Clone, Debug)]
pub enum RunKind {
    /// The robot drives; then these acts follow.
    Drive(Vec<TimedAct>),
    /// Acts from power-on. The button is pressed once all nodes are ready, or after the time allowed for that.
    Start(Vec<TimedAct>),
    /// Trial of a single board.
    BoardTrial(BoardTrial),
    /// The robot drives to its goal with its boards in this process and this fault of samples, frames or plant.
    Model(Fault),
}

/// A fault and its permitted outcomes.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name of the fault in tables; `{axle}` and `{frame}` in the lists are the names of the struck boards.
    pub name: String,
    /// Component or signal at which the fault occurs.
    pub seam: &'static str,
    /// How the fault is run, with its acts.
    pub kind: RunKind,
    /// True if the robot may continue.
    pub goes_on: bool,
    /// Permitted first reasons of a stop; empty if the robot may not stop.
    pub codes: Vec<Condition>,
    /// Limit of the time from the fault until all motors are off, s.
    pub off_within_s: f64,
    /// Addition to this limit for a robot of three or more axles, s.
    pub longer_in_chain_s: f64,
    /// Limit of the time from the fault to the last PWM pulse of the affected axle, s; `None` without a limit.
    pub own_within_s: Option<f64>,
    /// True if the affected board must restart and report the restart.
    pub restarts: bool,
    /// Boards that may be reset.
    pub resets: Boards,
    /// True if the affected board must be reset.
    pub must_reset: bool,
    /// True if the robot may start before all nodes report ready.
    pub unready: bool,
    /// Notice that the affected board must report; `None` if none is demanded.
    pub notice: Option<Condition>,
    /// Check of the robot at the end of the run; `None` without a check.
    pub check: Option<Check>,
    /// Findings that the fault itself causes, each given by a part of its text.
    pub findings: &'static [&'static str],
    /// Time without current after which a motor counts as off, ms.
    pub rest_ms: u64,
    /// Frequency errors of the listed boards' crystals, parts in 10⁹; the other boards get random errors.
    pub fast_ppb: Vec<(Role, i64)>,
    /// Power-on delays of the listed boards, ms; the other boards have no delay.
    pub late_ms: Vec<(Role, u64)>,
    /// Changes a chip after the random draw.
    pub vary: fn(Role, &mut ChipVariation),
}

/// Moves a fault of samples, frames or plant to the second axle or the frame behind it.
fn inside(fault: &mut Fault, robot: Topology) {
    match fault {
        Fault::Bus(config) => {
            let late = config.late_ms.first().copied();
            if let Some(late) = late {
                config.late_ms = vec![late; robot.board_count()];
            }
        }
        Fault::Loss(board) if board.is_beam() => *board = Role::Beam(frame(robot)),
        Fault::EncoderStuck(wheel)
        | Fault::EncoderMissing(wheel)
        | Fault::EncoderJumps { wheel, .. }
        | Fault::MotorWeak { wheel, .. }
        | Fault::MotorStuckOn { wheel, .. }
        | Fault::WheelLifted(wheel) => wheel.axle = AXLE.index(),
        Fault::EncodersSwapped(axle)
        | Fault::GyroNotANumber(axle)
        | Fault::GyroBias { axle, .. }
        | Fault::AccelerometerMissing(axle)
        | Fault::Reported { axle, .. } => *axle = AXLE.index(),
        Fault::GaugeRail { .. }
        | Fault::GaugeStuck(_)
        | Fault::GaugesShifted(_)
        | Fault::GaugeDrift { .. }
        | Fault::FrameSnapped => {
            *fault = Fault::OfFrame {
                frame: frame(robot).index(),
                fault: Box::new(fault.clone()),
            };
        }
        Fault::None
        | Fault::Reset { .. }
        | Fault::Loss(_)
        | Fault::Freeze { .. }
        | Fault::SlowClock { .. }
        | Fault::OfFrame { .. } => {}
    }
}

/// Limit of the time of a stop, s: the slowest fault is detected after 0.1 s, and the motors are off at most 2 s later
/// (`supervisor::Config::stop_timeout_s`).
pub const STOP_S: f64 = 2.2;

impl Entry {
    fn new(name: &str, seam: &'static str, kind: RunKind) -> Self {
        Self {
            name: name.to_owned(),
            seam,
            kind,
            goes_on: false,
            codes: Vec::new(),
            off_within_s: STOP_S,
            longer_in_chain_s: 0.0,
            own_within_s: None,
            restarts: false,
            resets: |_| false,
            must_reset: false,
            unready: false,
            notice: None,
            check: None,
            findings: &[],
            rest_ms: 250,
            fast_ppb: Vec::new(),
            late_ms: Vec::new(),
            vary: |_, _| {},
        }
    }

    /// The fault at an axle or frame of `robot`: at that of [`AXLE`] and [`frame`]. Faults of the front board remain
    /// faults of the front board.
    pub(super) fn of(mut self, robot: Topology) -> Self {
        let struck = Role::Beam(frame(robot));
        let name = self.name.replace("{axle}", robot.name(Role::Axle(AXLE)));
        self.name = name.replace("{frame}", robot.name(struck));
        let beam = |role: &mut Role| {
            if role.is_beam() {
                *role = struck;
            }
        };
        self.fast_ppb.iter_mut().for_each(|(role, _)| beam(role));
        self.late_ms.iter_mut().for_each(|(role, _)| beam(role));
        if robot != Topology::PAIR {
            self.off_within_s += self.longer_in_chain_s;
            if let RunKind::Model(fault) = &mut self.kind {
                inside(fault, robot);
            }
        }
        self
    }

    /// Options of the boards for this fault.
    pub fn options(&self) -> Options {
        Options {
            late_ms: self.late_ms.clone(),
            fast_ppb: self.fast_ppb.clone(),
            vary: self.vary,
            ..Options::default()
        }
    }

    /// Run with one act while the robot drives.
    pub fn drive(name: &str, seam: &'static str, act: Act) -> Self {
        Self::steps(name, seam, &[at(0, act)])
    }

    /// Run with several acts; the first occurs while the robot drives.
    pub fn steps(name: &str, seam: &'static str, steps: &[TimedAct]) -> Self {
        Self::new(name, seam, RunKind::Drive(steps.to_vec()))
    }

    /// Run from power-on with these acts.
    pub fn start(name: &str, seam: &'static str, steps: &[TimedAct]) -> Self {
        Self::new(name, seam, RunKind::Start(steps.to_vec()))
    }

    /// Run that is a trial of a single board.
    pub fn board_trial(name: &str, seam: &'static str, trial: BoardTrial) -> Self {
        Self::new(name, seam, RunKind::BoardTrial(trial)).goes_on()
    }

    /// Run of a robot with its boards in this process and a fault of samples, frames or plant.
    pub fn model(name: &str, seam: &'static str, fault: Fault) -> Self {
        Self::new(name, seam, RunKind::Model(fault))
    }

    /// True if the run needs the images of the boards.
    pub fn needs_images(&self) -> bool {
        !matches!(self.kind, RunKind::Model(_))
    }

    /// Permits the robot to continue.
    pub fn goes_on(mut self) -> Self {
        self.goes_on = true;
        self
    }

    /// Permits a stop for one of these reasons.
    pub fn stops(mut self, codes: &[Condition]) -> Self {
        self.codes.extend(codes);
        self
    }

    /// Sets the limit of the time until all motors are off, s.
    pub fn within(mut self, seconds: f64) -> Self {
        self.off_within_s = seconds;
        self
    }

    /// Extends the limit of the time until all motors are off for a robot of three or more axles, s.
    pub fn longer_in_chain(mut self, seconds: f64) -> Self {
        self.longer_in_chain_s = seconds;
        self
    }

    /// Sets the limit of the time to the last PWM pulse of the affected axle, s.
    pub fn own_within(mut self, seconds: f64) -> Self {
        self.own_within_s = Some(seconds);
        self
    }

    /// Demands that the affected board restarts and reports the restart.
    pub fn restarts(mut self) -> Self {
        self.restarts = true;
        self.resets(ALL)
    }

    /// Permits resets of these boards.
    pub fn resets(mut self, boards: Boards) -> Self {
        self.resets = boards;
        self
    }

    /// Demands a reset of the affected board.
    pub fn must_reset(mut self) -> Self {
        self.must_reset = true;
        self.resets(ALL)
    }

    /// Permits a start before all nodes report ready.
    pub fn unready(mut self) -> Self {
        (self.goes_on, self.unready) = (true, true);
        self
    }

    /// Demands this notice of the affected board.
    pub fn notices(mut self, condition: Condition) -> Self {
        self.notice = Some(condition);
        self
    }

    /// Adds a check at the end of the run.
    pub fn check(mut self, check: Check) -> Self {
        self.check = Some(check);
        self
    }

    /// Permits findings that contain one of these texts.
    pub fn finds(mut self, texts: &'static [&'static str]) -> Self {
        self.findings = texts;
        self
    }

    /// Sets the frequency error of a board's crystal, parts in 10⁹.
    pub fn fast(mut self, role: Role, ppb: i64) -> Self {
        self.fast_ppb.push((role, ppb));
        self
    }

    /// Sets the function that changes the chips after the random draw.
    pub fn vary(mut self, vary: fn(Role, &mut ChipVariation)) -> Self {
        self.vary = vary;
        self
    }

    /// Delays the power-on of a board, ms.
    pub fn late(mut self, role: Role, ms: u64) -> Self {
        self.late_ms.push((role, ms));
        self
    }
}
