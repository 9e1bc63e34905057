//! The robot reduced to its midpoint: kinematics with steering dynamics, in `f64`.
//!
//! What the posture regulator is swept over by the ten thousand: O moves with velocity v along a
//! path of curvature κ(ψ) (paper eq. 5), v and ψ follow their commands with lags and limits as the
//! reference governor would have it. No slip, no axles; the plant is [`crate::plant`].

use crate::paths::shortest;
use core_algos::control::regulator::{Input, Phase, Regulator, State};
use core_algos::math::{Posture, Steering};
use core_algos::node::robot::RobotConfig;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Parameters of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Flexible length of the frame, m.
    pub frame_length_m: f64,
    /// Rigid length at each of its ends, m.
    pub rigid_end_m: f64,
    /// Greatest |ψ|, rad.
    pub max_steering_rad: f64,
    /// Greatest |ψ̇|, rad/s.
    pub max_steering_rate_rad_s: f64,
    /// Greatest |ψ̈|, rad/s².
    pub max_steering_acceleration_rad_s2: f64,
    /// Natural frequency of the critically damped steering, rad/s.
    pub steering_bandwidth_rad_s: f64,
    /// Greatest speed, m/s.
    pub max_speed_m_s: f64,
    /// Greatest |v̇|, m/s².
    pub max_acceleration_m_s2: f64,
    /// Rate of the speed's lag, 1/s.
    pub speed_bandwidth_1_s: f64,
    /// True curvature over that of eq. 5.
    pub curvature_gain: f64,
    /// True curvature at ψ = 0, 1/m.
    pub curvature_offset_1_m: f64,
    /// Standard deviation of each coordinate of the position estimate, m: a first-order Markov
    /// process, stepped each tick.
    pub position_noise_m: f64,
    /// Standard deviation of the heading estimate, rad; likewise.
    pub heading_noise_rad: f64,
    /// Correlation time of the estimate's error, s.
    pub noise_correlation_s: f64,
    /// Time a trial may take, s.
    pub time_limit_s: f64,
}

impl Default for Model {
    fn default() -> Self {
        Self {
            frame_length_m: 0.37,
            rigid_end_m: 0.0,
            max_steering_rad: 0.5,
            max_steering_rate_rad_s: 1.0,
            max_steering_acceleration_rad_s2: 8.0,
            steering_bandwidth_rad_s: 8.0,
            max_speed_m_s: 0.25,
            max_acceleration_m_s2: 0.4,
            speed_bandwidth_1_s: 6.0,
            curvature_gain: 1.0,
            curvature_offset_1_m: 0.0,
            position_noise_m: 0.0,
            heading_noise_rad: 0.0,
            noise_correlation_s: 1.0,
            time_limit_s: 90.0,
        }
    }
}

impl Model {
    /// The model of a robot: its frame, its limits, and its governor's lags.
    pub fn of_robot(robot: &RobotConfig) -> Self {
        let robot = robot.completed();
        let governor = &robot.lead.governor;
        Self {
            frame_length_m: robot.geometry.frame_length_m.into(),
            rigid_end_m: robot.geometry.rigid_end_m.into(),
            max_steering_rad: governor.max_steering_rad.into(),
            max_steering_rate_rad_s: governor.max_steering_rate_rad_s.into(),
            max_steering_acceleration_rad_s2: governor.max_steering_acceleration_rad_s2.into(),
            steering_bandwidth_rad_s: governor.steering_frequency_rad_s.into(),
            max_speed_m_s: governor.max_speed_m_s.into(),
            max_acceleration_m_s2: governor.max_acceleration_m_s2.into(),
            speed_bandwidth_1_s: governor.speed_rate_per_s.into(),
            ..Self::default()
        }
    }

    /// Curvature (1/m) of O's path at steering angle `psi` (rad): `2 tan ψ` over the distance
    /// between the axles, which is eq. 5 where there are no rigid ends.
    pub fn curvature(&self, psi: f64) -> f64 {
        let ratio = if psi.abs() < 1e-9 {
            1.0
        } else {
            psi.sin() / psi
        };
        let chord = self.frame_length_m * ratio + 2.0 * self.rigid_end_m * psi.cos();
        2.0 * psi.tan() / chord
    }

    /// Steering angle (rad) of curvature `kappa` (1/m): the inverse of eq. 5, by bisection.
    pub fn steering(&self, kappa: f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.curvature(middle) < kappa.abs() {
                low = middle;
            } else {
                high = middle;
            }
        }
        low.copysign(kappa)
    }
}

