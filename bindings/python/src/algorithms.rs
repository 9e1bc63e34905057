//! Single algorithms of the boards, each with the parameters of a scenario.

use crate::arrays::{self, Row, Rows, covariance, narrow, rows, single};
use crate::errors::{of, refused};
use crate::scenario::Scenario;
use core_algos::beam::sensor::{PostureSolver, Solution};
use core_algos::beam::strip::MAX_TURN;
use core_algos::beam::{GaugeMask, MAX_GAUGES, Method};
use core_algos::config::ConfigError;
use core_algos::control::cascade::{self, AxleReference, Motion};
use core_algos::control::dynamic::{self, Dynamic};
use core_algos::control::kinematic::{Direction, Law, PolarError};
use core_algos::control::planner::{self, Progress, Segment};
use core_algos::fusion::Estimate;
use core_algos::fusion::ekf::{self, Fix, Measurements, Verdict};
use core_algos::fusion::intersection::{self, Criterion, ExtendedEstimate};
use core_algos::fusion::ipec;
use core_algos::fusion::robot::{self, Increment, Inputs, RobotFusion};
use core_algos::math::{AxleLoad, Posture, Steering, Twist};
use core_algos::node::robot::RobotConfig;
use plant::frame::Strip;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Adds the classes and functions to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<StrainFit>()?;
    module.add_class::<AxleFilter>()?;
    module.add_class::<Ipec>()?;
    module.add_class::<Fusion>()?;
    module.add_class::<KinematicLaw>()?;
    module.add_class::<Cascade>()?;
    module.add_class::<DynamicLaw>()?;
    module.add_class::<Planner>()?;
    module.add_function(wrap_pyfunction!(covariance_intersection, module)?)?;
    module.add_function(wrap_pyfunction!(strip_equilibrium, module)?)
}

/// Algorithm built from the parameters of a scenario, with derived values filled in.
fn build<T>(
    scenario: &Scenario,
    build: impl FnOnce(&RobotConfig) -> Result<T, ConfigError>,
) -> PyResult<T> {
    build(&scenario.inner.completed_robot()).map_err(|error| of(&error.into()))
}

fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A posture, m, m, rad.
fn posture(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Posture> {
    single::<3>(name, value).map(Posture::from)
}

fn estimate(
    [name, matrix]: [&str; 2],
    value: &Bound<'_, PyAny>,
    covariance: &Bound<'_, PyAny>,
) -> PyResult<Estimate> {
    let covariance = self::covariance(matrix, covariance)?;
    Ok(Estimate::new(posture(name, value)?, covariance))
}

/// Posture and covariance as arrays of shape (3,) and (3, 3).
fn pair<'py>(py: Python<'py>, estimate: &Estimate) -> PyResult<(Row<'py>, Rows<'py>)> {
    let posture: [f32; 3] = estimate.posture.into();
    let posture = arrays::row(py, posture.map(f64::from).to_vec());
    Ok((posture, rows(py, &estimate.covariance)?))
}

/// Word for what a filter did with a measurement.
fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Used => "used",
        Verdict::Gated => "gated",
        Verdict::Invalid => "invalid",
        Verdict::Absent => "absent",
    }
}

/// Posture of the frame's tip from the strains of one instant (paper section VI A), as on the beam board.
///
/// Parameters: tables robot.beam and robot.geometry.
#[pyclass(frozen, module = "cfmmr")]
pub struct StrainFit {
    solver: PostureSolver,
    gauges: usize,
    /// Largest magnitude of a strain.
    limit: f32,
}

impl StrainFit {
    fn solve(&self, strain: &[f64]) -> Option<Solution> {
        let mut strains = [0.0; MAX_GAUGES];
        for (to, strain) in strains.iter_mut().zip(strain) {
            *to = *strain as f32;
        }
        self.solver.solve(&strains, GaugeMask::first(self.gauges))
    }

    fn check(&self, strains: &[f64]) -> PyResult<()> {
        let wrong = |strain: &f64| !(strain.abs() <= self.limit.into());
        match strains.iter().position(wrong) {
            Some(place) => Err(refused(
                format!("strain[{place}]"),
                strains[place],
                format!("a number from {:e} to {:e}", -self.limit, self.limit),
            )),
            None => Ok(()),
        }
    }
}

