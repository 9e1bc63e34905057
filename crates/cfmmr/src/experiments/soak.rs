//! Hours of driving from goal to goal, with all sensors, all noise and a bus that loses frames: consistency of the
//! estimator, faults and memory, window by window.
//!
//! The robot drives to random goals in a square, without a restart of any node. Position is by dead reckoning, so its
//! covariance grows. At each goal the estimate is compared with the truth (NEES). Successive NEES are correlated, so
//! only the last window is checked, not the trend. Innovations are independent, so the trend of their NIS is checked.
//! The zeros of the gauges drift, so the error of the relative posture of the axles grows for hours: its rms over the
//! run is checked.

use core_algos::fusion::ekf::Verdict;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::safety::OperatingState;
use core_algos::time::{EPOCH, Micros, TICK};
use core_algos::topology::Node;
use host_sim::base::error::Error;
use host_sim::base::statistics;
use host_sim::base::statistics::nees;
use host_sim::base::statistics::square;
use host_sim::run::drive::{DriveTask, Progress, drive};
use host_sim::run::end::EndKind;
use host_sim::run::robot::{Record, Robot};
use host_sim::scenario::Scenario;
use host_sim::targets::HostCommand;
use host_sim::world::random::{Stream, generator};
use rand::RngExt;
use rand_pcg::Pcg64;
use serde::Serialize;
use std::collections::BTreeMap;

/// Time limit for one goal, ticks.
const GOAL_TIMEOUT: u64 = 60_000;
/// Time at rest after a goal, ticks.
const REST_TICKS: u64 = 500;
/// Time from clearing a fault to the next goal, ticks.
const RECOVERY_TICKS: u64 = 2_000;
/// Half the side of the square in which goals are drawn, m.
const SQUARE_M: f64 = 1.5;
/// Number of equal pieces of a run. The mean NIS of each piece gives the trend.
const PIECES: u64 = 200;
/// Limit of memory growth after the first window, KiB.
pub const MAX_MEMORY_GROWTH_KIB: u64 = 1024;
/// Rise of the NIS over the run, divided by its mean. A smaller rise is never a failure.
pub const DRIFT_SHARE: f64 = 0.1;
/// Ticks of the shortest run with a check of the trend. In a shorter run, the motions in its pieces differ too much.
pub const MIN_TREND_TICKS: u64 = 300_000;
/// Limit of the rms error of the relative position of the axles, m. In 20 seeds over 50 s: mean 1.2 mm, largest 1.6 mm;
/// 1.9 mm after hours.
pub const MAX_RELATIVE_ERROR_M: f64 = 2.5e-3;
/// Limit of the rms error of the relative heading, rad. In 20 seeds over 50 s: mean 5.9 mrad, largest 8.0 mrad.
pub const MAX_RELATIVE_ERROR_RAD: f64 = 10e-3;

/// Limit of the mean NEES in the last window: 99.9 % quantile of χ² with three degrees of freedom.
const MAX_END_NEES: f64 = 16.27;

/// Scenario of the soak: all sensors, all noise; with in-process boards the bus loses at least 1 % of the frames.
pub fn scenario(
    world: Option<&str>,
    changes: &[String],
    in_process: bool,
) -> Result<Scenario, Error> {
    let mut scenario = Scenario::parse(world, "", "scenario", changes)?;
    scenario.mission.settle_s = 0.0;
    scenario.world.sensors.gyro.fitted = true;
    scenario.world.sensors.accelerometer.fitted = true;
    if in_process {
        let loss = &mut scenario.world.bus.loss;
        *loss = loss.max(0.01);
    }
    Ok(scenario)
}

/// Estimator consistency, goals and memory in one window of the run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Window {
    /// Last tick of the window.
    pub end: u64,
    /// Mean NIS of the beam.
    pub nis: f64,
    /// Number of innovations.
    pub innovations: u64,
    /// Number of innovations beyond the gate.
    pub gated: u64,
    /// Mean NEES of the robot's posture at the goals; 3 for a consistent estimator.
    pub nees: Option<f64>,
    /// Root mean square error of the estimated position at the goals, m.
    pub position_m: Option<f64>,
    /// Largest estimated standard deviation of the position in the window, along x or y, m.
    pub sigma_m: f64,
    /// Largest estimated standard deviation of the heading in the window, rad.
    pub sigma_rad: f64,
    /// Root mean square error of the relative position of neighbouring axles, m.
    pub relative_m: f64,
    /// Root mean square error of the relative heading of neighbouring axles, rad.
    pub relative_rad: f64,
    /// Number of goals reached.
    pub reached: u64,
    /// Number of goals not reached.
    pub missed: u64,
    /// Resident memory of this process at the last tick, KiB; `None` without /proc.
    pub resident_kib: Option<u64>,
}

