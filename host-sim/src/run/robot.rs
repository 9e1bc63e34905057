//! A robot that an experiment drives, its state for logs and pictures, and its observers.

use crate::base::error::Error;
use crate::bus::virtual_bus::BusStatistics;
use crate::run::real_time::RealTimeLimiter;
use crate::run::recovery::Monitor;
use crate::targets::board_record::BoardEvent;
use crate::targets::{BoardTraffic, HostCommand, Room};
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::CanFrame;
use core_algos::math::Posture;
use core_algos::node::lead::{self, Task};
use core_algos::safety::Permit;
use core_algos::time::{EPOCH, Micros};
use core_algos::topology::{Role, Topology};
use plant::{AxleState, Outline, Plant, Wrench};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Timeout for the robot to stop, and again to switch its motors off, µs.
const STOP_TIMEOUT_US: Micros = 5_000_000;
/// Commanded speed below which the robot counts as at rest, m/s.
const REST_M_S: f32 = 1e-3;

/// Postures, frames and lead's output of the robot at the end of an epoch, for logs and pictures.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Time of the record, s.
    pub time_s: f64,
    /// True posture of the midpoint: m, m, rad; NaN if unknown.
    pub midpoint: [f64; 3],
    /// True motion of the axles, front first.
    pub axles: Vec<AxleRecord>,
    /// Wrench and shape of the frames, front first.
    pub frames: Vec<FrameRecord>,
    /// Latest output of the lead node.
    pub lead: lead::Output,
}

/// True posture, torques and wheel speeds of an axle in a [`Record`].
#[derive(Clone, Copy, Debug, Default)]
pub struct AxleRecord {
    /// True posture of the axle: m, m, rad; NaN if unknown.
    pub posture: [f64; 3],
    /// Wheel torques, left and right, N m.
    pub torque: [f64; 2],
    /// True wheel speeds, left and right, rad/s.
    pub wheel_speed: [f64; 2],
}

/// Wrench, shape and strains of a frame in a [`Record`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameRecord {
    /// Force (N) and moment (N m) of the frame on its axles.
    pub wrench: Wrench,
    /// True posture of the axle ahead in the coordinates of the axle behind: m, m, rad.
    pub relative: [f64; 3],
    /// Points of the bent frame from its root to its tip, global, m.
    pub points: [[f32; 2]; FRAME_POINTS],
    /// Strains as measured, from the root; zero where there is no gauge.
    pub strain: [f32; MAX_GAUGES],
}

impl Record {
    /// Record of a robot whose true state is unknown: the lead node's output, and NaN for the true state.
    pub fn without_truth(now: Micros, topology: Topology, lead: lead::Output) -> Self {
        const UNKNOWN: f64 = f64::NAN;
        let axle = AxleRecord {
            posture: [UNKNOWN; 3],
            torque: [UNKNOWN; 2],
            wheel_speed: [UNKNOWN; 2],
        };
        let frame = FrameRecord {
            wrench: Wrench {
                force: [UNKNOWN; 2],
                root_moment: UNKNOWN,
                end_moment: UNKNOWN,
            },
            relative: [UNKNOWN; 3],
            points: [[f32::NAN; 2]; FRAME_POINTS],
            strain: [f32::NAN; MAX_GAUGES],
        };
        Self {
            time_s: now as f64 * 1e-6,
            midpoint: [UNKNOWN; 3],
            axles: vec![axle; topology.axle_count()],
            frames: vec![frame; topology.frame_count()],
            lead,
        }
    }

    /// Copy of the record; estimated postures and frames replace an unknown true state, once every axle has an estimate.
    pub fn with_estimate(&self) -> Self {
        let mut record = self.clone();
        let estimated: Vec<Posture> = estimated_axles(&self.lead).collect();
        if !self.midpoint[0].is_nan() || estimated.len() != self.axles.len() {
            return record;
        }
        let posture = |at: Posture| [at.x, at.y, at.phi].map(f64::from);
        record.midpoint = posture(self.lead.fused.robot.posture);
        for (axle, at) in record.axles.iter_mut().zip(estimated) {
            axle.posture = posture(at);
        }
        record.bend_frames();
        record
    }

    /// Errors of the estimated relative posture of each frame's axles: m, m, rad.
    pub fn relative_errors(&self) -> impl Iterator<Item = [f64; 3]> {
        let axles: Vec<_> = estimated_axles(&self.lead).collect();
        let frames = self.frames.iter().enumerate();
        let error = move |(k, frame): (usize, &FrameRecord)| {
            let (front, rear) = (axles.get(k)?, axles.get(k + 1)?);
            let at = front.relative_to(*rear);
            let estimated = [at.x, at.y, at.phi].map(f64::from);
            Some(std::array::from_fn(|i| estimated[i] - frame.relative[i]))
        };
        frames.filter_map(error)
    }

