//! The simulated plant, stepped from Python.

use crate::arrays::{self, Kept, Row, Rows};
use crate::errors::{RunError, of, refused};
use crate::scenario::{Scenario, drawn_by};
use host_sim::run::robot::FRAME_POINTS;
use host_sim::run::simulation::{DrawnPlant, Physics};
use host_sim::world::sensors::{AxleTruth, Truth};
use numpy::{PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{LockResult, Mutex, MutexGuard, PoisonError};

/// Adds the class to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Plant>()
}

/// Values of an axle among the sensed values.
const PER_AXLE: usize = 4;

/// Number of sensed values: four an axle, then the strains of each frame.
pub fn sensed_count(truth: &Truth) -> usize {
    PER_AXLE * truth.axles.len() + truth.strains.iter().map(Vec::len).sum::<usize>()
}

/// Names of the sensed values with their units.
pub fn sensed_names(truth: &Truth) -> Vec<String> {
    let axle = |axle: usize| {
        ["left_rad", "right_rad", "yaw_rate_rad_s", "forward_m_s2"]
            .map(|name| format!("axle{axle}.{name}"))
    };
    let frames = truth.strains.iter().enumerate();
    let strains = frames.flat_map(|(frame, strains)| {
        (0..strains.len()).map(move |gauge| format!("frame{frame}.strain[{gauge}]"))
    });
    (0..truth.axles.len())
        .flat_map(axle)
        .chain(strains)
        .collect()
}

/// Puts sensed values into the inputs of the sensors.
pub fn put_into(values: &[f64], truth: &mut Truth) {
    let (axles, strains) = values.split_at(PER_AXLE * truth.axles.len());
    let (axles, _) = axles.as_chunks::<PER_AXLE>();
    for (truth, &[left, right, yaw_rate, forward_acceleration]) in truth.axles.iter_mut().zip(axles)
    {
        *truth = AxleTruth {
            wheel_angle: [left, right],
            yaw_rate,
            forward_acceleration,
        };
    }
    let gauges = truth.strains.iter_mut().flatten();
    gauges.zip(strains).for_each(|(to, strain)| *to = *strain);
}

struct State {
    drawn: DrawnPlant,
    truth: Truth,
    sensed: Vec<f64>,
    torque: Vec<f64>,
    /// Arrays of the caller: sensed values and torques.
    arrays: [Kept; 2],
    ticks: u64,
}

/// Simulated plant of the robot that is drawn for a seed and a trial, at rest at its true start.
///
/// Sensed values, in the order of `sensed_names`: for each axle the angles of the left and the right motor (rad, at the
/// wheel), the yaw rate (rad/s) and the forward specific force (m/s²); then for each frame the strains at the true
/// places of its gauges, from the root.
#[pyclass(frozen, module = "cfmmr")]
pub struct Plant {
    // Boxed: a plant is aligned to 32 bytes, an object of Python to 16.
    state: Mutex<Box<State>>,
    /// Thread that holds the state.
    holder: AtomicUsize,
}

/// The state of a plant, locked.
struct Held<'a> {
    holder: &'a AtomicUsize,
    state: MutexGuard<'a, Box<State>>,
}

impl<'a> Held<'a> {
    fn new(plant: &'a Plant, state: LockResult<MutexGuard<'a, Box<State>>>) -> Self {
        plant.holder.store(this_thread(), Relaxed);
        Self {
            holder: &plant.holder,
            state: state.unwrap_or_else(PoisonError::into_inner),
        }
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.holder.store(0, Relaxed);
    }
}

impl Deref for Held<'_> {
    type Target = State;

    fn deref(&self) -> &State {
        &self.state
    }
}

impl DerefMut for Held<'_> {
    fn deref_mut(&mut self) -> &mut State {
        &mut self.state
    }
}

/// Number of this thread, not 0.
fn this_thread() -> usize {
    thread_local!(static PLACE: u8 = const { 0 });
    PLACE.with(|place| std::ptr::from_ref(place) as usize)
}

