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
use plant::Wrench;
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
    inner.own.check_axles(topology)?;
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
    /// Puts the rows of a property, an array of shape (items, N), into the items. Without the property, or after an
    /// exception, the items stay.
    fn put<T, const N: usize>(
        &self,
        name: &Bound<'_, PyString>,
        items: &mut [T],
        put: impl Fn(&mut T, [f64; N]),
    ) {
        let Some(object) = &self.object else {
            return;
        };
        let rows = self.failure.of(|py| {
            let object = object.bind(py);
            if !object.hasattr(name)? {
                return Ok(Vec::new());
            }
            let shape = [Some(items.len()), Some(N)];
            arrays::any_numbers(name.to_str()?, &object.getattr(name)?, &shape)
        });
        for (item, row) in items
            .iter_mut()
            .zip(rows.iter().flat_map(|it| it.as_chunks().0))
        {
            put(item, *row);
        }
    }

    /// Fills a record from the properties of the simulator.
    fn fill(&self, py: Python<'_>, record: &mut Record) {
        let (axles, frames) = (&mut record.axles, &mut record.frames);
        self.put(intern!(py, "axles"), axles, |it, row| it.posture = row);
        let speeds = intern!(py, "wheel_speeds");
        self.put(speeds, axles, |it, row| it.wheel_speed = row);
        self.put(intern!(py, "torques"), axles, |it, row| it.torque = row);
        self.put(intern!(py, "relative"), frames, |it, row| it.relative = row);
        let wrenches = intern!(py, "wrenches");
        self.put(wrenches, frames, |it, [x, y, root, end]| {
            it.wrench = Wrench {
                force: [x, y],
                root_moment: root,
                end_moment: end,
            };
        });
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
