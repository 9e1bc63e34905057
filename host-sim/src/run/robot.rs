//! A robot that an experiment drives, its state for logs and pictures, and its observers.

use crate::base::error::Error;
use crate::bus::virtual_bus::BusStatistics;
use crate::run::real_time::RealTimeLimiter;
use crate::run::recovery::Monitor;
use crate::targets::board_record::BoardEvent;
use crate::targets::{BoardTraffic, HostCommand, Room};
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::CanFrame;
use core_algos::fusion::Estimate;
use core_algos::node::lead::{self, Task};
use core_algos::safety::Permit;
use core_algos::time::{EPOCH, Micros};
use core_algos::topology::{Role, Topology};
use plant::{AxleState, Outline, Plant, Wrench};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Longest time that a robot gets to stop, and then to switch its motors off, µs.
const STOP: Micros = 5_000_000;
/// Speed below which it counts as at rest, m/s.
const REST_M_S: f32 = 1e-3;

/// State of the robot at the beginning of an epoch, for logs and pictures.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Time, s.
    pub time_s: f64,
    /// True posture of the midpoint.
    pub midpoint: [f64; 3],
    /// Axles, front first.
    pub axles: Vec<AxleRecord>,
    /// Frames, front first.
    pub frames: Vec<FrameRecord>,
    /// Latest output of the lead node.
    pub lead: lead::Output,
}

/// State of an axle in a [`Record`].
#[derive(Clone, Copy, Debug, Default)]
pub struct AxleRecord {
    /// True posture.
    pub posture: [f64; 3],
    /// Wheel torques, left and right, N m.
    pub torque: [f64; 2],
    /// True wheel speeds, left and right, rad/s.
    pub wheel_speed: [f64; 2],
}

/// State of a frame in a [`Record`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameRecord {
    /// Wrench of the frame on its axles.
    pub wrench: Wrench,
    /// True posture of the axle ahead in the coordinates of the axle behind.
    pub relative: [f64; 3],
    /// Points of the bent frame from its root to its tip, global, m.
    pub points: [[f32; 2]; FRAME_POINTS],
    /// Strains as measured, from the root; zero where there is no gauge.
    pub strain: [f32; MAX_GAUGES],
}

impl Record {
    /// The lead node's output of a robot whose true state is not known: that is NaN.
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

    /// The same with the estimate in place of a truth that is not known: postures and frames.
    pub fn seen(&self) -> Self {
        let mut seen = self.clone();
        if !self.midpoint[0].is_nan() {
            return seen;
        }
        let fused = &self.lead.fused;
        let posture = |at: &Estimate| [at.posture.x, at.posture.y, at.posture.phi].map(f64::from);
        seen.midpoint = posture(&fused.robot);
        for (axle, at) in seen.axles.iter_mut().zip([&fused.front, &fused.rear]) {
            axle.posture = posture(at);
        }
        for (frame, axles) in seen.frames.iter_mut().zip(seen.axles.windows(2)) {
            frame.points = strip([axles[0].posture, axles[1].posture]);
        }
        seen
    }

    /// The plant as it is at `now`, with the lead node's latest step and the strains of each frame.
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

/// Places of [`FRAME_POINTS`] points along each frame of a plant.
pub fn outlines(plant: &Plant) -> Vec<Outline> {
    let frames = 0..plant.frame_count();
    frames
        .map(|frame| plant.outline(frame, FRAME_POINTS))
        .collect()
}

/// The strip between two axles: the cubic with their headings at its ends.
fn strip([front, rear]: [[f64; 3]; 2]) -> [[f32; 2]; FRAME_POINTS] {
    let length = libm::hypot(front[0] - rear[0], front[1] - rear[1]);
    std::array::from_fn(|i| {
        let t = i as f64 / (FRAME_POINTS - 1) as f64;
        let (t2, t3) = (t * t, t * t * t);
        let (start, end) = (2.0 * t3 - 3.0 * t2 + 1.0, 3.0 * t2 - 2.0 * t3);
        let (out, into) = (t3 - 2.0 * t2 + t, t3 - t2);
        let along = |k: usize, direction: fn(f64) -> f64| {
            let slopes = out * direction(rear[2]) + into * direction(front[2]);
            (start * rear[k] + end * front[k] + length * slopes) as f32
        };
        [along(0, libm::cos), along(1, libm::sin)]
    })
}

/// Observer of a run: a recording or a display.
pub trait Observer: Send {
    /// The state at the end of an epoch; an error ends the run.
    fn epoch(&mut self, robot: &dyn Robot, record: &Record) -> Result<(), Error>;

    /// The run is over; the text says how it ended.
    fn ended(&mut self, _text: &str) {}

    /// Image that a virtual board runs.
    fn board(&mut self, _role: Role, _image: String) {}

    /// Event at a board that is recorded. The common time of the boards was `zero`, µs, at the start of the run.
    fn event(&mut self, _role: Role, _zero: i64, _event: &BoardEvent) {}

    /// Frames of a board that is not recorded, at a tick of the run, ms.
    fn frames(&mut self, _role: Role, _tick: u32, _frames: Vec<CanFrame>) {}

    /// Output of the lead node of a board that is not recorded, at a tick of the run, ms.
    fn lead(&mut self, _tick: u32, _output: &lead::Output) {}