#[pymethods]
impl StrainFit {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        let config = scenario.inner.completed_robot().beam;
        let solver = build(scenario, |robot| {
            PostureSolver::new(robot.beam.strip.build()?, config.method, config.segments)
        })?;
        Ok(Self {
            solver,
            gauges: config.strip.gauges_m.count(),
            limit: MAX_TURN * config.strip.half_thickness_m / config.strip.length_m,
        })
    }

    /// Number of gauges.
    #[getter]
    fn gauges(&self) -> usize {
        self.gauges
    }

    /// Fit of the strains, shape (gauges,), from the root.
    ///
    /// Gives a dict: posture (3,), m, m, rad, of the front axle in the rear axle's coordinates; covariance (3, 3);
    /// wrench (4,), force forward and to the left (N), moment at root and tip (N m), or None; chi_square or None; method,
    /// "elastica", or "quadrature" where the elastica does not fit.
    fn fit<'py>(&self, py: Python<'py>, strain: &Bound<'_, PyAny>) -> PyResult<Bound<'py, PyDict>> {
        let strain = arrays::numbers("strain", strain, &[Some(self.gauges)])?;
        self.check(&strain)?;
        let Some(solution) = py.detach(|| self.solve(&strain)) else {
            return Err(refused(
                "strain",
                format!("{strain:?}"),
                "strains that a posture fits",
            ));
        };
        let relative = Estimate::new(solution.relative.posture, solution.relative.covariance);
        let (posture, covariance) = pair(py, &relative)?;
        let wrench = solution.wrench.map(|wrench| {
            let values = [wrench.fx, wrench.fy, wrench.root_moment, wrench.tip_moment];
            arrays::row(py, values.map(f64::from).to_vec())
        });
        let method = match solution.method {
            Method::Piecewise => "piecewise",
            Method::Quadrature => "quadrature",
            Method::Elastica => "elastica",
        };
        let result = PyDict::new(py);
        result.set_item("posture", posture)?;
        result.set_item("covariance", covariance)?;
        result.set_item("wrench", wrench)?;
        result.set_item("chi_square", solution.chi_square)?;
        result.set_item("method", method)?;
        Ok(result)
    }

    /// Postures of many sets of strains, shape (n, gauges) to (n, 3): m, m, rad. NaN where no posture fits.
    fn postures<'py>(&self, py: Python<'py>, strain: &Bound<'_, PyAny>) -> PyResult<Rows<'py>> {
        let strain = arrays::numbers("strain", strain, &[None, Some(self.gauges)])?;
        self.check(&strain)?;
        let postures = py.detach(|| {
            let sets = strain.chunks_exact(self.gauges);
            let posture = |set| match self.solve(set) {
                Some(solution) => solution.relative.posture.into(),
                None => [f32::NAN; 3],
            };
            sets.map(posture).collect::<Vec<[f32; 3]>>()
        });
        rows(py, &postures)
    }
}

/// Extended Kalman filter of an axle (paper section VI B): encoders and inertial sensors.
///
/// State: x, y (m), heading (rad), v (m/s), yaw rate (rad/s), and the rates of both. state: shape (7,), by default zero;
/// covariance: shape (7, 7), by default 1e-6 on the diagonal. Parameters: table robot.axle.filter.
#[pyclass(frozen, module = "cfmmr")]
pub struct AxleFilter {
    filter: ekf::AxleFilter,
    state: Mutex<ekf::State>,
}

#[pymethods]
impl AxleFilter {
    #[new]
    #[pyo3(signature = (scenario, state=None, covariance=None))]
    fn new(
        scenario: &Scenario,
        state: Option<&Bound<'_, PyAny>>,
        covariance: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let filter = build(scenario, |robot| robot.axle.filter.build())?;
        let mut start = [[0.0; ekf::N]; ekf::N];
        (0..ekf::N).for_each(|i| start[i][i] = 1e-6);
        let covariance = covariance.map(|it| self::covariance("covariance", it));
        let state = state.map(|state| single::<{ ekf::N }>("state", state));
        let state = state.transpose()?.unwrap_or_default();
        let covariance = covariance.transpose()?.unwrap_or(start);
        Ok(Self {
            filter,
            state: Mutex::new(ekf::State::from_parts(state, &covariance)),
        })
    }

