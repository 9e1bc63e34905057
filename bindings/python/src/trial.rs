//! Whole trials: one with its log, or many on threads.

use crate::arrays;
use crate::errors::{RunError, of};
use crate::own::{Failure, Makers};
use crate::physics::{Work, beside};
use crate::robot::route;
use crate::scenario::{Scenario, drawn_by};
use host_sim::base::error::Error;
use host_sim::run::path_run::{self, PathEpoch, PathMode, Route};
use host_sim::run::regulate::{Outcome, regulate_on};
use host_sim::run::robot::{Record, Robot};
use host_sim::scenario;
use host_sim::scenario::variant::Variant;
use output::files::Cell;
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use recording::csv;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Epochs between two looks for a signal such as Ctrl-C: 1 s of simulated time.
const SIGNAL_EPOCHS: u32 = 100;
/// Time between two looks for a signal while threads run trials.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Most threads that run trials.
const MAX_THREADS: u64 = 1024;

/// Adds the functions to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(run_columns, module)?)?;
    module.add_function(wrap_pyfunction!(path_columns, module)?)?;
    module.add_function(wrap_pyfunction!(run_rows, module)?)
}

/// Columns of a table.
#[derive(Default)]
struct Columns {
    names: Vec<String>,
    columns: Vec<Column>,
}

/// Values of a column. A column of whole numbers stays whole; an empty cell is NaN or an empty text.
enum Column {
    Numbers { values: Vec<f64>, whole: bool },
    Words(Vec<String>),
}

impl Columns {
    fn new(names: Vec<String>) -> Self {
        Self {
            names,
            columns: Vec::new(),
        }
    }

    fn push(&mut self, cells: impl Iterator<Item = Cell>) {
        if self.columns.is_empty() {
            let empty = |cell| {
                let mut column = match cell {
                    Cell::Text(_) => Column::Words(Vec::new()),
                    _ => Column::Numbers {
                        values: Vec::new(),
                        whole: true,
                    },
                };
                column.push(cell);
                column
            };
            self.columns = cells.map(empty).collect();
            return;
        }
        for (column, cell) in self.columns.iter_mut().zip(cells) {
            column.push(cell);
        }
    }

    fn into_dict(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let dict = PyDict::new(py);
        self.put_into(&dict)?;
        Ok(dict)
    }

    fn put_into(self, dict: &Bound<'_, PyDict>) -> PyResult<()> {
        let py = dict.py();
        for (name, column) in self.names.into_iter().zip(self.columns) {
            let values = match column {
                Column::Words(words) => words.into_bound_py_any(py)?,
                Column::Numbers {
                    values,
                    whole: true,
                } => {
                    let whole = values.iter().map(|&value| value as i64);
                    arrays::row(py, whole.collect()).into_any()
                }
                Column::Numbers { values, .. } => arrays::row(py, values).into_any(),
            };
            dict.set_item(name, values)?;
        }
        Ok(())
    }
}

/// Array of seeds or numbers of trials: int64, or uint64 if a number does not fit.
fn whole_numbers(py: Python<'_>, numbers: impl Iterator<Item = u64>) -> Bound<'_, PyAny> {
    let numbers: Vec<u64> = numbers.collect();
    let signed = numbers.iter().map(|&number| i64::try_from(number));
    match signed.collect::<Result<Vec<_>, _>>() {
        Ok(signed) => arrays::row(py, signed).into_any(),
        Err(_) => arrays::row(py, numbers).into_any(),
    }
}

impl Column {
    fn push(&mut self, cell: Cell) {
        match self {
            Self::Words(words) => words.push(cell.to_string()),
            Self::Numbers { values, whole } => {
                let number = match cell {
                    Cell::Double(value) => value,
                    Cell::Single(value) => value.into(),
                    Cell::Integer(value) => {
                        values.push(value as f64);
                        return;
                    }
                    Cell::Text(_) | Cell::Empty => f64::NAN,
                };
                *whole = false;
                values.push(number);
            }
        }
    }
}

/// Parts of the user for the trials of a run: functions or classes that make a controller, an estimator and a simulator.
#[derive(FromPyObject)]
struct Parts {
    controller: Option<Py<PyAny>>,
    estimator: Option<Py<PyAny>>,
    plant: Option<Py<PyAny>>,
}

impl Parts {
    /// The scenario with controller and estimator.
    fn in_boards(&self, py: Python<'_>, scenario: &Scenario, failure: &Failure) -> Scenario {
        let part = |part: &Option<Py<PyAny>>| part.as_ref().map(|it| it.clone_ref(py));
        let makers = Makers {
            controller: part(&self.controller),
            estimator: part(&self.estimator),
        };
        let mut scenario = scenario.clone();
        scenario.inner.own = makers.own(failure);
        scenario
    }
}

/// Row of an outcome, as in trials.csv of `cfmmr posture`.
fn row(scenario: &Scenario, trial: u64, outcome: &Outcome) -> Vec<(&'static str, Cell)> {
    let goal = scenario.inner.mission.goal;
    let variant = Variant::of(&scenario.inner);
    csv::of_trial(&variant, trial as usize, outcome, goal).into_cells()
}

/// Log and end of a trial.
#[pyfunction]
fn run_columns<'py>(
    py: Python<'py>,
    scenario: &Scenario,
    seed: &Bound<'py, PyAny>,
    trial: &Bound<'py, PyAny>,
    parts: Parts,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    let trial = drawn_by(seed, Some(trial))?;
    let (log, outcome) = logged(py, scenario, trial, &parts, Regulation)?;
    let end = PyDict::new(py);
    for (name, cell) in row(scenario, trial.1, &outcome) {
        end.set_item(name, arrays::cell(py, cell)?)?;
    }
    end.set_item("trial", trial.1)?;
    Ok((log.into_dict(py)?, end))
}

