//! A simulator of the user, written in Python, in place of the plant.
//!
//! It is called twice a millisecond. An exception ends the run and is raised from it.

use crate::arrays::{self, Kept};
use crate::own::Failure;
use crate::plant::{put_into, sensed_count};
use crate::scenario::Scenario;
use core_algos::beam::MAX_GAUGES;
use core_algos::node::lead;
use core_algos::time::Micros;
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::run::robot::{Record, Robot};
use host_sim::run::simulation::{Physics, Simulation};
use host_sim::targets;
use host_sim::world::sensors::Truth;
use numpy::{PyArray1, PyArray2};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyString;

/// Work with the robot of a trial, whatever its physics.
pub trait Work {
    /// Result of the work.
    type Result;

    /// Does the work.
    fn on(self, robot: &mut impl Robot) -> Result<Self::Result, Error>;
}

/// Does work with the robot of a trial (seed and number): beside the simulator that `plant` makes, or beside the plant.
pub fn beside<W: Work>(
    scenario: &Scenario,
    (seed, trial): (u64, u64),
    plant: Option<&Py<PyAny>>,
    failure: &Failure,
    work: W,
) -> Result<W::Result, Error> {
    let Some(make) = plant else {
        let mut robot = Simulation::new(&scenario.inner, seed, trial)?;
        return work.on(&mut robot);
    };
    let inner = &scenario.inner;
    let topology = inner.robot.topology();
    let physics = Python::attach(|py| {
        let arguments = (scenario.clone(), seed, trial);
        let object = failure.of(|py| make.call1(py, arguments));
        let truth = inner.world.no_truth(topology);
        let (sensed, axles) = (sensed_count(&truth), truth.axles.len());
        InPython {
            object,
            failure: failure.clone(),
            topology,
            sensed: PyArray1::zeros(py, [sensed], false).unbind(),
            torque: PyArray2::zeros(py, [axles, 2], false).unbind(),
            kept: Default::default(),
            values: vec![0.0; sensed],
        }
    });
    let drawn = inner.world.draw(topology, seed, trial);
    let boards = targets::in_process_with(topology, &inner.own);
    let mut robot = Simulation::beside(physics, boards, inner, &drawn, (seed, trial))?;
    work.on(&mut robot)
}

/// Simulator of one trial.
struct InPython {
    /// `None` if its maker raised an exception.
    object: Option<Py<PyAny>>,
    failure: Failure,
    topology: Topology,
    /// Arrays that the simulator gets, with their buffers.
    sensed: Py<PyArray1<f64>>,
    torque: Py<PyArray2<f64>>,
    kept: [Kept; 2],
    values: Vec<f64>,
}

impl InPython {
    /// Rows of numbers of an attribute; `None` without the attribute, or after an exception.
    fn rows<const N: usize>(
        &self,
        name: &Bound<'_, PyString>,
        rows: usize,
    ) -> Option<Vec<[f64; N]>> {
        let object = self.object.as_ref()?;
        let numbers = self.failure.of(|py| {
            let object = object.bind(py);
            if !object.hasattr(name)? {
                return Ok(None);
            }
            let shape = [Some(rows), Some(N)];
            let value = object.getattr(name)?;
            arrays::any_numbers(name.to_str()?, &value, &shape).map(Some)
        });
        numbers.flatten().map(|it| it.as_chunks().0.to_vec())
    }

    /// Fills a record with what the simulator tells.
    fn fill(&self, py: Python<'_>, record: &mut Record) {
        let (axles, frames) = (record.axles.len(), record.frames.len());
        if let Some(postures) = self.rows::<3>(intern!(py, "axles"), axles) {
            for (axle, posture) in record.axles.iter_mut().zip(postures) {
                axle.posture = posture;
            }
        }
        if let Some(speeds) = self.rows::<2>(intern!(py, "wheel_speeds"), axles) {
            for (axle, speeds) in record.axles.iter_mut().zip(speeds) {
                axle.wheel_speed = speeds;
            }
        }
        if let Some(torques) = self.rows::<2>(intern!(py, "torques"), axles) {
            for (axle, torques) in record.axles.iter_mut().zip(torques) {
                axle.torque = torques;
            }
        }
        if let Some(relative) = self.rows::<3>(intern!(py, "relative"), frames) {
            for (frame, relative) in record.frames.iter_mut().zip(relative) {
                frame.relative = relative;
            }
        }
        if let Some(wrenches) = self.rows::<4>(intern!(py, "wrenches"), frames) {
            for (frame, [x, y, root, end]) in record.frames.iter_mut().zip(wrenches) {
                frame.wrench.force = [x, y];
                frame.wrench.root_moment = root;
                frame.wrench.end_moment = end;
            }
        }
    }
}

impl Physics for InPython {
    fn measure(&mut self, truth: &mut Truth) {
        let Some(object) = &self.object else {
            return;
        };
        let (sensed, [kept, _], values) = (&self.sensed, &mut self.kept, &mut self.values);
        self.failure.of(|py| {
            let sensed = sensed.bind(py);
            object.call_method1(py, intern!(py, "sensed_into"), (sensed,))?;
            kept.read("sensed", sensed, &[values.len()], values)
        });
        put_into(values, truth);
    }

    fn step(&mut self, torque: &[[f64; 2]]) {
        let Some(object) = &self.object else {
            return;
        };
        let (array, [_, kept]) = (&self.torque, &mut self.kept);
        self.failure.of(|py| {
            let array = array.bind(py);
            kept.write("torque", array, &[torque.len(), 2], torque.as_flattened())?;
            object.call_method1(py, intern!(py, "step_with"), (array,))
        });
    }

    fn record(
        &self,
        now: Micros,
        lead: lead::Output,
        strain: &dyn Fn(usize) -> [f32; MAX_GAUGES],
    ) -> Record {
        let mut record = Record::without_truth(now, self.topology, lead);
        for (k, frame) in record.frames.iter_mut().enumerate() {
            frame.strain = strain(k);
        }
        Python::attach(|py| {
            self.fill(py, &mut record);
            let midpoint = self.object.as_ref().and_then(|object| {
                self.failure.of(|py| {
                    let value = object.bind(py).getattr(intern!(py, "midpoint"))?;
                    arrays::vector("midpoint", &value)
                })
            });
            record.midpoint = midpoint.unwrap_or([f64::NAN; 3]);
        });
        record.bend_frames();
        record
    }
}