    /// One step of prediction, then the update by the speeds of the wheels over ground (m/s), the yaw rate (rad/s) and
    /// the forward acceleration (m/s²). None leaves a measurement out; NaN counts as a bad sample. Gives the verdict on
    /// each measurement: used, gated, invalid or absent.
    #[pyo3(signature = (left=None, right=None, gyro=None, acceleration=None))]
    fn step(
        &self,
        left: Option<f32>,
        right: Option<f32>,
        gyro: Option<f32>,
        acceleration: Option<f32>,
    ) -> [&'static str; 4] {
        let measurements = Measurements {
            left_m_s: left,
            right_m_s: right,
            gyro_rad_s: gyro,
            acceleration_m_s2: acceleration,
        };
        let verdicts = self.filter.step(&mut lock(&self.state), &measurements);
        [
            verdicts.left,
            verdicts.right,
            verdicts.gyro,
            verdicts.accelerometer,
        ]
        .map(word)
    }

    /// Update by a posture, shape (3,), m, m, rad, with its covariance, shape (3, 3). Gives the verdict.
    fn update_posture(
        &self,
        posture: &Bound<'_, PyAny>,
        covariance: &Bound<'_, PyAny>,
    ) -> PyResult<&'static str> {
        let posture = self::posture("posture", posture)?;
        let covariance = self::covariance::<3>("covariance", covariance)?;
        let Some(fix) = Fix::new(&covariance) else {
            return Err(refused(
                "covariance",
                "not positive definite",
                "positive definite",
            ));
        };
        let mut state = lock(&self.state);
        Ok(word(self.filter.update_fix(&mut state, &posture, &fix)))
    }

    /// The state, shape (7,).
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Row<'py> {
        let state = lock(&self.state);
        let (twist, rates) = (state.twist(), state.accelerations());
        let motion = [twist.v, twist.omega, rates[0], rates[1]].map(f64::from);
        arrays::row(
            py,
            state.precise_posture().into_iter().chain(motion).collect(),
        )
    }

    /// Covariance of the state, shape (7, 7).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        rows(py, &lock(&self.state).covariance().wide_matrix())
    }
}

/// Covariance intersection of two postures (paper section VI B): a and b of shape (3,), m, m, rad, with covariances A
/// and B of shape (3, 3).
///
/// criterion: what the weight minimises, "determinant", or "trace" of diag(1, 1, 0.2²) P. Gives the weight of a, the
/// posture and its covariance.
#[pyfunction]
#[pyo3(signature = (a, a_covariance, b, b_covariance, criterion="determinant"))]
fn covariance_intersection<'py>(
    py: Python<'py>,
    a: &Bound<'_, PyAny>,
    a_covariance: &Bound<'_, PyAny>,
    b: &Bound<'_, PyAny>,
    b_covariance: &Bound<'_, PyAny>,
    criterion: &str,
) -> PyResult<(f32, Row<'py>, Rows<'py>)> {
    let criterion = match criterion {
        "determinant" => Criterion::Determinant,
        "trace" => Criterion::Trace,
        _ => return Err(refused("criterion", criterion, "determinant or trace")),
    };
    let extended = |names, posture, covariance| -> PyResult<ExtendedEstimate> {
        let estimate = estimate(names, posture, covariance)?;
        let posture: [f32; 3] = estimate.posture.into();
        Ok(ExtendedEstimate {
            posture: posture.map(f64::from),
            covariance: estimate.covariance.map(|row| row.map(f64::from)),
        })
    };
    let a = extended(["a", "a_covariance"], a, a_covariance)?;
    let b = extended(["b", "b_covariance"], b, b_covariance)?;
    let config = intersection::Config {
        criterion,
        ..intersection::Config::default()
    };
    let intersection = config.build().map_err(|error| of(&error.into()))?;
    let Some(fused) = intersection.fuse_extended(&a, &b) else {
        let allowed = "covariances far enough from singular, and of similar size";
        return Err(refused(
            "a_covariance, b_covariance",
            "nearly singular",
            allowed,
        ));
    };
    let (posture, covariance) = pair(py, &fused.estimate)?;
    Ok((fused.omega, posture, covariance))
}

/// Internal posture error correction: odometry of two axles, corrected by their measured relative posture.
///
/// axle1, axle2: start postures of the front and the rear axle, shape (3,), m, m, rad. Parameters: table
/// robot.lead.fusion.ipec.
#[pyclass(frozen, module = "cfmmr")]
pub struct Ipec {
    ipec: ipec::Ipec,
    state: Mutex<ipec::State>,
}

