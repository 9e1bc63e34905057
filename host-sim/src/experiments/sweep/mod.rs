//! `cfmmr sweep`: posture regulation from random starts, on the kinematic model or the whole robot.
//!
//! A start is uniform within ±2 m of the goal in x and y and over all headings, a function of seed
//! and index alone. It counts as a success if the robot reports that it stands on the goal within
//! the mission's time limit, its true speed is then below 5 mm/s, and its true midpoint is within
//! 3 cm and 3° of the goal, or within what the robot then says it knows of its posture (95 %).
//!
//! # The curvature bound
//!
//! `--kappa-max` sets the largest bend of the frame by κ = 2ψ/(L cos ψ) (paper eq. 5). The robot
//! commands [`steering_margin_rad`](core_algos::node::robot::Limits::steering_margin_rad) less.
//! Compared with the bound are the governor's command, the true bend (half the angle between the
//! axles, each millisecond, at rest too) and the true path of O (turning per way, above 5 cm/s). On
//! tyres of the default creep the true bend stays 2 % below its command, because the frame's moment
//! holds the axles back. The hardest case tried (creep velocity 1 mm/s, beam biased by 5 µε, plans
//! that use all the curvature there is) exceeded the command by 3 mrad of ψ; the margin is 5 mrad.
//! Without the relative position sensor nothing holds the bound: the axles drift apart, and with
//! them the true bend from its estimate.
//!
//! # The planner's bound
//!
//! A step of the lead node looks at no more than
//! [`planner_budget`](core_algos::control::regulator::Config::planner_budget) candidate postures
//! (400), whatever the start. Over 10 000 starts the longest search took 38 steps of 10 ms at
//! κ_max 1.5 1/m, 16 at 2.5, 10 at 3.3; at 0.5 1/m it took 2.6 s. The robot stands meanwhile.

use crate::base::error::Error;
use crate::base::numbers::{number, whole};
use crate::experiments::Context;
use crate::experiments::arguments::Common;
use crate::paths::shortest;
use crate::run::final_error::wrap;
use crate::run::kinematic_model::{
    self, Model, SUCCESS_DISTANCE_M, SUCCESS_HEADING_RAD, Trial, random_start,
};
use crate::run::regulate::{Outcome, regulate};
use crate::scenario::Scenario;
use crate::scenario::effect::Use;
use clap::{Args, ValueEnum};
use core_algos::control::regulator::Regulator;

/// Model a sweep runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SweepModel {
    /// Kinematics of the midpoint O with steering dynamics and a perfect estimate.
    Kinematic,
    /// Full plant, sensors, bus and estimation.
    Plant,
}

/// Arguments of `sweep`.
#[derive(Clone, Debug, Args)]
pub struct SweepArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Number of random starts, within 2 m of the goal in x and y, any heading
    #[arg(long, default_value_t = 1000, value_parser = whole::<u32>(1..=10_000_000))]
    pub starts: u32,
    /// Model of the robot
    #[arg(long, value_enum, default_value_t = SweepModel::Plant)]
    pub model: SweepModel,
    /// Largest curvature of the path, 0.5 to 5 1/m [default: the scenario's, 3.08]
    #[arg(long, value_name = "1/M", value_parser = number)]
    pub kappa_max: Option<f64>,
}

mod picture;
mod report;

pub use report::{Failures, LengthRatio, Report, Spread};
use report::{csv, table};

/// Speed below which the robot counts as at rest at the end, m/s.
pub const REST_SPEED_M_S: f64 = 0.005;
/// Curvature bounds that can be asked for, 1/m. Below, the robot's turning circle is larger than the
/// field of starts; above, the frame bends further than it was modelled for.
pub const KAPPA_RANGE: [f64; 2] = [0.5, 5.0];

/// Why a start counts as failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// Not at rest on the goal, by the robot's own judgement, within the time limit.
    Time,
    /// The robot gave up.
    GaveUp,
    /// Reported as done, but not at rest.
    Moving,
    /// Reported as done, but too far from the goal.
    Position,
    /// Reported as done, but turned too far from the goal's heading.
    Heading,
}

impl Failure {
    /// Name in the files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::GaveUp => "gave-up",
            Self::Moving => "moving",
            Self::Position => "position",
            Self::Heading => "heading",
        }
    }
}