/// Log and end of a run along a path: a name or CSV file of `cfmmr follow`, or waypoints of shape (n, 2), m.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn path_columns<'py>(
    py: Python<'py>,
    scenario: &Scenario,
    path: &Bound<'py, PyAny>,
    laps: &Bound<'py, PyAny>,
    timed: bool,
    seed: &Bound<'py, PyAny>,
    trial: &Bound<'py, PyAny>,
    parts: Parts,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    let trial = drawn_by(seed, Some(trial))?;
    let route = route(&scenario.inner, path, laps)?;
    let [x, y, phi] = route.start();
    let scenario = scenario.with(vec![format!("mission.start=[{x:?}, {y:?}, {phi:?}]")])?;
    let mode = match timed {
        true => PathMode::Track,
        false => PathMode::Follow,
    };
    let drive = PathDrive { route, mode };
    let (log, outcome) = logged(py, &scenario, trial, &parts, drive)?;
    let end = PyDict::new(py);
    for (name, cell) in csv::of_path(&outcome).into_cells() {
        end.set_item(name, arrays::cell(py, cell)?)?;
    }
    Ok((log.into_dict(py)?, end))
}

/// A task whose epochs are logged.
trait Logged: Send + Sync {
    type Outcome: Send;

    fn on(
        &self,
        robot: &mut impl Robot,
        scenario: &scenario::Scenario,
        observe: impl FnMut(&Record),
    ) -> Result<Self::Outcome, Error>;
}

/// Regulation to the goal of the scenario.
struct Regulation;

impl Logged for Regulation {
    type Outcome = Outcome;

    fn on(
        &self,
        robot: &mut impl Robot,
        scenario: &scenario::Scenario,
        observe: impl FnMut(&Record),
    ) -> Result<Outcome, Error> {
        regulate_on(robot, scenario, observe)
    }
}

/// Drive along a path.
struct PathDrive {
    route: Route,
    mode: PathMode,
}

impl Logged for PathDrive {
    type Outcome = path_run::Outcome;

    fn on(
        &self,
        robot: &mut impl Robot,
        scenario: &scenario::Scenario,
        mut observe: impl FnMut(&Record),
    ) -> Result<path_run::Outcome, Error> {
        let observe = |epoch: &PathEpoch| observe(&epoch.record);
        path_run::drive_on(robot, scenario, &self.route, self.mode, observe)
    }
}

/// Log and outcome of a task in one trial (seed and number).
fn logged<T: Logged>(
    py: Python<'_>,
    scenario: &Scenario,
    trial: (u64, u64),
    parts: &Parts,
    task: T,
) -> PyResult<(Columns, T::Outcome)> {
    let interrupt = Arc::new(AtomicBool::new(false));
    let failure = Failure::new(interrupt.clone());
    let scenario = parts.in_boards(py, scenario, &failure);
    py.detach(|| {
        let robot = scenario.inner.robot.topology();
        let mut log = Columns::new(csv::record_columns(robot));
        let rows = csv::RecordRows::new(robot);
        let (mut signal, mut epochs) = (Ok(()), 0);
        let observe = |record: &Record| {
            log.push(rows.cells(record));
            epochs += 1;
            if epochs % SIGNAL_EPOCHS == 0 && signal.is_ok() {
                signal = Python::attach(|py| py.check_signals());
                // Set only: an exception of the user's parts may have set it before.
                if signal.is_err() {
                    interrupt.store(true, Relaxed);
                }
            }
        };
        let work = LoggedOn {
            task,
            scenario: &scenario.inner,
            interrupt: &interrupt,
            observe,
        };
        let outcome = beside(&scenario, trial, parts.plant.as_ref(), &failure, work);
        signal?;
        failure.check()?;
        Ok((log, outcome.map_err(|it| of(&it))?))
    })
}

/// A logged task on the robot of a trial.
struct LoggedOn<'a, T, F> {
    task: T,
    scenario: &'a scenario::Scenario,
    interrupt: &'a Arc<AtomicBool>,
    observe: F,
}