/// Least-squares line through values over the run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// Mean of the values.
    pub mean: f64,
    /// Change of the fitted line over the run.
    pub gain: f64,
    /// Standard error of the change.
    pub error: f64,
}

impl Drift {
    /// Least-squares line through values at times from 0 to 1; `None` for less than three values or equal times.
    pub fn of(values: &[(f64, f64)]) -> Option<Self> {
        let n = values.len() as f64;
        let times: Vec<f64> = values.iter().map(|(time, _)| *time).collect();
        let (time, mean) = (
            statistics::mean(&times),
            statistics::sum(values.iter().map(|(_, value)| *value)) / n,
        );
        let spread = statistics::sum(times.iter().map(|t| square(t - time)));
        if values.len() < 3 || !(spread > 0.0) {
            return None;
        }
        let products = values.iter().map(|(t, value)| (t - time) * (value - mean));
        let gain = statistics::sum(products) / spread;
        let rest = |&(t, value): &(f64, f64)| square(value - mean - gain * (t - time));
        let rest = statistics::sum(values.iter().map(rest));
        let error = (rest / (n - 2.0) / spread).sqrt();
        Some(Self { mean, gain, error })
    }

    /// True if the rise exceeds three standard errors and [`DRIFT_SHARE`] of the mean, or if the trend is not finite. A
    /// fall is allowed: innovations fall while the filter learns constants of the robot.
    pub fn is_significant(&self) -> bool {
        let rises = self.gain > 3.0 * self.error && self.gain > DRIFT_SHARE * self.mean.abs();
        rises || !(self.gain.is_finite() && self.error.is_finite())
    }
}

/// Windows, trend and faults of a soak.
#[derive(Clone, Debug, Serialize)]
pub struct SoakReport {
    /// Number of simulated ticks.
    pub ticks: u64,
    /// Windows of equal length.
    pub windows: Vec<Window>,
    /// Trend of the beam's NIS; `None` with less than three pieces of the run.
    pub nis: Option<Drift>,
    /// Number of stops by the name of their first reason.
    pub faults: BTreeMap<&'static str, u64>,
}

impl SoakReport {
    /// Messages about violated limits; empty if the soak passed.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        match self.nis {
            _ if self.ticks < MIN_TREND_TICKS => {}
            Some(drift) if drift.is_significant() => problems.push(format!(
                "NIS rises by {:.3} ± {:.3} over the run, mean {:.3}",
                drift.gain, drift.error, drift.mean
            )),
            Some(_) => {}
            None => problems.push("NIS: too few values; the run is too short".to_owned()),
        }
        let rms = |of: fn(&Window) -> f64| {
            let squares: f64 = self.windows.iter().map(|window| square(of(window))).sum();
            1e3 * (squares / self.windows.len().max(1) as f64).sqrt()
        };
        for (error, most, unit) in [
            (
                rms(|window| window.relative_m),
                1e3 * MAX_RELATIVE_ERROR_M,
                "mm",
            ),
            (
                rms(|window| window.relative_rad),
                1e3 * MAX_RELATIVE_ERROR_RAD,
                "mrad",
            ),
        ] {
            if !(error <= most) {
                problems.push(format!(
                    "pair error {error:.2} {unit}: must be at most {most} {unit}"
                ));
            }
        }
        let last = self.windows.iter().rev().find_map(|window| window.nees);
        match last {
            Some(nees) if nees <= MAX_END_NEES => {}
            Some(nees) => problems.push(format!(
                "NEES at the end is {nees:.1}: must be at most {MAX_END_NEES}"
            )),
            None => problems.push("NEES: no goal reached; the run is too short".to_owned()),
        }
        if let [first, .., last] = self.windows.as_slice()
            && let (Some(first), Some(last)) = (first.resident_kib, last.resident_kib)
        {
            let grown = last.saturating_sub(first);
            if grown > MAX_MEMORY_GROWTH_KIB {
                problems.push(format!(
                    "memory grew by {grown} KiB after the first window: must be at most {MAX_MEMORY_GROWTH_KIB}"
                ));
            }
        }
        let missed: u64 = self.windows.iter().map(|window| window.missed).sum();
        if missed > 0 {
            problems.push(format!("{missed} goals not reached"));
        }
        for (reason, count) in &self.faults {
            problems.push(format!("{count} stops: {reason}"));
        }
        problems
    }
}