/// State of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robot {
    /// True posture of O: x, y (m), heading (rad, not wrapped).
    pub posture: [f64; 3],
    /// Velocity, m/s.
    pub v: f64,
    /// Steering angle, rad.
    pub psi: f64,
    /// Steering rate, rad/s.
    pub psi_dot: f64,
}

impl Robot {
    /// At rest and straight at `posture`.
    pub fn at(posture: [f64; 3]) -> Self {
        Self {
            posture,
            v: 0.0,
            psi: 0.0,
            psi_dot: 0.0,
        }
    }

    /// `dt` seconds towards a commanded velocity (m/s) and steering angle (rad).
    pub fn advance(&mut self, model: &Model, v: f64, psi: f64, dt: f64) {
        let clamp = |x: f64, bound: f64| x.clamp(-bound, bound);
        let w = model.steering_bandwidth_rad_s;
        let psi = clamp(psi, model.max_steering_rad);
        let pull = w * w * (psi - self.psi) - 2.0 * w * self.psi_dot;
        self.psi_dot += dt * clamp(pull, model.max_steering_acceleration_rad_s2);
        self.psi_dot = clamp(self.psi_dot, model.max_steering_rate_rad_s);
        self.psi = clamp(self.psi + dt * self.psi_dot, model.max_steering_rad);
        let v = clamp(v, model.max_speed_m_s);
        let push = model.speed_bandwidth_1_s * (v - self.v);
        self.v += dt * clamp(push, model.max_acceleration_m_s2);
        let kappa = model.curvature_gain * model.curvature(self.psi) + model.curvature_offset_1_m;
        let turn = dt * self.v * kappa;
        let direction = self.posture[2] + 0.5 * turn;
        self.posture[0] += dt * self.v * direction.cos();
        self.posture[1] += dt * self.v * direction.sin();
        self.posture[2] += turn;
    }
}

/// Result of one start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Start posture of O.
    pub start: [f64; 3],
    /// At rest on the goal within the time, 3 cm and 3°.
    pub success: bool,
    /// Reported by the regulator as at rest on the goal.
    pub done: bool,
    /// Given up by the regulator.
    pub gave_up: bool,
    /// Speed at the end, m/s.
    pub end_speed_m_s: f64,
    /// Final distance to the goal, m.
    pub distance_m: f64,
    /// Final heading error, rad.
    pub heading_rad: f64,
    /// Time until the regulator reported the goal, s.
    pub time_s: f64,
    /// Length of the driven path, m.
    pub length_m: f64,
    /// Length of the shortest path of the curvature bound, m.
    pub shortest_m: f64,
    /// Greatest |curvature| steered, 1/m.
    pub max_curvature: f64,
    /// Changes of direction while driving.
    pub cusps: u32,
    /// Renewed attempts.
    pub attempts: u8,
    /// Searches for a plan.
    pub plans: u32,
    /// Longest search, ticks.
    pub planning_ticks: u32,
}

/// Bound of position error of a success, m.
pub const SUCCESS_DISTANCE_M: f64 = 0.03;
/// Bound of heading error of a success, rad (3°).
pub const SUCCESS_HEADING_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;

fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

/// Correlated noise of the estimate: x, y (m), heading (rad).
struct Noise {
    values: [f64; 3],
    keep: f64,
    /// Share of the next draw: all of the first, so that the noise is stationary from the start.
    fresh: f64,
}

impl Noise {
    fn new(model: &Model, tick: f64) -> Self {
        Self {
            values: [0.0; 3],
            keep: (-tick / model.noise_correlation_s).exp(),
            fresh: 1.0,
        }
    }

    fn next(&mut self, model: &Model, random: &mut Pcg64) -> [f64; 3] {
        let scale = [
            model.position_noise_m,
            model.position_noise_m,
            model.heading_noise_rad,
        ];
        for (value, scale) in self.values.iter_mut().zip(scale) {
            let unit: f64 = StandardNormal.sample(random);
            *value = self.keep * *value + self.fresh * scale * unit;
        }
        self.fresh = (1.0 - self.keep * self.keep).sqrt();
        self.values
    }
}

/// Searches for a plan: their number, ticks of the present and of the longest.
#[derive(Default)]
struct Searches {
    count: u32,
    ticks: u32,
    longest: u32,
}

