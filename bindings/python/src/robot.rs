//! The boards of a robot, with or without their sensors, stepped from Python.

use crate::arrays::{self, Kept, Row, Rows};
use crate::errors::{RunError, of, refused};
use crate::own::{Failure, Makers};
use crate::plant::{put_into, sensed_count, sensed_names};
use crate::scenario::{Scenario, drawn_by};
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::LeadMode;
use core_algos::math::Posture;
use core_algos::node::axle;
use core_algos::node::lead::Task;
use core_algos::time::EPOCH;
use core_algos::topology::Wheels;
use host_sim::base::error::Error;
use host_sim::paths::{self, Path, PathError, Waypoint};
use host_sim::run::path_run::{PathMode, Route, Stream};
use host_sim::run::rig::Rig;
use host_sim::scenario;
use host_sim::targets::{self, HostCommand};
use host_sim::world::faults::Readings;
use host_sim::world::sensors::Truth;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyInt};
use recording::entry::LeadEntry;
use std::sync::{Mutex, MutexGuard, TryLockError};

/// Adds the classes to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Robot>()?;
    module.add_class::<Boards>()
}

/// Boards, sensors and bus with the points of a path that are still to be sent.
struct State {
    scenario: scenario::Scenario,
    rig: Rig,
    truth: Truth,
    readings: Readings,
    stream: Option<Stream>,
    sensed: Vec<f64>,
    /// Arrays of the caller: sensed values and torques.
    arrays: [Kept; 2],
    estimate: Kept,
    /// Exceptions of the user's parts.
    failure: Failure,
}

impl State {
    fn new(scenario: &Scenario, (seed, trial): (u64, u64), parts: Makers) -> PyResult<Self> {
        let failure = Failure::default();
        let mut scenario = scenario.inner.clone();
        scenario.own = parts.own(&failure);
        let topology = scenario.robot.topology();
        let drawn = scenario.world.draw(topology, seed, trial);
        let boards = targets::in_process_with(topology, &scenario.own);
        let rig = Rig::new(boards, &scenario, &drawn, (seed, trial));
        let truth = scenario.world.no_truth(topology);
        Ok(Self {
            rig: rig.map_err(|error| of(&error))?,
            sensed: vec![0.0; sensed_count(&truth)],
            truth,
            readings: Readings {
                axles: vec![axle::Samples::default(); topology.axle_count()],
                frames: vec![[0; MAX_GAUGES]; topology.frame_count()],
            },
            stream: None,
            arrays: Default::default(),
            estimate: Kept::default(),
            failure,
            scenario,
        })
    }

    /// Gives the lead node a task; the notices begin anew.
    fn command(&mut self, task: Task) -> PyResult<()> {
        self.stream = None;
        self.rig.monitor.begin_task();
        let command = HostCommand::Task(task);
        self.rig.boards.command(&command).map_err(|it| of(&it))
    }

    fn follow(&mut self, route: &Route, timed: bool) -> PyResult<()> {
        let within = self.scenario.mission.within();
        let (task, mode) = match timed {
            true => (Task::Track { within }, PathMode::Track),
            false => (Task::Follow { within }, PathMode::Follow),
        };
        // Makes room in place of an earlier path.
        self.command(Task::Stop)?;
        let mut stream = Stream::new(route, mode);
        if let Some(points) = stream.next(self.rig.boards.room()) {
            self.rig.boards.command(&points).map_err(|it| of(&it))?;
        }
        self.command(task)?;
        self.stream = Some(stream);
        Ok(())
    }
}

/// Route of a scenario's robot along a path: a name or CSV file of `cfmmr follow`, or waypoints of shape (n, 2), m.
pub fn route(
    scenario: &scenario::Scenario,
    path: &Bound<'_, PyAny>,
    laps: &Bound<'_, PyAny>,
) -> PyResult<Route> {
    let laps = arrays::whole_in("laps", laps, 1..=MAX_LAPS)?;
    let input = |error: PathError| of(&Error::input(error.to_string()));
    let path = match path.extract::<String>() {
        Ok(name) => paths::named(&name, ("size", None)).map_err(|error| {
            let allowed = match std::path::Path::new(&name).is_file() {
                true => format!("a CSV file of waypoints ({error})"),
                false => {
                    "line, circle, figure-eight, a CSV file, or waypoints of shape (n, 2)".into()
                }
            };
            refused("points", &name, allowed)
        })?,
        Err(_) => {
            let points = arrays::numbers("points", path, &[None, Some(2)])?;
            let points = points.as_chunks::<2>().0.iter();
            let waypoints: Vec<Waypoint> = points.map(|&[x, y]| (x, y).into()).collect();
            Path::through(&waypoints).map_err(input)?
        }
    };
    Route::new(&path, laps as u32, scenario).map_err(input)
}