    /// A virtual board lost power at a tick, ms.
    fn off(&mut self, _role: Role, _tick: u32, _reason: &str) {}
}

/// Observers of a run.
pub type Observers = Vec<Box<dyn Observer>>;

/// Points of a frame's curve in a record.
pub const FRAME_POINTS: usize = 13;

/// Bounds of the time of a run, µs from the start of the simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// A robot that is done is watched at least until then.
    pub least: Micros,
    /// The run ends then, done or not.
    pub most: Option<Micros>,
}

/// Bounds, pace and observers of a run.
#[derive(Default)]
pub struct RunControl {
    /// Bounds of the time.
    pub span: Span,
    /// Flag that ends the run once it is set.
    pub interrupt: Option<Arc<AtomicBool>>,
    /// Limiter, if no tick is to begin before its time on the clock.
    pub pace: Option<RealTimeLimiter>,
    /// Observers of the state.
    pub observers: Observers,
}

impl Clone for RunControl {
    /// Without the observers, which are those of one run.
    fn clone(&self) -> Self {
        Self {
            span: self.span,
            interrupt: self.interrupt.clone(),
            pace: self.pace.clone(),
            observers: Observers::new(),
        }
    }
}

/// A robot that an experiment drives, wherever its boards run.
pub trait Robot {
    /// Simulated time, µs.
    fn now(&self) -> Micros;
    /// Gives the lead node a task, or points of a path or trajectory. It gets them at once, or soon.
    fn command(&mut self, command: &HostCommand) -> Result<(), Error>;
    /// Has the front board send a frame of a service tool on the bus; boards in this program have no use for it.
    fn send(&mut self, _frame: &CanFrame) -> Result<(), Error> {
        Ok(())
    }
    /// True if the lead node has got all commands.
    fn is_settled(&self) -> bool;
    /// Points the lead node has room for, at the end of an epoch.
    fn room(&mut self) -> Room;
    /// Why the robot cannot go on, if so.
    fn failure(&self) -> Option<String>;
    /// One millisecond.
    fn step(&mut self) -> Result<(), Error>;
    /// The state for logs and pictures.
    fn record(&self) -> Record;
    /// The robot as it is; `None` if it is a real one.
    fn plant(&self) -> Option<&Plant>;
    /// Bounds, pace and observers of the run.
    fn control(&self) -> &RunControl;
    /// The same, to be changed.
    fn control_mut(&mut self) -> &mut RunControl;
    /// The boards, with what went over the links to them.
    fn traffic(&self) -> Vec<BoardTraffic>;
    /// Counters of the bus between the boards.
    fn bus(&self) -> BusStatistics;

    /// Heartbeats of the nodes.
    fn monitor(&self) -> &Monitor;
    /// Heartbeats of the nodes, to begin anew.
    fn monitor_mut(&mut self) -> &mut Monitor;

    /// Age of the estimates in a record at the end of an epoch, µs. The lead node works on those of the epoch that has
    /// just passed.
    fn estimate_age(&self) -> Micros {
        EPOCH
    }

    /// Builds of the boards' images.
    fn builds(&self) -> Vec<(Role, String)> {
        Vec::new()
    }

    /// Has an observer see the state once an epoch.
    fn observe(&mut self, mut observer: Box<dyn Observer>) {
        for (role, build) in self.builds() {
            observer.board(role, build);
        }
        self.control_mut().observers.push(observer);
    }

    /// Shows the observers the state at the end of an epoch.
    fn show(&mut self) -> Result<(), Error>
    where
        Self: Sized,
    {
        if self.control().observers.is_empty() || !self.now().is_multiple_of(EPOCH) {
            return Ok(());
        }
        let record = self.record();
        let mut observers = std::mem::take(&mut self.control_mut().observers);
        let shown = observers
            .iter_mut()
            .try_for_each(|observer| observer.epoch(self, &record));
        self.control_mut().observers = observers;
        shown
    }

    /// True if the robot was at rest long enough to end the run.
    fn watched_enough(&self) -> bool {
        self.now() >= self.control().span.least
    }

    /// True if the user ends the run.
    fn is_interrupted(&self) -> bool {
        let interrupted = |flag: &Arc<AtomicBool>| flag.load(Relaxed);
        self.control().interrupt.as_ref().is_some_and(interrupted)
    }

    /// True if the time of the run is over.
    fn is_out_of_time(&self) -> bool {
        let most = self.control().span.most;
        most.is_some_and(|most| self.now() >= most)
    }

    /// True if the run must end before its task.
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

    /// Has the robot brake, then switch its motors off. An error if it does not confirm that in time.
    fn bring_to_rest(&mut self) -> Result<(), Error>
    where
        Self: Sized,
    {
        for task in [Task::Stop, Task::Idle] {
            self.command(&HostCommand::Task(task))?;
            let end = self.now() + STOP;
            while !(self.is_settled() && has_stopped(self, task)) {
                if self.now() >= end {
                    let seconds = STOP / 1_000_000;
                    return Err(Error::Failure(format!("not at rest after {seconds} s")));
                }
                self.step()?;
            }
        }
        Ok(())
    }

    /// True steering angle ψ, rad, or NaN: half the angle between the axles.
    fn steering(&self) -> f64 {
        self.plant()
            .map_or(f64::NAN, |plant| 0.5 * plant.relative_posture(0)[2])
    }

    /// True speed of the fastest axle's midpoint, m/s, or NaN.
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

/// True if the robot is at rest; after [`Task::Idle`], if its motors are off.
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