impl<T: Logged, F: FnMut(&Record)> Work for LoggedOn<'_, T, F> {
    type Result = T::Outcome;

    fn on(self, robot: &mut impl Robot) -> Result<T::Outcome, Error> {
        robot.control_mut().interrupt = Some(self.interrupt.clone());
        self.task.on(robot, self.scenario, self.observe)
    }
}

/// Table of trials, a row a trial: all trials of the first scenario, then of the next.
#[pyfunction]
fn run_rows<'py>(
    py: Python<'py>,
    scenarios: Vec<Bound<'py, Scenario>>,
    trials: Vec<[Bound<'py, PyAny>; 2]>,
    threads: &Bound<'py, PyAny>,
    parts: Parts,
) -> PyResult<Bound<'py, PyDict>> {
    let threads = arrays::whole_in("threads", threads, 1..=u64::MAX)?.min(MAX_THREADS) as usize;
    let trials = trials
        .iter()
        .map(|[seed, trial]| drawn_by(seed, Some(trial)));
    let trials = trials.collect::<PyResult<Vec<_>>>()?;
    let interrupt = Arc::new(AtomicBool::new(false));
    let failure = Failure::new(interrupt.clone());
    let scenarios = scenarios.iter();
    let scenarios: Vec<Scenario> = scenarios
        .map(|it| parts.in_boards(py, it.get(), &failure))
        .collect();
    let count = scenarios.len() * trials.len();
    let outcomes = py.detach(|| {
        let outcomes = run_all(count, threads, &interrupt, |k| {
            let scenario = &scenarios[k / trials.len()];
            let work = LoggedOn {
                task: Regulation,
                scenario: &scenario.inner,
                interrupt: &interrupt,
                observe: |_: &Record| (),
            };
            let trial = trials[k % trials.len()];
            beside(scenario, trial, parts.plant.as_ref(), &failure, work)
        });
        failure.check()?;
        outcomes
    })?;
    let mut table = Columns::default();
    for (k, outcome) in outcomes.iter().enumerate() {
        let scenario = &scenarios[k / trials.len()];
        let cells = row(scenario, trials[k % trials.len()].1, outcome);
        if table.names.is_empty() {
            table.names = cells.iter().map(|(name, _)| (*name).to_owned()).collect();
        }
        table.push(cells.into_iter().map(|(_, cell)| cell));
    }
    let all = || (0..count).map(|k| trials[k % trials.len()]);
    let dict = PyDict::new(py);
    dict.set_item("seed", whole_numbers(py, all().map(|(seed, _)| seed)))?;
    table.put_into(&dict)?;
    dict.set_item("trial", whole_numbers(py, all().map(|(_, trial)| trial)))?;
    Ok(dict)
}

/// Results of `count` jobs in order, on `threads` threads. A signal or the first error ends all jobs.
fn run_all(
    count: usize,
    threads: usize,
    interrupt: &AtomicBool,
    job: impl Fn(usize) -> Result<Outcome, Error> + Sync,
) -> PyResult<Vec<Outcome>> {
    let next = AtomicUsize::new(0);
    let results: Mutex<Vec<Option<Result<Outcome, Error>>>> =
        Mutex::new((0..count).map(|_| None).collect());
    let (ended, wait) = mpsc::channel::<()>();
    let mut signal = Ok(());
    thread::scope(|scope| {
        for _ in 0..threads.min(count) {
            let ended = ended.clone();
            let (job, next, results) = (&job, &next, &results);
            let work = move || {
                // Held until this thread ends.
                let _ended = ended;
                while !interrupt.load(Relaxed) {
                    let k = next.fetch_add(1, Relaxed);
                    if k >= count {
                        break;
                    }
                    let result = job(k);
                    if result.is_err() {
                        interrupt.store(true, Relaxed);
                    }
                    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
                    results[k] = Some(result);
                }
            };
            // Attached once: the calls of the user's parts then need no new state of a thread.
            scope.spawn(move || Python::attach(|py| py.detach(work)));
        }
        drop(ended);
        while wait.recv_timeout(SIGNAL_INTERVAL) == Err(RecvTimeoutError::Timeout) {
            if signal.is_ok() {
                signal = Python::attach(|py| py.check_signals());
                if signal.is_err() {
                    interrupt.store(true, Relaxed);
                }
            }
        }
    });
    signal?;
    let results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut error = None;
    let mut outcomes = Vec::new();
    for result in results {
        match result {
            Some(Ok(outcome)) => outcomes.push(outcome),
            Some(Err(found)) => {
                error.get_or_insert(found);
            }
            None => {}
        }
    }
    match error {
        Some(error) => Err(of(&error)),
        // Ended by an exception of a part of the user.
        None if outcomes.len() < count => Err(RunError::new_err("interrupted")),
        None => Ok(outcomes),
    }
}