/// Sends points of a path at the beginning of an epoch while there is room for them.
fn feed(rig: &mut Rig, stream: &mut Option<Stream>) -> PyResult<()> {
    let due = rig.now().is_multiple_of(EPOCH);
    let Some(stream) = stream.as_mut().filter(|_| due) else {
        return Ok(());
    };
    match stream.next(rig.boards.room()) {
        Some(points) => rig.boards.command(&points).map_err(|error| of(&error)),
        None => Ok(()),
    }
}

/// Most laps of a closed path; its length has a bound of its own.
const MAX_LAPS: u64 = 1_000_000;

/// Declares the tasks and readings that both classes have.
macro_rules! tasks {
    ($class:ident { $($own:tt)* }) => {
        impl $class {
            /// The state. Refused while a step is in progress: it calls parts of the user, which may ask for the
            /// state too, or let another thread ask.
            fn state(&self) -> PyResult<MutexGuard<'_, State>> {
                match self.state.try_lock() {
                    Ok(state) => Ok(state),
                    Err(TryLockError::Poisoned(state)) => Ok(state.into_inner()),
                    Err(TryLockError::WouldBlock) => {
                        Err(RunError::new_err("a step of this robot is in progress"))
                    }
                }
            }
        }

        #[pymethods]
        impl $class {
            #[new]
            #[pyo3(signature = (scenario, seed, trial=None, *, controller=None, estimator=None))]
            fn new(
                scenario: &Scenario,
                seed: &Bound<'_, PyAny>,
                trial: Option<&Bound<'_, PyAny>>,
                controller: Option<Py<PyAny>>,
                estimator: Option<Py<PyAny>>,
            ) -> PyResult<Self> {
                let parts = Makers {
                    controller,
                    estimator,
                };
                let state = State::new(scenario, drawn_by(seed, trial)?, parts)?;
                Ok(Self {
                    state: Mutex::new(state),
                })
            }

            $($own)*

            /// Drives the midpoint to a posture (m, m, rad; by default the goal of the scenario) and to rest.
            #[pyo3(signature = (goal=None))]
            fn regulate(&self, goal: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
                let mut state = self.state()?;
                let goal = match goal {
                    Some(goal) => arrays::single::<3>("goal", goal)?.map(f64::from),
                    None => state.scenario.mission.goal,
                };
                let task = state.scenario.mission.regulate(goal);
                state.command(task)
            }

            /// Follows a path from its beginning to rest at its end; with `timed` as a trajectory.
            ///
            /// points: waypoints, shape (n, 2), m; or line, circle, figure-eight or a CSV file of waypoints. A path
            /// whose last waypoint repeats the first is closed and driven `laps` times.
            #[pyo3(
                signature = (points, laps=None, timed=false),
                text_signature = "($self, points, laps=1, timed=False)"
            )]
            fn follow(
                &self,
                points: &Bound<'_, PyAny>,
                laps: Option<&Bound<'_, PyAny>>,
                timed: bool,
            ) -> PyResult<()> {
                let once = PyInt::new(points.py(), 1).into_any();
                let mut state = self.state()?;
                let route = route(&state.scenario, points, laps.unwrap_or(&once))?;
                state.follow(&route, timed)
            }

            /// Drives with a speed (m/s) and a curvature (1/m) of the midpoint. Without a new command the robot stops
            /// after 200 ms.
            fn drive(&self, speed_m_s: f64, curvature: f64) -> PyResult<()> {
                let task = Task::Drive {
                    speed_m_s: arrays::narrow("speed_m_s", speed_m_s)?,
                    curvature: arrays::narrow("curvature", curvature)?,
                };
                self.state()?.command(task)
            }

            /// Brakes and holds.
            fn stop(&self) -> PyResult<()> {
                self.state()?.command(Task::Stop)
            }

            /// Switches the motors off.
            fn idle(&self) -> PyResult<()> {
                self.state()?.command(Task::Idle)
            }

            /// Clears latched faults whose causes are gone.
            fn clear(&self) -> PyResult<()> {
                self.state()?.command(Task::Clear)
            }

            /// Time since the start, s.
            #[getter]
            fn time_s(&self) -> PyResult<f64> {
                Ok(self.state()?.rig.now() as f64 * 1e-6)
            }

            /// True if the task is done and the robot at rest.
            #[getter]
            fn done(&self) -> PyResult<bool> {
                let state = self.state()?;
                let lead = state.rig.lead();
                Ok(lead.done && lead.mode == LeadMode::Hold)
            }

            /// Output of the lead node: name of a column of the log, without "lead.", to its value.
            #[getter]
            fn lead<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                let state = self.state()?;
                let (now, lead) = (state.rig.now(), state.rig.lead());
                let entry = LeadEntry::new((now / 1000) as u32, now as f64 * 1e-6, lead);
                let dict = PyDict::new(py);
                for (name, cell) in LeadEntry::SCHEMA.columns().into_iter().zip(entry.cells()) {
                    dict.set_item(name, arrays::cell(py, cell)?)?;
                }
                Ok(dict)
            }

            /// Writes the estimated posture of the midpoint (m, m, rad) and its covariance, row by row, into `out`,
            /// float64 of shape (12,). The covariance is zero without an estimate.
            fn estimate_into(&self, out: &Bound<'_, PyAny>) -> PyResult<()> {
                let mut state = self.state()?;
                let robot = &state.rig.lead().fused.robot;
                let posture: [f32; 3] = robot.posture.into();
                let values = posture.iter().chain(robot.covariance.as_flattened());
                let values: Vec<f64> = values.map(|&value| value.into()).collect();
                state.estimate.write("out", out, &[12], &values)
            }

            /// Estimated posture of the midpoint, shape (3,): m, m, rad.
            #[getter]
            fn posture<'py>(&self, py: Python<'py>) -> PyResult<Row<'py>> {
                let Posture { x, y, phi } = self.state()?.rig.lead().fused.robot.posture;
                Ok(arrays::row(py, [x, y, phi].map(f64::from).to_vec()))
            }

            /// Covariance of the estimated posture, shape (3, 3): m², m rad, rad².
            #[getter]
            fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
                arrays::rows(py, &self.state()?.rig.lead().fused.robot.covariance)
            }

            /// Names of the notices and degradations of all nodes since the latest task.
            #[getter]
            fn notices(&self) -> PyResult<Vec<&'static str>> {
                let notices = self.state()?.rig.monitor.notices();
                Ok(notices.iter().map(|notice| notice.entry().name).collect())
            }

            /// Reason that the robot stopped with a fault, with code, time and remedy; None if it did not.
            #[getter]
            fn fault(&self) -> PyResult<Option<String>> {
                Ok(self.state()?.rig.monitor.why_stopped())
            }
        }
    };
}

