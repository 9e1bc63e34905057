//! Scenarios, their keys, and the errors of a drawn robot.

use crate::arrays;
use crate::errors::{of, refused};
use host_sim::base::toml_file;
use host_sim::scenario::variant::Variant;
use host_sim::scenario::{self, keys};
use host_sim::world;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::{Value as Json, json};
use std::path::PathBuf;
use toml::Value;

/// Adds the classes and functions to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Scenario>()?;
    module.add_function(wrap_pyfunction!(worlds, module)?)?;
    module.add_function(wrap_pyfunction!(keys_json, module)?)?;
    module.add_function(wrap_pyfunction!(drawn_json, module)?)?;
    module.add_function(wrap_pyfunction!(drawn_plant_json, module)?)
}

/// Everything a simulation depends on, apart from the seed.
///
/// world: a name of `worlds()`, or the path of a TOML file; without it the world of `text`, or careful.
/// text: scenario as TOML; missing keys keep their defaults.
/// changes: changes of single keys, as "plant.friction=0.5"; later ones count.
/// axles: number of axles, 2 to 5, as the change "robot.geometry.axles=3".
///
/// A refused key raises InputError with its field, value and allowed values.
#[pyclass(frozen, eq, module = "cfmmr")]
#[derive(Clone, PartialEq)]
pub struct Scenario {
    /// The scenario.
    pub inner: scenario::Scenario,
    source: Source,
}

/// World, text and changes from which a scenario was made.
#[derive(Clone, PartialEq)]
struct Source {
    world: Option<String>,
    text: String,
    changes: Vec<String>,
}

impl Scenario {
    fn of(source: Source) -> PyResult<Self> {
        let Source {
            world,
            text,
            changes,
        } = &source;
        let inner = scenario::Scenario::parse(world.as_deref(), text, "scenario", changes);
        Ok(Self {
            inner: inner.map_err(|error| of(&error))?,
            source,
        })
    }

    /// Copy with further changes of keys.
    pub fn with(&self, changes: impl IntoIterator<Item = String>) -> PyResult<Self> {
        let mut source = self.source.clone();
        source.changes.extend(changes);
        Self::of(source)
    }
}

#[pymethods]
impl Scenario {
    #[new]
    #[pyo3(signature = (world=None, text=String::new(), changes=Vec::new(), axles=None))]
    fn new(
        world: Option<String>,
        text: String,
        mut changes: Vec<String>,
        axles: Option<i64>,
    ) -> PyResult<Self> {
        changes.extend(axles.map(|axles| format!("robot.geometry.axles={axles}")));
        Self::of(Source {
            world,
            text,
            changes,
        })
    }

    /// Reads a scenario from a TOML file.
    #[staticmethod]
    #[pyo3(signature = (path, world=None, changes=Vec::new()))]
    fn load(path: PathBuf, world: Option<String>, changes: Vec<String>) -> PyResult<Self> {
        let (text, _) = toml_file::read(Some(&path)).map_err(|error| of(&error))?;
        Self::new(world, text, changes, None)
    }

    /// Copy with further changes of keys, as "plant.friction=0.5".
    #[pyo3(signature = (*changes))]
    fn changed(&self, changes: Vec<String>) -> PyResult<Self> {
        self.with(changes)
    }

    /// Scenarios of the rows of `cfmmr posture`: main, pair, joint or all. Fusions of one pair of axles are left out with
    /// more than two axles.
    #[pyo3(signature = (rows="main"))]
    fn rows(&self, rows: &str) -> PyResult<Vec<Self>> {
        let rows: &[Variant] = match rows {
            "main" => &Variant::MAIN,
            "pair" => &Variant::PAIR,
            "joint" => &Variant::JOINT,
            "all" => &Variant::ALL,
            _ => return Err(refused("rows", rows, "main, pair, joint or all")),
        };
        let robot = self.inner.robot.topology();
        let rows = rows.iter().filter(|row| row.fits(robot));
        rows.map(|row| self.variant(row)).collect()
    }

    /// Name of the world, with ", changed" if a value differs.
    #[getter]
    fn world(&self) -> String {
        self.inner.world.label()
    }

    /// Sensors and fusion as in a row of `cfmmr posture`.
    #[getter]
    fn label(&self) -> String {
        Variant::of(&self.inner).label()
    }

    /// The whole scenario as TOML.
    fn toml(&self) -> PyResult<String> {
        self.inner.to_toml().map_err(|error| of(&error))
    }