#[pymethods]
impl Ipec {
    #[new]
    fn new(
        scenario: &Scenario,
        axle1: &Bound<'_, PyAny>,
        axle2: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let (axle1, axle2) = (posture("axle1", axle1)?, posture("axle2", axle2)?);
        far("axle2", axle1.distance(axle2))?;
        Ok(Self {
            ipec: build(scenario, |robot| robot.lead.fusion.ipec.build())?,
            state: Mutex::new(ipec::State::new(axle1, axle2)),
        })
    }

    /// One interval. advance: shape (4,), m: left and right wheel of axle 1, then of axle 2. relative: shape (3,), m, m,
    /// rad: axle 2 in the coordinates of axle 1. Gives the corrections of both headings, rad.
    fn step(&self, advance: &Bound<'_, PyAny>, relative: &Bound<'_, PyAny>) -> PyResult<[f32; 2]> {
        let advance = single::<4>("advance", advance)?;
        let relative = posture("relative", relative)?;
        far("relative", relative.distance(Posture::ORIGIN))?;
        let mut state = lock(&self.state);
        let mut next = *state;
        let Some(correction) = self.ipec.step(&mut next, &advance, &relative) else {
            let allowed = "advances that leave the axles apart";
            return Err(refused("advance", format!("{advance:?}"), allowed));
        };
        *state = next;
        Ok(correction.heading)
    }

    /// Postures of both axles, shape (2, 3): m, m, rad.
    #[getter]
    fn postures<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        rows(py, &lock(&self.state).precise_postures())
    }

    /// Variance of the heading from axle 1 to axle 2 since the start, rad².
    #[getter]
    fn variance(&self) -> f32 {
        lock(&self.state).variance
    }
}

/// Refuses two points closer than the algorithm can use.
fn far(name: &str, distance: f32) -> PyResult<()> {
    match distance >= ipec::MIN_BASELINE_M {
        true => Ok(()),
        false => Err(refused(
            format!("distance of {name}"),
            distance,
            format!("at least {} m", ipec::MIN_BASELINE_M),
        )),
    }
}

/// Fusion of both axles and the frame on the lead node: the joint filter, or with robot.lead.fusion.mode of the scenario
/// covariance intersection with or without IPEC.
///
/// posture, covariance: midpoint at the start, shape (3,), m, m, rad, and (3, 3); by default the scenario's start with
/// the placement error that is configured in the robot. Parameters: table robot.lead.fusion.
#[pyclass(frozen, module = "cfmmr")]
pub struct Fusion {
    fusion: RobotFusion,
    state: Mutex<(robot::State, robot::Output)>,
}

#[pymethods]
impl Fusion {
    #[new]
    #[pyo3(signature = (scenario, posture=None, covariance=None))]
    fn new(
        scenario: &Scenario,
        posture: Option<&Bound<'_, PyAny>>,
        covariance: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let fusion = build(scenario, |robot| robot.lead.fusion.build())?;
        let mission = &scenario.inner.mission;
        let start = Posture::from(mission.start.map(|value| value as f32));
        let robot = scenario.inner.completed_robot();
        let mut placement = robot.placement(start, &mission.configured_placement());
        if let Some(posture) = posture {
            placement.center.posture = self::posture("posture", posture)?;
        }
        if let Some(covariance) = covariance {
            placement.center.covariance = self::covariance("covariance", covariance)?;
        }
        let (center, relative) = (&placement.center, &placement.relative);
        let state = fusion.start(center, relative, placement.floor_drift);
        let output = robot::Output {
            robot: *center,
            ..robot::Output::default()
        };
        Ok(Self {
            fusion,
            state: Mutex::new((state, output)),
        })
    }

