//! What an entry of the catalogue says: what is done, and how a run with it may end.

use super::Campaign;
use super::bench::Bench;
use crate::virtual_robot::Options;
use core_algos::safety::Condition;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::world::faults::Fault;
use virtual_board::chip::ChipVariation;

/// Set of boards: true for a member.
pub type Boards = fn(Role) -> bool;
/// All boards.
pub const ALL: Boards = |_| true;
/// The boards of the axles.
pub const AXLES: Boards = |board| !board.is_beam();
/// The boards of the frames.
pub const BEAM: Boards = Role::is_beam;

/// Entries of the catalogue: name, seam, run with its acts, then how it may end.
macro_rules! entries {
    ($($name:literal, $seam:literal, $run:ident($acts:expr)$(.$end:ident($($argument:expr),*))*;)*) => {
        vec![$($crate::virtual_robot::faults::entry::Entry::$run($name, $seam, $acts)
            $(.$end($($argument),*))*),*]
    };
}

pub(super) use entries;

/// Something that is done to the robot.
pub type Act = fn(&mut Bench);

/// An act, so long after the fault's beginning.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    pub after_ms: u64,
    pub act: Act,
}

/// An act at this time.
pub const fn at(after_ms: u64, act: Act) -> Step {
    Step { after_ms, act }
}

/// A trial of one board by itself: how many cases there were, or what went wrong.
pub type Alone = fn(&Campaign, u64) -> Result<Result<usize, String>, Error>;

/// A look at the robot at the end of a run: what is wrong, in words.
pub type Check = fn(&mut Bench) -> Option<String>;

/// Kind of run.
#[derive(Clone, Debug)]
pub enum Course {
    /// The robot drives, then these acts follow.
    Drive(Vec<Step>),
    /// Acts from the moment on at which the boards' power comes on; the button is pressed once all are
    /// ready, if they get ready within the time allowed, else at its end.
    Start(Vec<Step>),
    /// One board by itself.
    Alone(Alone),
    /// The robot drives to its goal, its boards in this process, with this fault of samples, frames or plant.
    Model(Fault),
}

/// A fault and what may follow from it.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name in tables.
    pub name: &'static str,
    /// Place of the fault.
    pub seam: &'static str,
    /// The run.
    pub course: Course,
    /// True if the robot may drive on.
    pub goes_on: bool,
    /// Codes that may be the first reason of a stop; none if it may not stop.
    pub codes: Vec<Condition>,
    /// Longest time from the fault to all motors off, s.
    pub off_within_s: f64,
    /// Longest time from the fault to the last pulse of the struck axle's drivers, s.
    pub own_within_s: Option<f64>,
    /// The board that is struck must have restarted and must say so.
    pub restarts: bool,
    /// Boards that may be reset.
    pub resets: Boards,
    /// The struck board must be.
    pub must_reset: bool,
    /// The robot may start although not all nodes are heard to be ready.
    pub unready: bool,
    /// Notice that the affected board must report.
    pub notice: Option<Condition>,
    /// Check at the end.
    pub check: Option<Check>,
    /// Findings that the fault itself brings about: what their texts contain.
    pub findings: &'static [&'static str],
    /// Time without current that counts as off, ms.
    pub rest_ms: u64,
    /// Frequency error of the boards' crystals, parts in 10⁹; drawn for the other boards.
    pub fast_ppb: Vec<(Role, i64)>,
    /// Power-on delay of boards, ms; 0 for the other boards.
    pub late_ms: Vec<(Role, u64)>,
    /// Changes a chip beyond what the seed draws.
    pub vary: fn(Role, &mut ChipVariation),
}

/// Longest time that a stop takes: the slowest fault is noticed 0.1 s after it came, and a stop ends
/// with motors off 2 s later at the latest (`supervisor::Config::stop_timeout_s`).
pub const STOP_S: f64 = 2.2;

impl Entry {
    fn new(name: &'static str, seam: &'static str, course: Course) -> Self {
        Self {
            name,
            seam,
            course,
            goes_on: false,
            codes: Vec::new(),
            off_within_s: STOP_S,
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

    /// Options of its boards.
    pub fn options(&self) -> Options {
        Options {
            late_ms: self.late_ms.clone(),
            fast_ppb: self.fast_ppb.clone(),
            vary: self.vary,
            ..Options::default()
        }
    }

    /// One act while the robot drives.
    pub fn drive(name: &'static str, seam: &'static str, act: Act) -> Self {
        Self::steps(name, seam, &[at(0, act)])
    }

    /// Several acts, the first of them while the robot drives.
    pub fn steps(name: &'static str, seam: &'static str, steps: &[Step]) -> Self {
        Self::new(name, seam, Course::Drive(steps.to_vec()))
    }

    /// Acts from power on.
    pub fn start(name: &'static str, seam: &'static str, steps: &[Step]) -> Self {
        Self::new(name, seam, Course::Start(steps.to_vec()))
    }

    /// A trial of one board.
    pub fn alone(name: &'static str, seam: &'static str, trial: Alone) -> Self {
        Self::new(name, seam, Course::Alone(trial)).goes_on()
    }

    /// A fault of samples, frames or plant of a robot whose boards run in this process.
    pub fn model(name: &'static str, seam: &'static str, fault: Fault) -> Self {
        Self::new(name, seam, Course::Model(fault))
    }

    /// True if it needs the images of the boards.
    pub fn needs_images(&self) -> bool {
        !matches!(self.course, Course::Model(_))
    }

    /// The robot may drive on.
    pub fn goes_on(mut self) -> Self {
        self.goes_on = true;
        self
    }

    /// It may stop for one of these, too.
    pub fn stops(mut self, codes: &[Condition]) -> Self {
        self.codes.extend(codes);
        self
    }

    /// All motors are off after so long.
    pub fn within(mut self, seconds: f64) -> Self {
        self.off_within_s = seconds;
        self
    }

    /// The drivers of the struck axle give no pulse after so long.
    pub fn own_within(mut self, seconds: f64) -> Self {
        self.own_within_s = Some(seconds);
        self
    }

    /// The struck board restarts and says so.
    pub fn restarts(mut self) -> Self {
        self.restarts = true;
        self.resets(ALL)
    }

    /// These boards may be reset.
    pub fn resets(mut self, boards: Boards) -> Self {
        self.resets = boards;
        self
    }

    /// The struck board is reset.
    pub fn must_reset(mut self) -> Self {
        self.must_reset = true;
        self.resets(ALL)
    }

    /// It may start although not all nodes are heard to be ready.
    pub fn unready(mut self) -> Self {
        (self.goes_on, self.unready) = (true, true);
        self
    }

    /// The struck board gives this notice.
    pub fn notices(mut self, condition: Condition) -> Self {
        self.notice = Some(condition);
        self
    }

    /// This is looked at, too.
    pub fn check(mut self, check: Check) -> Self {
        self.check = Some(check);
        self
    }

    /// Findings with these words are the fault's.
    pub fn finds(mut self, texts: &'static [&'static str]) -> Self {
        self.findings = texts;
        self
    }

    /// A board's crystal is fast.
    pub fn fast(mut self, role: Role, ppb: i64) -> Self {
        self.fast_ppb.push((role, ppb));
        self
    }

    /// Chips are others.
    pub fn vary(mut self, vary: fn(Role, &mut ChipVariation)) -> Self {
        self.vary = vary;
        self
    }

    /// A board's power comes on later than that of the others, ms.
    pub fn late(mut self, role: Role, ms: u64) -> Self {
        self.late_ms.push((role, ms));
        self
    }
}