    /// Value of a key, for example "plant.friction"; a table gives a dict.
    fn __getitem__<'py>(&self, py: Python<'py>, key: &str) -> PyResult<Bound<'py, PyAny>> {
        let failed = |error: toml::ser::Error| PyKeyError::new_err(error.to_string());
        let table = Value::try_from(&self.inner).map_err(failed)?;
        let value = key
            .split('.')
            .try_fold(&table, |table, part| table.get(part));
        let value = value.ok_or_else(|| PyKeyError::new_err(key.to_owned()))?;
        python_value(py, value)
    }

    fn __reduce__(&self, py: Python<'_>) -> PyResult<(Py<PyAny>, Py<PyAny>)> {
        let Source {
            world,
            text,
            changes,
        } = &self.source;
        let class = py.get_type::<Self>().into_any().unbind();
        Ok((class, (world, text, changes).into_py_any(py)?))
    }

    fn __repr__(&self) -> String {
        let Source {
            world,
            text,
            changes,
        } = &self.source;
        let world = world.as_ref().map(|world| format!("world={world:?}"));
        let text = (!text.is_empty()).then(|| format!("text={text:?}"));
        let changes = (!changes.is_empty()).then(|| format!("changes={changes:?}"));
        let parts: Vec<_> = world.into_iter().chain(text).chain(changes).collect();
        format!("Scenario({})", parts.join(", "))
    }
}

impl Scenario {
    /// The scenario with the sensors and the fusion of a row.
    fn variant(&self, row: &Variant) -> PyResult<Self> {
        let mut changes = vec![
            format!("mission.rps={}", row.rps),
            format!("robot.lead.fusion.mode=\"{}\"", row.fusion()),
        ];
        if self.inner.world.sensors.gyro.fitted != row.imu {
            for sensor in ["gyro", "accelerometer"] {
                changes.push(format!("sensors.{sensor}.fitted={}", row.imu));
            }
        }
        self.with(changes)
    }
}

fn python_value<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::String(text) => text.into_bound_py_any(py)?,
        Value::Integer(number) => number.into_bound_py_any(py)?,
        Value::Float(number) => number.into_bound_py_any(py)?,
        Value::Boolean(flag) => flag.into_bound_py_any(py)?,
        Value::Datetime(time) => time.to_string().into_bound_py_any(py)?,
        Value::Array(list) => {
            let list: PyResult<Vec<_>> = list.iter().map(|it| python_value(py, it)).collect();
            PyList::new(py, list?)?.into_any()
        }
        Value::Table(table) => {
            let dict = PyDict::new(py);
            for (key, value) in table {
                dict.set_item(key, python_value(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Seed and trial of a drawn robot; trial 0 by default.
pub fn drawn_by(seed: &Bound<'_, PyAny>, trial: Option<&Bound<'_, PyAny>>) -> PyResult<(u64, u64)> {
    let trial = trial.map(|trial| arrays::whole("trial", trial));
    Ok((
        arrays::whole("seed", seed)?,
        trial.transpose()?.unwrap_or(0),
    ))
}

/// Names of the built-in worlds.
#[pyfunction]
fn worlds() -> Vec<&'static str> {
    world::NAMES.to_vec()
}

/// Keys of a table or all keys, as JSON.
#[pyfunction]
#[pyo3(signature = (table=None))]
fn keys_json(table: Option<&str>) -> PyResult<String> {
    keys::json(table).map_err(|error| of(&error))
}

/// Errors of a drawn robot, as JSON.
#[pyfunction]
fn drawn_json(
    scenario: &Scenario,
    seed: &Bound<'_, PyAny>,
    trial: &Bound<'_, PyAny>,
) -> PyResult<String> {
    let (seed, trial) = drawn_by(seed, Some(trial))?;
    let scenario = &scenario.inner;
    let drawn = scenario.world.draw(scenario.robot.topology(), seed, trial);
    Ok(json!(drawn).to_string())
}

/// Constants of a drawn robot's plant, its true start and the true positions of its gauges, as JSON.
#[pyfunction]
fn drawn_plant_json(
    scenario: &Scenario,
    seed: &Bound<'_, PyAny>,
    trial: &Bound<'_, PyAny>,
) -> PyResult<String> {
    let (seed, trial) = drawn_by(seed, Some(trial))?;
    let scenario = &scenario.inner;
    let world = &scenario.world;
    let drawn = world.draw(scenario.robot.topology(), seed, trial);
    let config = world.plant_config_of(&drawn, scenario.mission.rps);
    let config = config.map_err(|error| of(&error.into()))?;
    let start = scenario.mission.start;
    let start: [f64; 3] = std::array::from_fn(|i| start[i] + drawn.placement[i]);
    let bridge = &world.sensors.bridge;
    let frame = |errors: &world::drawn::FrameErrors| -> Vec<f64> {
        let nominal = bridge.gauges_m.iter();
        nominal
            .zip(errors.gauge_shift_m)
            .map(|(place, shift)| place + shift)
            .collect()
    };
    let gauges: Vec<_> = drawn.frames.iter().map(frame).collect();
    let result: Json = json!({
        "plant": config,
        "start": start,
        "gauges_m": gauges,
        "half_thickness_m": bridge.half_thickness_m,
    });
    Ok(result.to_string())
}