/// Result of one start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Start posture of O: m, m, rad.
    pub start: [f64; 3],
    /// Why it failed, if it did.
    pub failure: Option<Failure>,
    /// True final distance of O from the goal, m.
    pub e_m: f64,
    /// True final heading of O less that of the goal, rad.
    pub heading_rad: f64,
    /// Squared error of the final estimate of O over its claimed covariance; none on the kinematic model.
    pub nees: Option<f64>,
    /// Time until the robot reported the goal, or of the whole trial, s.
    pub time_s: f64,
    /// Length of the path of O, m.
    pub length_m: f64,
    /// Length of the shortest path within the curvature bound, m.
    pub shortest_m: f64,
    /// Largest true curvature by the frame's bend, 1/m.
    pub max_curvature: f64,
    /// Largest true curvature of the driven path, turning per way, 1/m.
    pub max_path_curvature: f64,
    /// Largest commanded curvature, 1/m.
    pub max_commanded_curvature: f64,
    /// Changes of direction.
    pub cusps: u32,
    /// Searches for a plan.
    pub plans: u32,
    /// Longest search, steps of the lead node.
    pub planning_steps: u32,
}

impl Start {
    fn of_kinematic(trial: &Trial) -> Self {
        let end = (trial.distance_m, trial.heading_rad);
        Self {
            start: trial.start,
            failure: failure(
                trial.done,
                trial.gave_up,
                trial.end_speed_m_s,
                end,
                [0.0; 2],
            ),
            e_m: trial.distance_m,
            heading_rad: trial.heading_rad,
            nees: None,
            time_s: trial.time_s,
            length_m: trial.length_m,
            shortest_m: trial.shortest_m,
            max_curvature: trial.max_curvature,
            // O moves along the bend's own curvature, and the bend is the commanded one.
            max_path_curvature: trial.max_curvature,
            max_commanded_curvature: trial.max_curvature,
            cusps: trial.cusps,
            plans: trial.plans,
            planning_steps: trial.planning_ticks,
        }
    }

    fn of_plant(outcome: &Outcome, start: [f64; 3], goal: [f64; 3], kappa_max: f64) -> Self {
        let [x, y, phi] = outcome.midpoint;
        let (e_m, heading_rad) = ((goal[0] - x).hypot(goal[1] - y), wrap(phi - goal[2]));
        let (end, speed) = ((e_m, heading_rad), outcome.end_speed_m_s);
        Self {
            start,
            failure: failure(outcome.done, outcome.gave_up, speed, end, outcome.claimed),
            e_m,
            heading_rad,
            nees: Some(outcome.nees),
            time_s: outcome.duration_s,
            length_m: outcome.path_m,
            shortest_m: shortest::length(start, goal, kappa_max),
            max_curvature: outcome.max_curvature,
            max_path_curvature: outcome.max_path_curvature,
            max_commanded_curvature: outcome.max_commanded_curvature,
            cusps: outcome.cusps,
            plans: outcome.plans,
            planning_steps: outcome.planning_steps,
        }
    }
}

/// True if a posture is within 3 cm and 3° of the goal.
fn is_within(start: &Start) -> bool {
    start.e_m <= SUCCESS_DISTANCE_M && start.heading_rad.abs() <= SUCCESS_HEADING_RAD
}

/// Why a start failed whose robot says that it knows its posture to `claimed` (m, rad).
fn failure(
    done: bool,
    gave_up: bool,
    speed: f64,
    (e_m, heading): (f64, f64),
    claimed: [f64; 2],
) -> Option<Failure> {
    if gave_up {
        Some(Failure::GaveUp)
    } else if !done {
        Some(Failure::Time)
    } else if !(speed <= REST_SPEED_M_S) {
        Some(Failure::Moving)
    } else if !(e_m <= SUCCESS_DISTANCE_M.max(claimed[0])) {
        Some(Failure::Position)
    } else if !(heading.abs() <= SUCCESS_HEADING_RAD.max(claimed[1])) {
        Some(Failure::Heading)
    } else {
        None
    }
}

/// A sweep, ready to run.
#[derive(Clone, Debug)]
pub struct Sweep {
    model: SweepModel,
    scenario: Scenario,
    kappa_max: f64,
    kinematic: Model,
    regulator: Regulator,
}