    /// One epoch of 10 ms. front, rear: motion of each axle by its odometry since the last epoch, a pair of its posture
    /// in the coordinates it had, shape (3,), m, m, rad, and its covariance, shape (3, 3). beam: the front axle in the
    /// coordinates of the rear axle, a pair likewise. None is a missing message. Gives what the filter did with the
    /// beam: used, gated, invalid or absent.
    #[pyo3(signature = (front=None, rear=None, beam=None))]
    fn step(
        &self,
        front: Option<[Bound<'_, PyAny>; 2]>,
        rear: Option<[Bound<'_, PyAny>; 2]>,
        beam: Option<[Bound<'_, PyAny>; 2]>,
    ) -> PyResult<&'static str> {
        let read = |names, pair: Option<[Bound<'_, PyAny>; 2]>| {
            pair.map(|[posture, covariance]| estimate(names, &posture, &covariance))
                .transpose()
        };
        let increment = |it: Estimate| Increment::new(it.posture, it.covariance);
        let inputs = Inputs {
            front: read(["front[0]", "front[1]"], front)?.map(increment),
            rear: read(["rear[0]", "rear[1]"], rear)?.map(increment),
            beam: read(["beam[0]", "beam[1]"], beam)?,
            ..Inputs::default()
        };
        let mut held = lock(&self.state);
        let (state, output) = &mut *held;
        *output = self.fusion.step(state, &inputs);
        Ok(word(output.beam.verdict))
    }

    /// Midpoint: posture, shape (3,), m, m, rad, and covariance, shape (3, 3).
    #[getter]
    fn robot<'py>(&self, py: Python<'py>) -> PyResult<(Row<'py>, Rows<'py>)> {
        pair(py, &lock(&self.state).1.robot)
    }

    /// Front axle: posture, shape (3,), m, m, rad, and covariance, shape (3, 3); zero before the first step.
    #[getter]
    fn front<'py>(&self, py: Python<'py>) -> PyResult<(Row<'py>, Rows<'py>)> {
        pair(py, &lock(&self.state).1.front)
    }

    /// Rear axle: posture, shape (3,), m, m, rad, and covariance, shape (3, 3); zero before the first step.
    #[getter]
    fn rear<'py>(&self, py: Python<'py>) -> PyResult<(Row<'py>, Rows<'py>)> {
        pair(py, &lock(&self.state).1.rear)
    }
}

/// Curvature-based kinematic law of the midpoint (paper eq. 4), before limits. Parameters: table
/// robot.lead.regulator.law.
#[pyclass(frozen, module = "cfmmr")]
pub struct KinematicLaw {
    law: Law,
}

#[pymethods]
impl KinematicLaw {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        Ok(Self {
            law: build(scenario, |robot| robot.lead.regulator.law.build())?,
        })
    }

    /// Velocity (m/s), curvature (1/m) and yaw rate (rad/s) of the midpoint at each of `postures`, shape (3,) or (n, 3),
    /// m, m, rad; the result has the same shape. reference: shape (3,), moving with v_r (m/s) and kappa_r (1/m).
    #[pyo3(signature = (postures, reference, v_r=0.0, kappa_r=0.0))]
    fn command<'py>(
        &self,
        py: Python<'py>,
        postures: &Bound<'_, PyAny>,
        reference: &Bound<'_, PyAny>,
        v_r: f64,
        kappa_r: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let reference = posture("reference", reference)?;
        let (v_r, kappa_r) = (narrow("v_r", v_r)?, narrow("kappa_r", kappa_r)?);
        let at = |posture: Posture| {
            let error = PolarError::between(posture, reference);
            let command = self.law.command(error, v_r, kappa_r);
            [command.v, command.kappa, command.phi_dot].map(f64::from)
        };
        let many = arrays::dimensions(postures)? > 1;
        if !many {
            let posture = self::posture("postures", postures)?;
            return Ok(arrays::row(py, at(posture).to_vec()).into_any());
        }
        let postures = arrays::postures("postures", postures)?.into_iter();
        let commands: Vec<[f64; 3]> = postures.map(|it| at(it.into())).collect();
        Ok(rows(py, &commands)?.into_any())
    }
}

/// Cascade from the midpoint's motion to references of the axles (paper eq. 5 and 6). Parameters: table
/// robot.lead.cascade.
#[pyclass(frozen, module = "cfmmr")]
pub struct Cascade {
    cascade: cascade::Cascade,
}