/// Sums and maxima over a window, or over a piece of a window.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    nis: f64,
    innovations: u64,
    gated: u64,
    nees: f64,
    square_m2: f64,
    goals: u64,
    variance: [f64; 2],
    relative: [f64; 2],
    epochs: u64,
    reached: u64,
    missed: u64,
}

impl Sums {
    fn window(&self, end: u64) -> Window {
        let epochs = self.epochs.max(1) as f64;
        Window {
            end,
            nis: self.nis / self.innovations.max(1) as f64,
            innovations: self.innovations,
            gated: self.gated,
            nees: (self.goals > 0).then(|| self.nees / self.goals as f64),
            position_m: (self.goals > 0).then(|| (self.square_m2 / self.goals as f64).sqrt()),
            sigma_m: self.variance[0].sqrt(),
            sigma_rad: self.variance[1].sqrt(),
            relative_m: (self.relative[0] / epochs).sqrt(),
            relative_rad: (self.relative[1] / epochs).sqrt(),
            reached: self.reached,
            missed: self.missed,
            resident_kib: resident_kib(),
        }
    }
}

/// Resident memory of this process, KiB; `None` without /proc.
fn resident_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Phase of the drive to the next goal.
#[derive(Clone, Copy, Debug)]
enum DrivePhase {
    /// At rest until this tick.
    Resting(u64),
    /// Driving to a goal since this tick.
    Driving(u64),
}

/// Drive from goal to goal, with sums of the estimates' errors.
struct Soak<'a> {
    ticks: u64,
    windows: u64,
    advance: &'a mut dyn FnMut() -> bool,
    random: Pcg64,
    phase: DrivePhase,
    /// True after the end of a drive, when the monitor's changes can be discarded.
    drive_ended: bool,
    sums: Sums,
    piece: Sums,
    reported: Vec<Window>,
    /// Mean NIS of each piece at its middle, 0 to 1.
    innovations: Vec<(f64, f64)>,
    faults: BTreeMap<&'static str, u64>,
}

