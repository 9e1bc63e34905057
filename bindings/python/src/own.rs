//! A controller and an estimator of the user, written in Python.
//!
//! The lead node calls them once an epoch. An exception ends the run and is raised from it: until then the controller
//! brakes, and the estimator has no estimate.

use crate::arrays::{self, Row, Rows};
use crate::errors::refused;
use core_algos::control::controller::{ControllerOutput, KinematicController};
use core_algos::control::regulator::Input;
use core_algos::fusion::Estimate;
use core_algos::fusion::estimator::{Estimator, EstimatorOutput};
use core_algos::fusion::robot::{Increment, Inputs, PairAxle};
use core_algos::math::Posture;
use host_sim::scenario::own::Own;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

/// Adds the classes to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<ControllerInput>()?;
    module.add_class::<EstimatorInput>()
}

/// First exception of the user's parts of a run, and the flag that ends the run.
#[derive(Clone, Default)]
pub struct Failure {
    exception: Arc<Mutex<Option<PyErr>>>,
    interrupt: Arc<AtomicBool>,
}

impl Failure {
    /// Failures of parts in a run that ends when `interrupt` is set.
    pub fn new(interrupt: Arc<AtomicBool>) -> Self {
        Self {
            exception: Arc::default(),
            interrupt,
        }
    }

    fn is_set(&self) -> bool {
        self.interrupt.load(Relaxed)
    }

    fn set(&self, exception: PyErr) {
        let mut first = self
            .exception
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        first.get_or_insert(exception);
        self.interrupt.store(true, Relaxed);
    }

    /// The exception, if there was one.
    pub fn check(&self) -> PyResult<()> {
        let mut first = self
            .exception
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        first.take().map_or(Ok(()), Err)
    }

    /// Result of a call, or `None` after an exception.
    pub fn of<T>(&self, call: impl FnOnce(Python<'_>) -> PyResult<T>) -> Option<T> {
        if self.is_set() {
            return None;
        }
        Python::attach(call).map_err(|error| self.set(error)).ok()
    }
}

/// Parts of the user for the trials of a run: functions or classes that make a part, called once a trial.
#[derive(Default)]
pub struct Makers {
    /// Makes the controller.
    pub controller: Option<Py<PyAny>>,
    /// Makes the estimator.
    pub estimator: Option<Py<PyAny>>,
}

impl Makers {
    /// The parts for the scenario of a run.
    pub fn own(self, failure: &Failure) -> Own {
        let mut own = Own::default();
        if let Some(make) = self.controller {
            let failure = failure.clone();
            own = own.with_controller(move || Part::new(&make, &failure));
        }
        if let Some(make) = self.estimator {
            let failure = failure.clone();
            own = own.with_estimator(move || Part::new(&make, &failure));
        }
        own
    }
}

/// A controller or an estimator of one trial; `None` if its maker raised an exception.
struct Part {
    object: Option<Py<PyAny>>,
    failure: Failure,
}

impl Part {
    fn new(make: &Py<PyAny>, failure: &Failure) -> Self {
        Self {
            object: failure.of(|py| make.call0(py)),
            failure: failure.clone(),
        }
    }