#[pymethods]
impl Cascade {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        Ok(Self {
            cascade: build(scenario, |robot| robot.lead.cascade.build())?,
        })
    }

    /// Path curvature at the largest steering angle, 1/m.
    #[getter]
    fn max_curvature(&self) -> f32 {
        self.cascade.max_curvature()
    }

    /// Path curvature (1/m) at a steering angle (rad), eq. 5.
    fn curvature(&self, steering_rad: f64) -> PyResult<f32> {
        let psi = Steering(narrow("steering_rad", steering_rad)?);
        Ok(self.cascade.curvature(psi))
    }

    /// Steering angle (rad) and its rate (rad/s) for a path curvature (1/m) and its rate (1/(m s)).
    #[pyo3(signature = (curvature, rate=0.0))]
    fn steering(&self, curvature: f64, rate: f64) -> PyResult<(f32, f32)> {
        let curvature = narrow("curvature", curvature)?;
        let rate = narrow("rate", rate)?;
        let steering = self.cascade.steering_motion(curvature, rate, 0.0);
        Ok((steering.psi.0, steering.rate))
    }

    /// References of both axles, front first, for a midpoint, shape (3,), m, m, rad, that moves with velocity v (m/s),
    /// steering angle (rad) and steering rate (rad/s): postures (2, 3), and velocities and yaw rates (2, 2), m/s, rad/s.
    #[pyo3(signature = (midpoint, v, steering_rad, steering_rate_rad_s=0.0))]
    fn references<'py>(
        &self,
        py: Python<'py>,
        midpoint: &Bound<'_, PyAny>,
        v: f64,
        steering_rad: f64,
        steering_rate_rad_s: f64,
    ) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let motion = Motion {
            v: narrow("v", v)?,
            psi: Steering(narrow("steering_rad", steering_rad)?),
            psi_rate: narrow("steering_rate_rad_s", steering_rate_rad_s)?,
            ..Motion::default()
        };
        let axles = self
            .cascade
            .references(posture("midpoint", midpoint)?, &motion);
        let postures: [[f32; 3]; 2] = axles.map(|axle| axle.posture.into());
        let twists = axles.map(|axle| [axle.twist.v, axle.twist.omega]);
        Ok((rows(py, &postures)?, rows(py, &twists)?))
    }
}

/// Robust dynamic law of an axle (paper eq. 7 to 10): reference in, wheel torques out. Parameters: table
/// robot.axle.controller.
#[pyclass(frozen, module = "cfmmr")]
pub struct DynamicLaw {
    law: Dynamic,
}

/// Velocity and yaw rate.
fn twist(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Twist> {
    let [v, omega] = single::<2>(name, value)?;
    Ok(Twist::new(v, omega))
}

#[pymethods]
impl DynamicLaw {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        Ok(Self {
            law: build(scenario, |robot| robot.axle.controller.build())?,
        })
    }

    /// Torques of the left and the right wheel, N m.
    ///
    /// posture, reference: shape (3,), m, m, rad. twist, reference_twist: velocity and yaw rate, m/s, rad/s.
    /// acceleration: rates of the reference's twist, m/s², rad/s². load: force of the frame forward and to the left (N)
    /// and its moment (N m) in the reference bend.
    #[pyo3(signature = (posture, twist, reference, reference_twist, acceleration=None, load=None))]
    fn torques(
        &self,
        posture: &Bound<'_, PyAny>,
        twist: &Bound<'_, PyAny>,
        reference: &Bound<'_, PyAny>,
        reference_twist: &Bound<'_, PyAny>,
        acceleration: Option<&Bound<'_, PyAny>>,
        load: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<[f32; 2]> {
        let acceleration = acceleration.map(|it| self::twist("acceleration", it));
        let load = load.map(|load| single::<3>("load", load)).transpose()?;
        let [forward, lateral, moment] = load.unwrap_or_default();
        let command = self.law.step(&dynamic::Input {
            posture: self::posture("posture", posture)?,
            twist: self::twist("twist", twist)?,
            reference: AxleReference {
                posture: self::posture("reference", reference)?,
                twist: self::twist("reference_twist", reference_twist)?,
                acceleration: acceleration.transpose()?.unwrap_or_default(),
            },
            reference_load: AxleLoad {
                forward,
                lateral,
                moment,
            },
            beam_load: None,
            ground_force_n: 0.0,
        });
        Ok(command.torque_nm.list())
    }
}

/// Planner of posture regulation: up to two segments of constant curvature into the funnel of the approach law.
/// Parameters: table robot.lead.regulator.planner.
#[pyclass(frozen, module = "cfmmr")]
pub struct Planner {
    planner: planner::Planner,
}

/// Candidate postures evaluated in a call; the search ends after fewer.
const CANDIDATES: u32 = 10_000_000;

fn direction(direction: Direction) -> &'static str {
    match direction {
        Direction::Forward => "forward",
        Direction::Reverse => "reverse",
    }
}