    /// The frame whose curvature has the largest magnitude, 1/m: 2 tan ψ divided by the distance of its axles.
    pub fn curvature(&self) -> f64 {
        let of = |[x, y, heading]: [f64; 3]| 2.0 * libm::tan(0.5 * heading) / libm::hypot(x, y);
        let each = self.frames.iter().map(|frame| of(frame.relative));
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        each.reduce(larger).unwrap_or(f64::NAN)
    }

    /// Draws each frame as a cubic between its axles.
    pub fn bend_frames(&mut self) {
        for (frame, axles) in self.frames.iter_mut().zip(self.axles.windows(2)) {
            frame.points = strip([axles[0].posture, axles[1].posture]);
        }
    }

    /// Record of a simulated robot at `now`, with the lead node's latest output and the measured strains of each frame.
    pub fn of(
        now: Micros,
        plant: &Plant,
        outlines: &[Outline],
        lead: lead::Output,
        strain: impl Fn(usize) -> [f32; MAX_GAUGES],
    ) -> Self {
        let axle = |axle: &AxleState| AxleRecord {
            posture: axle.posture,
            torque: axle.torque,
            wheel_speed: axle.wheel_speed,
        };
        let frame = |(frame, outline)| {
            let mut points = [[0.0; 2]; FRAME_POINTS];
            plant.draw(outline, &mut points);
            FrameRecord {
                wrench: plant.wrench(frame),
                relative: plant.relative_posture(frame),
                points: points.map(|point| point.map(|value| value as f32)),
                strain: strain(frame),
            }
        };
        Self {
            time_s: now as f64 * 1e-6,
            midpoint: plant.midpoint(),
            axles: plant.axles().iter().map(axle).collect(),
            frames: outlines.iter().enumerate().map(frame).collect(),
            lead,
        }
    }
}

/// Estimated postures of the axles, front first. An inner axle without an estimate is left out.
pub fn estimated_axles(lead: &lead::Output) -> impl Iterator<Item = Posture> {
    let fused = &lead.fused;
    let inner = lead.inner.into_iter().flatten();
    let ends = [fused.front.posture, fused.rear.posture];
    ends.into_iter()
        .take(1)
        .chain(inner)
        .chain(ends.into_iter().skip(1))
}

/// Positions along each frame of a plant at which a record has its [`FRAME_POINTS`] points.
pub fn outlines(plant: &Plant) -> Vec<Outline> {
    let frames = 0..plant.frame_count();
    frames
        .map(|frame| plant.outline(frame, FRAME_POINTS))
        .collect()
}

/// Points of the strip between two axles: a cubic with the axles' headings at its ends.
fn strip([front, rear]: [[f64; 3]; 2]) -> [[f32; 2]; FRAME_POINTS] {
    let length = libm::hypot(front[0] - rear[0], front[1] - rear[1]);
    std::array::from_fn(|i| {
        let t = i as f64 / (FRAME_POINTS - 1) as f64;
        let (t2, t3) = (t * t, t * t * t);
        let (start, end) = (2.0 * t3 - 3.0 * t2 + 1.0, 3.0 * t2 - 2.0 * t3);
        let (out, into) = (t3 - 2.0 * t2 + t, t3 - t2);
        let coordinate = |k: usize, direction: fn(f64) -> f64| {
            let slopes = out * direction(rear[2]) + into * direction(front[2]);
            (start * rear[k] + end * front[k] + length * slopes) as f32
        };
        [coordinate(0, libm::cos), coordinate(1, libm::sin)]
    })
}

/// Observer of a run: a recording or a display.
pub trait Observer: Send {
    /// Receives the record at the end of an epoch; an error ends the run.
    fn epoch(&mut self, robot: &dyn Robot, record: &Record) -> Result<(), Error>;

    /// Receives the text about the end of the run.
    fn ended(&mut self, _text: &str) {}

    /// Receives the build of the image that a virtual board runs.
    fn board(&mut self, _role: Role, _image: String) {}

    /// Receives an event of a recorded board. `zero` is the boards' common time at the start of the run, µs.
    fn event(&mut self, _role: Role, _zero: i64, _event: &BoardEvent) {}