impl Soak<'_> {
    /// Adds the lead's estimates to the sums.
    fn observe(&mut self, record: &Record) {
        let fused = record.lead.fused;
        let frames = record.frames.len().max(1) as f64;
        let mut relative = [0.0; 2];
        for [x, y, phi] in record.relative_errors() {
            relative[0] += (square(x) + square(y)) / frames;
            relative[1] += square(libm::remainder(phi, std::f64::consts::TAU)) / frames;
        }
        let covariance = &fused.robot.covariance;
        let variance = |i: usize| f64::from(covariance[i][i]);
        for sums in [&mut self.sums, &mut self.piece] {
            if matches!(fused.beam.verdict, Verdict::Used | Verdict::Gated) {
                sums.innovations += 1;
                sums.nis += f64::from(fused.beam.nis);
                sums.gated += u64::from(fused.beam.verdict == Verdict::Gated);
            }
            sums.variance[0] = sums.variance[0].max(variance(0)).max(variance(1));
            sums.variance[1] = sums.variance[1].max(variance(2));
            sums.relative[0] += relative[0];
            sums.relative[1] += relative[1];
            sums.epochs += 1;
        }
    }

    /// Evaluates the drive if the goal is reached, failed or timed out, or if the robot has a fault.
    fn evaluate_drive(&mut self, robot: &impl Robot, record: &Record, tick: u64) {
        let DrivePhase::Driving(since) = self.phase else {
            return;
        };
        if tick - since < REST_TICKS {
            return;
        }
        let lead = &record.lead;
        let (done, failed) = (lead.done, lead.failed.is_some());
        let monitor = robot.monitor();
        let reason = monitor
            .fault_since(Node::Lead)
            .and_then(|_| monitor.first_fault()?.reason);
        if reason.is_none() && !done && !failed && tick - since < GOAL_TIMEOUT {
            return;
        }
        let (estimate, truth) = (lead.fused.robot, record.midpoint);
        let [x, y] = [estimate.posture.x, estimate.posture.y].map(f64::from);
        self.sums.nees += nees(&estimate, truth);
        self.sums.square_m2 += square(x - truth[0]) + square(y - truth[1]);
        self.sums.goals += 1;
        self.sums.reached += u64::from(done);
        self.sums.missed += u64::from(!done);
        self.phase = DrivePhase::Resting(tick + REST_TICKS);
        if let Some(reason) = reason {
            *self.faults.entry(reason.entry().name).or_default() += 1;
        }
        self.drive_ended = true;
    }

    /// Ends the piece and the window if this tick is their last; false if the run must end.
    fn report(&mut self, tick: u64) -> bool {
        let before = tick - EPOCH / TICK;
        let ends = |parts: u64| tick * parts / self.ticks > before * parts / self.ticks;
        let (piece, window) = (ends(PIECES), ends(self.windows));
        if window {
            let sums = std::mem::take(&mut self.sums);
            self.reported.push(sums.window(tick));
        }
        if !piece {
            return true;
        }
        let piece = std::mem::take(&mut self.piece);
        let middle = tick as f64 / self.ticks as f64 - 0.5 / PIECES as f64;
        if piece.innovations > 0 {
            let nis = piece.nis / piece.innovations as f64;
            self.innovations.push((middle, nis));
        }
        (self.advance)()
    }
}

impl<R: Robot> DriveTask<R> for Soak<'_> {
    fn task(&self) -> Option<Task> {
        None
    }

    /// Sends the next goal, or clears a fault. Clearing is repeated until the cause is gone.
    fn feed(&mut self, robot: &mut R) -> Result<(), Error> {
        if std::mem::take(&mut self.drive_ended) {
            robot.monitor_mut().forget_changes();
        }
        let tick = robot.now() / TICK;
        let DrivePhase::Resting(until) = self.phase else {
            return Ok(());
        };
        let lead = robot.monitor().latest(Node::Lead);
        let faulty = lead.is_some_and(|lead| lead.state == OperatingState::Fault);
        if tick < until {
            return Ok(());
        }
        if faulty {
            self.phase = DrivePhase::Resting(tick + RECOVERY_TICKS);
            return robot.command(&HostCommand::Task(Task::Clear));
        }
        let mut uniform = |half: f64| self.random.random_range(-half..half);
        let [x, y] = [uniform(SQUARE_M), uniform(SQUARE_M)];
        let goal = Posture::from([x, y, uniform(3.1)].map(|value| value as f32));
        self.phase = DrivePhase::Driving(tick);
        robot.command(&HostCommand::Task(Task::regulate(goal)))
    }

    /// False: a soak continues after a fault.
    fn must_end(&self, _robot: &R) -> bool {
        false
    }

    fn epoch(&mut self, robot: &R, record: &Record, since: Option<Micros>) -> Progress {
        let tick = robot.now() / TICK;
        // The first estimates are left out, because the lead has not yet received the start posture.
        if since.is_some_and(|since| since >= REST_TICKS * TICK) {
            self.observe(record);
            self.evaluate_drive(robot, record, tick);
        }
        match self.report(tick) {
            true => Progress::Driving,
            false => Progress::Over,
        }
    }
}

/// Drives a robot for `ticks` ticks, reported in `windows` equal windows. `advance` is called after each of `PIECES`
/// pieces and ends the run if it returns false.
pub fn run(
    robot: &mut impl Robot,
    scenario: &Scenario,
    (ticks, windows, seed): (u64, u64, u64),
    advance: &mut dyn FnMut() -> bool,
) -> Result<SoakReport, Error> {
    let mut soak = Soak {
        ticks,
        windows,
        advance,
        random: generator(seed, 1, Stream::Other(1)),
        phase: DrivePhase::Resting(REST_TICKS),
        drive_ended: false,
        sums: Sums::default(),
        piece: Sums::default(),
        reported: Vec::new(),
        innovations: Vec::new(),
        faults: BTreeMap::new(),
    };
    let end = drive(robot, scenario, seconds(ticks), &mut soak)?;
    if end.kind == EndKind::NoAnswer {
        return Err(Error::Failure(end.text()));
    }
    Ok(SoakReport {
        ticks: robot.now() / TICK,
        windows: soak.reported,
        nis: Drift::of(&soak.innovations),
        faults: soak.faults,
    })
}