/// Boards, sensors and bus of the robot that is drawn for a seed and a trial. The physics is the caller's.
///
/// Each call of `step_into` is 1 ms: the boards take the sensed values and give the torques of the next millisecond.
/// `Plant` lists the sensed values. A value that is not finite reaches the boards as a bad sample.
#[pyclass(frozen, module = "cfmmr")]
pub struct Robot {
    state: Mutex<State>,
}

tasks!(Robot {
    /// One millisecond of the boards. sensed: shape (sensed_count,). torque: float64 of shape (axles, 2), written with
    /// the torques of the left and right wheels, N m.
    fn step_into(
        &self,
        sensed: &Bound<'_, PyAny>,
        torque: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let mut state = self.state()?;
        let State {
            rig,
            truth,
            stream,
            failure,
            sensed: values,
            arrays: [from, to],
            ..
        } = &mut *state;
        from.read("sensed", sensed, &[values.len()], values)?;
        // Refused before the boards step.
        let shape = [truth.axles.len(), 2];
        to.check("torque", torque, &shape)?;
        put_into(values, truth);
        feed(rig, stream)?;
        let given = rig.step(truth).map_err(|error| of(&error))?;
        failure.check()?;
        to.write("torque", torque, &shape, given.as_flattened())
    }

    /// Number of sensed values: four an axle, then the strains of each frame.
    #[getter]
    fn sensed_count(&self) -> PyResult<usize> {
        Ok(sensed_count(&self.state()?.truth))
    }

    /// Names of the sensed values with their units.
    #[getter]
    fn sensed_names(&self) -> PyResult<Vec<String>> {
        Ok(sensed_names(&self.state()?.truth))
    }

    /// Strains as the beam boards read them, shape (frames, 8), from the root; zero where there is no gauge.
    #[getter]
    fn strains<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state()?;
        let frames = (0..state.truth.strains.len()).map(|frame| state.rig.strain(frame));
        arrays::rows(py, &frames.collect::<Vec<_>>())
    }
});