#[pymethods]
impl Planner {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        Ok(Self {
            planner: build(scenario, |robot| {
                let regulator = &robot.lead.regulator;
                let limits = regulator.limits.build()?;
                regulator.planner.build(limits.max_curvature())
            })?,
        })
    }

    /// Plan from a posture to a goal, shape (3,), m, m, rad; None if no plan leads into the funnel.
    ///
    /// Gives a dict: segments, a list of (direction, curvature (1/m), length (m)); approach, the direction in which the
    /// goal is approached; cost_m, length plus the price of cusps.
    fn plan<'py>(
        &self,
        py: Python<'py>,
        posture: &Bound<'_, PyAny>,
        goal: &Bound<'_, PyAny>,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let posture = self::posture("posture", posture)?;
        let goal = self::posture("goal", goal)?;
        let found = py.detach(|| {
            let mut search = self.planner.start(posture, goal);
            self.planner.step(&mut search, CANDIDATES)
        });
        let Progress::Found(plan) = found else {
            return Ok(None);
        };
        let segment = |it: Segment| (direction(it.direction), it.curvature, it.length_m);
        let result = PyDict::new(py);
        result.set_item("segments", plan.segments().map(segment).collect::<Vec<_>>())?;
        result.set_item("approach", direction(plan.approach))?;
        result.set_item("cost_m", plan.cost_m)?;
        Ok(Some(result))
    }
}

/// Equilibrium of the plant's strip between two clamps, in double precision.
///
/// length_m, bending_n_m2 (EI) and axial_n (EA) of the strip; tip: posture of its end in the coordinates of its root,
/// shape (3,), m, m, rad (the whole turn); curvature: 1/m at 0.1, 0.3, 0.5, 0.7 and 0.9 of the length, shape (5,), near
/// the branch that is wanted.
///
/// Gives a dict: wrench (3,), force (N) and moment (N m) that the end needs, in the root's coordinates; root_moment
/// (N m); curvature (5,); stable, True if the equilibrium is stable with the end held.
#[pyfunction]
fn strip_equilibrium<'py>(
    py: Python<'py>,
    length_m: f64,
    bending_n_m2: f64,
    axial_n: f64,
    tip: &Bound<'_, PyAny>,
    curvature: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    const PLACES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
    within("length_m", length_m, [1e-3, 1e3])?;
    within("bending_n_m2", bending_n_m2, [1e-9, 1e9])?;
    let slender = bending_n_m2 / (length_m * length_m);
    within("axial_n", axial_n, [1e2 * slender, 1e9 * slender])?;
    let tip = arrays::vector::<3>("tip", tip)?;
    let seed = arrays::vector::<5>("curvature", curvature)?;
    for (name, value, most) in [
        ("tip[0]", tip[0], 1.1 * length_m),
        ("tip[1]", tip[1], 1.1 * length_m),
        ("tip[2]", tip[2], 20.0),
    ] {
        within(name, value, [-most, most])?;
    }
    within(
        "distance of tip",
        libm::hypot(tip[0], tip[1]),
        [0.0, 1.05 * length_m],
    )?;
    for (i, value) in seed.into_iter().enumerate() {
        let most = 50.0 / length_m;
        within(&format!("curvature[{i}]"), value, [-most, most])?;
    }
    let strip = Strip::new(length_m, bending_n_m2, axial_n, 0.0);
    let Some((equilibrium, stable)) = strip.find(tip, &PLACES, &seed) else {
        let allowed = "a posture with an equilibrium on the branch of curvature";
        return Err(refused("tip", format!("{tip:?}"), allowed));
    };
    let curvature = PLACES.map(|place| strip.elastic_curvature(&equilibrium, place * length_m));
    let result = PyDict::new(py);
    result.set_item(
        "wrench",
        arrays::row(py, strip.wrench(&equilibrium).to_vec()),
    )?;
    result.set_item("root_moment", strip.root_moment(&equilibrium))?;
    result.set_item("curvature", arrays::row(py, curvature.to_vec()))?;
    result.set_item("stable", stable)?;
    Ok(result)
}

fn within(name: &str, value: f64, [low, high]: [f64; 2]) -> PyResult<()> {
    match value >= low && value <= high {
        true => Ok(()),
        false => Err(refused(
            name,
            arrays::text(value),
            format!("a number from {low:?} to {high:?}"),
        )),
    }
}