impl Searches {
    fn see(&mut self, phase: Phase) {
        if phase == Phase::Plan {
            self.count += u32::from(self.ticks == 0);
            self.ticks += 1;
        } else {
            self.ticks = 0;
        }
        self.longest = self.longest.max(self.ticks);
    }
}

/// The driven way.
#[derive(Default)]
struct Way {
    length_m: f64,
    max_curvature: f64,
    cusps: u32,
    last_sign: f64,
}

impl Way {
    fn see(&mut self, model: &Model, robot: &Robot) {
        self.max_curvature = self.max_curvature.max(model.curvature(robot.psi).abs());
        if robot.v.abs() > 5e-3 {
            let sign = robot.v.signum();
            self.cusps += u32::from(sign * self.last_sign < 0.0);
            self.last_sign = sign;
        }
    }
}

/// Drives the regulator from `start` to `goal`; `seed` and `index` decide the estimate's noise.
/// `trace` is called each tick with time, robot and phase.
pub fn regulate(
    regulator: &Regulator,
    model: &Model,
    start: [f64; 3],
    goal: [f64; 3],
    seed: u64,
    index: u64,
    mut trace: impl FnMut(f64, &Robot, Phase),
) -> Trial {
    const SUBSTEPS: u32 = 10;
    let tick = f64::from(regulator.config().tick_s);
    let mut random = Pcg64::new(u128::from(seed), (u128::from(index) << 1) | 1);
    let mut robot = Robot::at(start);
    let mut state = State::default();
    let mut way = Way::default();
    let (mut attempts, mut searches) = (0, Searches::default());
    let mut gave_up = false;
    let mut time_s = model.time_limit_s;
    let mut noise = Noise::new(model, tick);
    let mut at_goal = false;
    for k in 0..(model.time_limit_s / tick) as u64 {
        let noise = noise.next(model, &mut random);
        let [x, y, phi] = [0, 1, 2].map(|i| robot.posture[i] + noise[i]);
        let estimate = Posture::new(x as f32, y as f32, wrapped(phi) as f32);
        let output = regulator.tick(
            &mut state,
            &Input {
                posture: estimate,
                steering: Steering(robot.psi as f32),
                speed_m_s: robot.v as f32,
                goal: goal.map(|value| value as f32).into(),
            },
        );
        searches.see(output.phase);
        attempts = attempts.max(state.attempts());
        trace(k as f64 * tick, &robot, output.phase);
        let psi = model.steering(output.command.kappa.into());
        for _ in 0..SUBSTEPS {
            let dt = tick / f64::from(SUBSTEPS);
            robot.advance(model, output.command.v.into(), psi, dt);
            way.length_m += dt * robot.v.abs();
        }
        way.see(model, &robot);
        at_goal = output.done && robot.v.abs() < 5e-3;
        gave_up = !at_goal && output.phase == Phase::GaveUp;
        if at_goal || gave_up {
            time_s = k as f64 * tick;
            break;
        }
    }
    // What is left of the motion after the report: the lag runs out, nobody commands.
    for _ in 0..1000 {
        let psi = robot.psi;
        robot.advance(model, 0.0, psi, 1e-3);
    }
    let distance_m = (robot.posture[0] - goal[0]).hypot(robot.posture[1] - goal[1]);
    let heading_rad = wrapped(robot.posture[2] - goal[2]);
    let bound = model.curvature(model.max_steering_rad);
    Trial {
        start,
        success: at_goal
            && distance_m <= SUCCESS_DISTANCE_M
            && heading_rad.abs() <= SUCCESS_HEADING_RAD,
        distance_m,
        heading_rad,
        time_s,
        length_m: way.length_m,
        done: at_goal,
        gave_up,
        end_speed_m_s: robot.v.abs(),
        shortest_m: shortest::length(start, goal, bound),
        max_curvature: way.max_curvature,
        cusps: way.cusps,
        attempts,
        plans: searches.count,
        planning_ticks: searches.longest,
    }
}

/// Random start `index`: uniform in ±2 m and all headings, a function of `seed` and `index`
/// alone.
pub fn random_start(seed: u64, index: u64) -> [f64; 3] {
    let mut random = Pcg64::new(u128::from(seed), u128::from(index) << 1);
    [
        random.random_range(-2.0..2.0),
        random.random_range(-2.0..2.0),
        random.random_range(-std::f64::consts::PI..std::f64::consts::PI),
    ]
}