impl Plant {
    /// The state, as soon as other threads release it. Refused while a call of this thread is in progress: an argument
    /// of the call may have methods of the user, such as `__array__`, which use the plant.
    fn state(&self, py: Python<'_>) -> PyResult<Held<'_>> {
        match self.holder.load(Relaxed) == this_thread() {
            true => Err(RunError::new_err("a call of this plant is in progress")),
            false => Ok(Held::new(self, self.state.lock_py_attached(py))),
        }
    }
}

/// Largest magnitude of a coordinate (m) or a heading (rad) at which a robot is placed.
const FARTHEST: f64 = 1e6;

/// Wheel torques, `[axle][left, right]`, N m. A value that is not finite stays: the plant takes it as zero.
fn torques(value: &Bound<'_, PyAny>, axles: usize) -> PyResult<Vec<[f64; 2]>> {
    let numbers = arrays::any_numbers("torque", value, &[Some(axles), Some(2)])?;
    Ok(numbers.as_chunks::<2>().0.to_vec())
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (scenario, seed, trial=None))]
    fn new(
        scenario: &Scenario,
        seed: &Bound<'_, PyAny>,
        trial: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (seed, trial) = drawn_by(seed, trial)?;
        let scenario = &scenario.inner;
        let imperfections = scenario.world.draw(scenario.robot.topology(), seed, trial);
        let drawn = DrawnPlant::new(scenario, &imperfections).map_err(|error| of(&error))?;
        let state = State {
            truth: scenario.world.no_truth(scenario.robot.topology()),
            sensed: Vec::new(),
            torque: vec![0.0; 2 * drawn.plant.axles().len()],
            arrays: Default::default(),
            drawn,
            ticks: 0,
        };
        Ok(Self {
            state: Mutex::new(Box::new(state)),
            holder: AtomicUsize::new(0),
        })
    }

    /// Writes the sensed values into `out`, float64 of shape (sensed_count,).
    fn sensed_into(&self, py: Python<'_>, out: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut state = self.state(py)?;
        let State {
            drawn,
            truth,
            sensed,
            arrays: [array, _],
            ..
        } = &mut *state;
        drawn.measure(truth);
        sensed.clear();
        for axle in &truth.axles {
            sensed.extend(axle.wheel_angle);
            sensed.extend([axle.yaw_rate, axle.forward_acceleration]);
        }
        sensed.extend(truth.strains.iter().flatten());
        array.write("out", out, &[sensed.len()], sensed)
    }

    /// Number of sensed values.
    #[getter]
    fn sensed_count(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(sensed_count(&self.state(py)?.truth))
    }

    /// Names of the sensed values with their units.
    #[getter]
    fn sensed_names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(sensed_names(&self.state(py)?.truth))
    }

    /// Advances by 1 ms with wheel torques, shape (axles, 2): left and right, N m.
    fn step_with(&self, py: Python<'_>, torque: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut state = self.state(py)?;
        let axles = state.truth.axles.len();
        let State {
            drawn,
            torque: values,
            arrays: [_, array],
            ..
        } = &mut *state;
        array.read("torque", torque, &[axles, 2], values)?;
        drawn.plant.step(values.as_chunks().0);
        state.ticks += 1;
        Ok(())
    }

    /// Advances by `count` ms with constant wheel torques, shape (axles, 2): left and right, N m.
    fn steps(
        &self,
        py: Python<'_>,
        count: &Bound<'_, PyAny>,
        torque: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        const BETWEEN_SIGNALS: u64 = 10_000;
        let count = arrays::whole("count", count)?;
        let torque = torques(torque, self.state(py)?.truth.axles.len())?;
        let mut left = count;
        while left > 0 {
            let now = left.min(BETWEEN_SIGNALS);
            py.detach(|| {
                let mut state = Held::new(self, self.state.lock());
                for _ in 0..now {
                    state.drawn.plant.step(&torque);
                }
                state.ticks += now;
            });
            left -= now;
            py.check_signals()?;
        }
        Ok(())
    }

    /// Places the robot at rest with its midpoint at a posture: m, m, rad; each at most 1e6 in magnitude.
    fn place(&self, py: Python<'_>, midpoint: &Bound<'_, PyAny>) -> PyResult<()> {
        let midpoint: [f64; 3] = arrays::vector("midpoint", midpoint)?;
        if let Some(place) = midpoint.iter().position(|it| it.abs() > FARTHEST) {
            let (number, allowed) = (
                midpoint[place],
                format!("a number from {:e} to {FARTHEST:e}", -FARTHEST),
            );
            return Err(refused(
                format!("midpoint[{place}]"),
                arrays::text(number),
                allowed,
            ));
        }
        let mut state = self.state(py)?;
        state.drawn.plant.place(midpoint);
        state.ticks = 0;
        Ok(())
    }

    /// Lifts a wheel off the floor: number of the axle, then 0 for left or 1 for right.
    fn lift_wheel(
        &self,
        py: Python<'_>,
        axle: &Bound<'_, PyAny>,
        side: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let mut state = self.state(py)?;
        let last = state.truth.axles.len() as u64 - 1;
        let axle = arrays::whole_in("axle", axle, 0..=last)?;
        let side = arrays::whole_in("side", side, 0..=1)?;
        state.drawn.plant.lift_wheel(axle as usize, side as usize);
        Ok(())
    }

    /// Breaks a frame.
    fn snap_frame(&self, py: Python<'_>, frame: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut state = self.state(py)?;
        let last = state.truth.strains.len() as u64 - 1;
        let frame = arrays::whole_in("frame", frame, 0..=last)?;
        state.drawn.plant.snap_frame(frame as usize);
        Ok(())
    }

    /// Time since the start, s.
    #[getter]
    fn time_s(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.state(py)?.ticks as f64 * plant::TICK_S)
    }

    /// True posture of the midpoint, shape (3,): m, m, rad.
    #[getter]
    fn midpoint<'py>(&self, py: Python<'py>) -> PyResult<Row<'py>> {
        let midpoint = self.state(py)?.drawn.plant.midpoint();
        Ok(arrays::row(py, midpoint.to_vec()))
    }

    /// True postures of the axles, front first, shape (axles, 3): m, m, rad.
    #[getter]
    fn axles<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let axles = state.drawn.plant.axles().iter();
        arrays::rows(py, &axles.map(|axle| axle.posture).collect::<Vec<_>>())
    }

    /// Velocities of the axles, shape (axles, 3): forward and to the left, m/s; yaw rate, rad/s.
    #[getter]
    fn velocities<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let axles = state.drawn.plant.axles().iter();
        arrays::rows(py, &axles.map(|axle| axle.velocity).collect::<Vec<_>>())
    }

    /// Wheel speeds, shape (axles, 2): left and right, rad/s.
    #[getter]
    fn wheel_speeds<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let axles = state.drawn.plant.axles().iter();
        arrays::rows(py, &axles.map(|axle| axle.wheel_speed).collect::<Vec<_>>())
    }

    /// Wheel torques, shape (axles, 2): left and right, N m.
    #[getter]
    fn torques<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let axles = state.drawn.plant.axles().iter();
        arrays::rows(py, &axles.map(|axle| axle.torque).collect::<Vec<_>>())
    }

    /// Postures of each axle in the frame of the axle behind it, shape (frames, 3): m, m, rad.
    #[getter]
    fn relative<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let plant = &state.drawn.plant;
        let frames = (0..plant.frame_count()).map(|frame| plant.relative_posture(frame));
        arrays::rows(py, &frames.collect::<Vec<_>>())
    }

    /// Wrench of each frame on the axle behind it, in the coordinates of that axle, shape (frames, 4): force forward
    /// and to the left (N), moment at the root and at the tip (N m).
    #[getter]
    fn wrenches<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let state = self.state(py)?;
        let plant = &state.drawn.plant;
        let wrench = |frame| {
            let wrench = plant.wrench(frame);
            let [x, y] = wrench.force;
            [x, y, wrench.root_moment, wrench.end_moment]
        };
        let wrenches = (0..plant.frame_count()).map(wrench);
        arrays::rows(py, &wrenches.collect::<Vec<_>>())
    }

    /// Points of the bent frames from root to tip, shape (frames, 13, 2), m.
    fn frame_points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let state = self.state(py)?;
        let points = state.drawn.frame_points();
        let flat = points.as_flattened().as_flattened().to_vec();
        arrays::row(py, flat).reshape([points.len(), FRAME_POINTS, 2])
    }
}