    /// Receives frames of a board that is not recorded, at a tick of the run, ms.
    fn frames(&mut self, _role: Role, _tick: u32, _frames: Vec<CanFrame>) {}

    /// Receives the output of the lead node of a board that is not recorded, at a tick of the run, ms.
    fn lead(&mut self, _tick: u32, _output: &lead::Output) {}

    /// Receives the power loss of a virtual board at a tick, ms.
    fn off(&mut self, _role: Role, _tick: u32, _reason: &str) {}
}

/// Observers of a run.
pub type Observers = Vec<Box<dyn Observer>>;

/// Number of points on the curve of a frame in a record.
pub const FRAME_POINTS: usize = 13;

/// Bounds of the time of a run, µs from the start of the simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Time before which a run does not end, even if its task is done.
    pub least: Micros,
    /// Time at which the run ends, even if the task is not done; `None` without a limit.
    pub most: Option<Micros>,
}

/// Time bounds, pace and observers of a run.
#[derive(Default)]
pub struct RunControl {
    /// Bounds of the run's time.
    pub span: Span,
    /// Flag that another thread sets to end the run.
    pub interrupt: Option<Arc<AtomicBool>>,
    /// Limiter of a run in real time.
    pub pace: Option<RealTimeLimiter>,
    /// Recordings and displays that get each record.
    pub observers: Observers,
}

impl Clone for RunControl {
    /// Copy without the observers, because observers belong to a single run.
    fn clone(&self) -> Self {
        Self {
            span: self.span,
            interrupt: self.interrupt.clone(),
            pace: self.pace.clone(),
            observers: Observers::new(),
        }
    }
}

/// A robot that an experiment drives, with its boards in this process or behind links.
pub trait Robot {
    /// Simulated time, µs.
    fn now(&self) -> Micros;
    /// Sends the lead node a task, or points of a path or trajectory; delivered when [`Self::is_settled`] is true.
    fn command(&mut self, command: &HostCommand) -> Result<(), Error>;
    /// Sends a frame of a service tool on the bus through the front board; no effect on boards in this process.
    fn send(&mut self, _frame: &CanFrame) -> Result<(), Error> {
        Ok(())
    }
    /// True if the lead node has received all commands.
    fn is_settled(&self) -> bool;
    /// Free room of the lead node's buffers at the end of an epoch, points.
    fn room(&mut self) -> Room;
    /// Reason that the robot cannot continue; `None` if the robot can.
    fn failure(&self) -> Option<String>;
    /// Advances the robot by 1 ms.
    fn step(&mut self) -> Result<(), Error>;
    /// Record of the robot for logs and pictures.
    fn record(&self) -> Record;
    /// Plant of a simulated robot; `None` for a real robot.
    fn plant(&self) -> Option<&Plant>;
    /// Time bounds, pace and observers of the run.
    fn control(&self) -> &RunControl;
    /// Time bounds, pace and observers of the run, to be changed.
    fn control_mut(&mut self) -> &mut RunControl;
    /// Links to the boards, with their traffic.
    fn traffic(&self) -> Vec<BoardTraffic>;
    /// Counters of the bus between the boards.
    fn bus(&self) -> BusStatistics;

    /// Monitor of the nodes' heartbeats.
    fn monitor(&self) -> &Monitor;
    /// Monitor of the nodes' heartbeats, to be changed.
    fn monitor_mut(&mut self) -> &mut Monitor;

    /// Age of the estimates in a record at the end of an epoch, µs: the lead node fuses the reports of the epoch
    /// before.
    fn estimate_age(&self) -> Micros {
        EPOCH
    }

    /// Boards with the builds of their images; empty for a robot that reports no builds.
    fn builds(&self) -> Vec<(Role, String)> {
        Vec::new()
    }

    /// Adds an observer, which gets the record of each epoch.
    fn observe(&mut self, mut observer: Box<dyn Observer>) {
        for (role, build) in self.builds() {
            observer.board(role, build);
        }
        self.control_mut().observers.push(observer);
    }

    /// Passes the record to the observers at the end of an epoch; does nothing within an epoch.
    fn notify_observers(&mut self) -> Result<(), Error>
    where
        Self: Sized,
    {
        if self.control().observers.is_empty() || !self.now().is_multiple_of(EPOCH) {
            return Ok(());
        }
        let record = self.record();
        let mut observers = std::mem::take(&mut self.control_mut().observers);
        let result = observers
            .iter_mut()
            .try_for_each(|observer| observer.epoch(self, &record));
        self.control_mut().observers = observers;
        result
    }