/// Boards and bus of the robot that is drawn for a seed and a trial. Sensors and physics are the caller's.
#[pyclass(frozen, module = "cfmmr")]
pub struct Boards {
    state: Mutex<State>,
}

/// Largest count that a board reads from a sensor.
const COUNTS: std::ops::RangeInclusive<f64> = -2147483648.0..=2147483647.0;

tasks!(Boards {
    /// One millisecond of the boards; gives the torques of the wheels in the next millisecond, shape (axles, 2), N m.
    ///
    /// encoder: shape (axles, 2), counts of the left and right encoder; NaN for a missing reading.
    /// counts: shape (frames, gauges), counts of the bridges' converters from the lower end of their range.
    /// gyro: shape (axles,), yaw rates, rad/s; acceleration: shape (axles,), forward specific forces, m/s². NaN is a
    /// bad sample, None a robot without these sensors.
    #[pyo3(signature = (encoder, counts, gyro=None, acceleration=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        encoder: &Bound<'_, PyAny>,
        counts: &Bound<'_, PyAny>,
        gyro: Option<&Bound<'_, PyAny>>,
        acceleration: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Rows<'py>> {
        let mut state = self.state()?;
        let (axles, frames) = (state.truth.axles.len(), state.truth.strains.len());
        let gauges = state.truth.strains.first().map_or(0, Vec::len);
        let encoder = arrays::any_numbers("encoder", encoder, &[Some(axles), Some(2)])?;
        let counts = arrays::numbers("counts", counts, &[Some(frames), Some(gauges)])?;
        let inertial = |name: &str, value: Option<&Bound<'_, PyAny>>| {
            value
                .map(|value| arrays::any_numbers(name, value, &[Some(axles)]))
                .transpose()
        };
        let gyro = inertial("gyro", gyro)?;
        let acceleration = inertial("acceleration", acceleration)?;
        for (name, values) in [("encoder", &encoder), ("counts", &counts)] {
            let is_count = |value: f64| COUNTS.contains(&value) && value.fract() == 0.0;
            let wrong = |value: &f64| !(value.is_nan() || is_count(*value));
            if let Some(place) = values.iter().position(wrong) {
                let columns = values.len() / if name == "encoder" { axles } else { frames };
                let field = format!("{name}[{}, {}]", place / columns, place % columns);
                return Err(refused(field, values[place], "a whole number of 32 bits"));
            }
        }
        let State {
            readings,
            rig,
            stream,
            failure,
            ..
        } = &mut *state;
        feed(rig, stream)?;
        for (i, samples) in readings.axles.iter_mut().enumerate() {
            let count = |wheel: usize| {
                let value = encoder[2 * i + wheel];
                value.is_finite().then_some(value as i32)
            };
            *samples = axle::Samples {
                encoder: Wheels {
                    left: count(0),
                    right: count(1),
                },
                gyro_rad_s: gyro.as_ref().map(|it| it[i] as f32),
                acceleration_m_s2: acceleration.as_ref().map(|it| it[i] as f32),
                ..axle::Samples::default()
            };
        }
        for (i, reading) in readings.frames.iter_mut().enumerate() {
            for (place, count) in reading.iter_mut().take(gauges).enumerate() {
                *count = counts[i * gauges + place] as i32;
            }
        }
        let given = rig.step_with(readings).map_err(|error| of(&error))?;
        failure.check()?;
        arrays::rows(py, given)
    }
});