impl Sweep {
    /// Writes the curvature bound (1/m; none: as the scenario has it) into the robot's limits and
    /// checks everything.
    pub fn new(
        mut scenario: Scenario,
        model: SweepModel,
        kappa_max: Option<f64>,
    ) -> Result<Self, Error> {
        if let Some(kappa) = kappa_max {
            let [low, high] = KAPPA_RANGE;
            if !(kappa >= low && kappa <= high) {
                return Err(Error::input(format!(
                    "--kappa-max {kappa}: must be a number from {low} to {high} (1/m)"
                )));
            }
            scenario.robot.limits.max_steering_rad =
                Model::of_robot(&scenario.robot).steering(kappa) as f32;
            scenario
                .check()
                .map_err(|error| Error::input(format!("--kappa-max {kappa}: {error}")))?;
        }
        let kinematic = Model::of_robot(&scenario.robot);
        let bound = scenario.robot.limits.max_steering_rad.into();
        Ok(Self {
            model,
            kappa_max: kappa_max.unwrap_or_else(|| kinematic.curvature(bound)),
            regulator: scenario.robot.completed().lead.regulator.build()?,
            kinematic,
            scenario,
        })
    }

    /// Runs start `index`: a function of seed and index alone. With the path of O, at 5 Hz.
    pub fn run(&self, seed: u64, index: u64) -> Result<(Start, Vec<[f64; 2]>), Error> {
        let goal = self.scenario.mission.goal;
        let start = from_goal(goal, random_start(seed, index));
        let mut path = Vec::new();
        match self.model {
            SweepModel::Kinematic => {
                let trial = kinematic_model::regulate(
                    &self.regulator,
                    &self.kinematic,
                    start,
                    goal,
                    seed,
                    index,
                    |time_s, robot, _| {
                        if due(time_s) {
                            path.push([robot.posture[0], robot.posture[1]]);
                        }
                    },
                );
                let shortest_m = shortest::length(start, goal, self.kappa_max);
                Ok((
                    Start::of_kinematic(&Trial {
                        shortest_m,
                        ..trial
                    }),
                    path,
                ))
            }
            SweepModel::Plant => {
                let mut scenario = self.scenario.clone();
                scenario.mission.start = start;
                let outcome = regulate(&scenario, seed, index, |record| {
                    if due(record.time_s) {
                        path.push([record.midpoint[0], record.midpoint[1]]);
                    }
                })?;
                Ok((Start::of_plant(&outcome, start, goal, self.kappa_max), path))
            }
        }
    }
}

/// True if the path has a point at this time (s): each 0.2 s.
fn due(time_s: f64) -> bool {
    ((time_s * 100.0).round() as u64).is_multiple_of(20)
}

/// A start around the goal, in the frame of the start.
fn from_goal(goal: [f64; 3], [x, y, phi]: [f64; 3]) -> [f64; 3] {
    [goal[0] + x, goal[1] + y, wrap(goal[2] + phi)]
}

/// Runs the command.
pub fn run(args: &SweepArgs) -> Result<(), Error> {
    let context = Context::new(&args.common, "sweep")?;
    let used = match args.model {
        SweepModel::Kinematic => Use::Kinematic,
        SweepModel::Plant => Use::Regulate,
    };
    let taken = [("mission.start", "here: starts are random")];
    context.check_keys(&taken, &[(&context.scenario, used)])?;
    let sweep = Sweep::new(context.scenario.clone(), args.model, args.kappa_max)?;
    let mut files = context.output()?;
    let results = context.run("starts", args.starts as usize, |index| {
        sweep.run(context.seed, index as u64)
    })?;
    let (starts, paths): (Vec<Start>, Vec<_>) = results.into_iter().flatten().unzip();
    if starts.is_empty() {
        let text = "interrupted before a start was done: nothing is written";
        return Err(Error::Interrupted(text.to_owned()));
    }
    let report = Report::of(&starts, &sweep);
    let text = table(&report);

    let figure = picture::figure(&starts, paths, &report, context.scenario.mission.goal);
    files.text("sweep.svg", figure.svg());
    files.bytes("sweep.png", figure.png());
    files.csv("starts.csv", csv(&starts));
    let reached = |start: &Start| start.failure.is_none();
    let failed = (!starts.iter().any(reached)).then(|| "no start reached the goal".to_owned());
    context.finish(&text, &report, files, &[], failed)
}