    /// True if the time before which the run does not end has passed.
    fn may_end(&self) -> bool {
        self.now() >= self.control().span.least
    }

    /// True if the user has interrupted the run.
    fn is_interrupted(&self) -> bool {
        let interrupted = |flag: &Arc<AtomicBool>| flag.load(Relaxed);
        self.control().interrupt.as_ref().is_some_and(interrupted)
    }

    /// True if the time at which the run ends in any case has passed.
    fn is_out_of_time(&self) -> bool {
        let most = self.control().span.most;
        most.is_some_and(|most| self.now() >= most)
    }

    /// True if the run must end even though its task is not done.
    fn must_end(&self) -> bool {
        self.is_interrupted() || self.failure().is_some() || self.is_out_of_time()
    }

    /// Ends the run: brings the robot to rest.
    fn stop(&mut self) -> Result<(), Error>
    where
        Self: Sized,
    {
        self.bring_to_rest()
    }

    /// Brakes the robot, then switches its motors off. An error if the robot does not confirm both in time.
    fn bring_to_rest(&mut self) -> Result<(), Error>
    where
        Self: Sized,
    {
        for task in [Task::Stop, Task::Idle] {
            self.command(&HostCommand::Task(task))?;
            let end = self.now() + STOP_TIMEOUT_US;
            while !(self.is_settled() && has_stopped(self, task)) {
                if self.now() >= end {
                    let seconds = STOP_TIMEOUT_US / 1_000_000;
                    return Err(Error::Failure(format!("not at rest after {seconds} s")));
                }
                self.step()?;
            }
        }
        Ok(())
    }

    /// True steering angle ψ of the frame that is bent most, rad: half the relative heading of its axles. NaN without a
    /// plant.
    fn steering(&self) -> f64 {
        let Some(plant) = self.plant() else {
            return f64::NAN;
        };
        let each = (0..plant.frame_count()).map(|frame| 0.5 * plant.relative_posture(frame)[2]);
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        each.reduce(larger).unwrap_or(f64::NAN)
    }

    /// True speed of the fastest axle's midpoint, m/s; NaN without a plant.
    fn speed(&self) -> f64 {
        self.plant().map_or(f64::NAN, |plant| {
            let speeds = plant.axles().iter().map(|axle| {
                let [forward, across, _] = axle.velocity;
                libm::hypot(forward, across)
            });
            speeds.fold(f64::NAN, f64::max)
        })
    }
}

/// True if the robot is at rest, and after [`Task::Idle`] its motors are off too.
fn has_stopped(robot: &impl Robot, task: Task) -> bool {
    let monitor = robot.monitor();
    let on = |node| {
        let latest = monitor.latest(node);
        latest.is_some_and(|latest| latest.state.permit() != Permit::Off)
    };
    let off = !monitor.topology.nodes().any(on);
    (off || task != Task::Idle) && robot.record().lead.motion.v.abs() <= REST_M_S
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before the inner axles have estimates, no axle has one.
    #[test]
    fn estimates_of_some_axles_are_not_those_of_others() {
        let robot = Topology::new(4).unwrap();
        let mut lead = lead::Output::default();
        let at = |x: f32| Posture::new(x, 0.0, 0.0);
        (lead.fused.front.posture, lead.fused.rear.posture) = (at(3.0), at(1.0));
        lead.inner[0] = Some(at(2.0));
        let axles = |lead| {
            let record = Record::without_truth(0, robot, lead).with_estimate();
            record
                .axles
                .iter()
                .map(|axle| axle.posture[0])
                .collect::<Vec<_>>()
        };
        assert!(axles(lead).iter().all(|x| x.is_nan()));
        lead.inner[1] = Some(at(1.5));
        assert_eq!(axles(lead), [3.0, 2.0, 1.5, 1.0]);
    }

    #[test]
    fn strip_begins_and_ends_at_the_axles_along_their_headings() {
        let (front, rear) = ([0.35, 0.1, 0.6], [0.0, 0.0, -0.2]);
        let strip = strip([front, rear]);
        assert_eq!(
            (strip[0], strip[FRAME_POINTS - 1]),
            ([0.0, 0.0], [0.35, 0.1])
        );
        let slope = |a: [f32; 2], b: [f32; 2]| (b[1] - a[1]).atan2(b[0] - a[0]);
        assert!((slope(strip[0], strip[1]) + 0.2).abs() < 0.2);
        assert!((slope(strip[FRAME_POINTS - 2], strip[FRAME_POINTS - 1]) - 0.6).abs() < 0.2);
    }
}