/// Number of calls of `advance` in a run.
pub const fn pieces() -> usize {
    PIECES as usize
}

/// Simulated time of `ticks` ticks, s.
pub fn seconds(ticks: u64) -> f64 {
    (ticks * TICK) as f64 * 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values alternately 1 above and 1 below a line that rises by `gain`.
    fn values(count: u32, gain: f64) -> Vec<(f64, f64)> {
        let value = |i: u32| {
            let time = f64::from(i) / f64::from(count);
            let off = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
            (time, 3.0 + gain * time + off)
        };
        (0..count).map(value).collect()
    }

    #[test]
    fn trend_has_its_standard_error_and_only_a_rise_is_significant() {
        let drift = Drift::of(&values(400, 2.0)).unwrap();
        assert!((drift.gain - 2.0).abs() < 0.05, "{drift:?}");
        // The sum of squared deviations of n evenly spaced times from 0 to 1 is n / 12.
        let error = (12.0f64 / 400.0).sqrt();
        assert!((drift.error / error - 1.0).abs() < 0.02, "{drift:?}");
        assert!(drift.is_significant());
        assert!(!Drift::of(&values(400, 0.2)).unwrap().is_significant());
        assert!(!Drift::of(&values(4000, -2.0)).unwrap().is_significant());
        assert!(Drift::of(&values(400, f64::NAN)).unwrap().is_significant());
        assert_eq!(Drift::of(&values(2, 1.0)), None);
        assert_eq!(Drift::of(&[(0.5, 1.0); 5]), None);
    }

    fn sound() -> SoakReport {
        let window = Window {
            nis: 3.0,
            innovations: 1000,
            nees: Some(2.0),
            reached: 40,
            resident_kib: Some(10_000),
            ..Window::default()
        };
        SoakReport {
            ticks: MIN_TREND_TICKS,
            windows: vec![window; 5],
            nis: Drift::of(&values(200, 0.0)),
            faults: BTreeMap::new(),
        }
    }

    #[test]
    fn problem_of_each_limit_is_reported() {
        assert!(sound().problems().is_empty());
        let assert_problem = |change: fn(&mut SoakReport), what: &str| {
            let mut report = sound();
            change(&mut report);
            let problems = report.problems();
            assert!(
                problems.len() == 1 && problems[0].contains(what),
                "{problems:?}"
            );
        };
        assert_problem(
            |report| report.nis = Drift::of(&values(200, 3.0)),
            "NIS rises",
        );
        assert_problem(
            |report| report.windows[1].relative_m = 0.1,
            "mm: must be at most 2.5 mm",
        );
        assert_problem(
            |report| report.windows[1].relative_rad = f64::NAN,
            "pair error NaN mrad",
        );
        assert_problem(|report| report.nis = None, "too few");
        let mut short = sound();
        (short.ticks, short.nis) = (MIN_TREND_TICKS - 1, Drift::of(&values(200, 3.0)));
        assert!(short.problems().is_empty());
        assert_problem(
            |report| report.windows[4].nees = Some(16.3),
            "NEES at the end",
        );
        assert_problem(
            |report| report.windows[4].nees = Some(f64::NAN),
            "NEES at the end",
        );
        assert_problem(
            |report| report.windows[4].resident_kib = Some(10_001 + MAX_MEMORY_GROWTH_KIB),
            "memory grew",
        );
        assert_problem(|report| report.windows[2].missed = 1, "1 goals");
        assert_problem(
            |report| {
                report.faults.insert("wheel slip", 2);
            },
            "2 stops: wheel slip",
        );
    }

    #[test]
    fn resident_memory_includes_a_new_block() {
        let before = resident_kib().unwrap();
        let block = vec![1u8; 64 << 20];
        let after = resident_kib().unwrap();
        assert!(block.iter().all(|byte| *byte == 1) && after > before + 32_000);
    }
}