    fn call<T>(&self, call: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>) -> Option<T> {
        let object = self.object.as_ref()?;
        self.failure.of(|py| call(object.bind(py)))
    }
}

/// Input of a user's controller in an epoch of 10 ms.
///
/// posture: estimated posture of the midpoint O, shape (3,), m, m, rad. goal: goal of O, likewise, in the same
/// coordinates. steering_rad: commanded steering angle; speed_m_s: commanded velocity of O. tolerance: of the goal, m,
/// rad.
#[pyclass(frozen, get_all, module = "cfmmr")]
struct ControllerInput {
    posture: Py<numpy::PyArray1<f64>>,
    goal: Py<numpy::PyArray1<f64>>,
    steering_rad: f32,
    speed_m_s: f32,
    tolerance: (f32, f32),
}

/// Exception for what a method of the user returned.
fn returned(method: &str, result: &Bound<'_, PyAny>, wanted: &str) -> PyErr {
    let found = result.get_type().to_string();
    refused(format!("result of {method}"), found, wanted)
}

fn array(py: Python<'_>, posture: Posture) -> Row<'_> {
    let posture: [f32; 3] = posture.into();
    arrays::row(py, posture.map(f64::from).to_vec())
}

impl KinematicController for Part {
    fn begin(&mut self) {
        self.call(|object| match object.hasattr("begin")? {
            true => object.call_method0("begin").map(drop),
            false => Ok(()),
        });
    }

    fn step(&mut self, input: &Input) -> ControllerOutput {
        let output = self.call(|object| {
            let py = object.py();
            let input = ControllerInput {
                posture: array(py, input.posture).unbind(),
                goal: array(py, input.goal).unbind(),
                steering_rad: input.steering.0,
                speed_m_s: input.speed_m_s,
                tolerance: (input.within.position_m, input.within.heading_rad),
            };
            let result = object.call_method1("step", (input,))?;
            let Ok((v, kappa, done)) = result.extract::<(f64, f64, bool)>() else {
                return Err(returned(
                    "controller.step",
                    &result,
                    "a tuple of velocity (m/s), curvature (1/m) and done (bool)",
                ));
            };
            Ok(ControllerOutput {
                v: v as f32,
                kappa: kappa as f32,
                done,
            })
        });
        output.unwrap_or_default()
    }
}

/// Input of a user's estimator in an epoch of 10 ms.
///
/// front, rear: motion of each axle by its odometry, a pair of its posture in the coordinates the axle had, shape (3,),
/// m, m, rad, and the covariance, shape (3, 3); None if the message is missing. beam: posture of the front axle in the
/// coordinates of the rear axle, measured by the gauges, a pair likewise.
#[pyclass(frozen, get_all, module = "cfmmr")]
struct EstimatorInput {
    front: Option<Pair>,
    rear: Option<Pair>,
    beam: Option<Pair>,
}

type Pair = (Py<numpy::PyArray1<f64>>, Py<numpy::PyArray2<f64>>);

fn pair(py: Python<'_>, estimate: &Estimate) -> PyResult<Pair> {
    let covariance: Rows<'_> = arrays::rows(py, &estimate.covariance)?;
    Ok((array(py, estimate.posture).unbind(), covariance.unbind()))
}

/// Estimates from postures of shape (3, 3) and covariances of shape (3, 3, 3): front axle, rear axle, midpoint.
fn estimates(result: &Bound<'_, PyAny>) -> PyResult<EstimatorOutput> {
    let Ok((postures, covariances)) = result.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>()
    else {
        return Err(returned(
            "estimator.step",
            result,
            "a tuple of postures, shape (3, 3), and covariances, shape (3, 3, 3)",
        ));
    };
    let three = Some(3);
    let postures = arrays::any_numbers("postures", &postures, &[three; 2])?;
    let covariances = arrays::any_numbers("covariances", &covariances, &[three; 3])?;
    let estimate = |k: usize| {
        let posture: [f32; 3] = std::array::from_fn(|i| postures[3 * k + i] as f32);
        let covariance =
            std::array::from_fn(|i| std::array::from_fn(|j| covariances[9 * k + 3 * i + j] as f32));
        Estimate::new(posture.into(), covariance)
    };
    Ok(EstimatorOutput {
        front: estimate(0),
        rear: estimate(1),
        robot: estimate(2),
    })
}

/// An output that the lead node does not use.
fn no_estimate() -> EstimatorOutput {
    let unknown = Estimate::new(Posture::new(f32::NAN, f32::NAN, f32::NAN), [[0.0; 3]; 3]);
    EstimatorOutput {
        robot: unknown,
        ..EstimatorOutput::default()
    }
}

impl Estimator for Part {
    fn start(&mut self, center: &Estimate, relative: &Estimate) {
        self.call(|object| {
            let py = object.py();
            let arguments = (pair(py, center)?, pair(py, relative)?);
            object.call_method1("start", arguments).map(drop)
        });
    }

    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput {
        let output = self.call(|object| {
            let py = object.py();
            let motion = |increment: Option<Increment>| {
                let estimate = increment.map(|it| Estimate::new(it.posture, it.covariance));
                estimate.map(|it| pair(py, &it)).transpose()
            };
            let input = EstimatorInput {
                front: motion(inputs.front)?,
                rear: motion(inputs.rear)?,
                beam: inputs.beam.map(|it| pair(py, &it)).transpose()?,
            };
            estimates(&object.call_method1("step", (input,))?)
        });
        output.unwrap_or_else(no_estimate)
    }

    fn rejoin(&mut self, known: PairAxle, beam: &Estimate) -> Option<EstimatorOutput> {
        let output = self.call(|object| {
            if !object.hasattr("rejoin")? {
                return Ok(None);
            }
            let known = match known {
                PairAxle::Front => "front",
                PairAxle::Rear => "rear",
            };
            let arguments = (known, pair(object.py(), beam)?);
            let result = object.call_method1("rejoin", arguments)?;
            match result.is_none() {
                true => Ok(None),
                false => estimates(&result).map(Some),
            }
        });
        output.flatten()
    }
}
