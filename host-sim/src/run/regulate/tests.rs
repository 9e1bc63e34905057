//! Regulation with parts of the user.

use super::*;
use crate::scenario::own::Own;
use crate::targets::{Failure, FailureMode};
use core_algos::control::controller::{ControllerOutput, KinematicController};
use core_algos::control::regulator::Input;
use core_algos::fusion::Estimate;
use core_algos::fusion::estimator::{Estimator, EstimatorOutput};
use core_algos::fusion::robot::{self, Inputs, PairAxle, RobotFusion};
use core_algos::safety::Condition;
use core_algos::topology::Role;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Drives straight ahead to 1 cm before the goal, then gives its last output.
struct Ahead {
    last: ControllerOutput,
}

impl KinematicController for Ahead {
    fn step(&mut self, input: &Input) -> ControllerOutput {
        match input.goal.relative_to(input.posture).x < 0.01 {
            true => self.last,
            false => ControllerOutput {
                v: 0.15,
                ..ControllerOutput::default()
            },
        }
    }
}

fn ahead(last: ControllerOutput) -> Scenario {
    let mut scenario = Scenario::default();
    scenario.mission.start = [-0.5, 0.0, 0.0];
    scenario.own = Own::default().with_controller(move || Ahead { last });
    scenario
}

#[test]
fn own_controller_that_is_done_has_reached_the_goal() {
    let done = ControllerOutput {
        done: true,
        ..ControllerOutput::default()
    };
    let outcome = regulate(&ahead(done), 1, 0, |_| ()).unwrap();
    assert!(outcome.end.is_success() && outcome.within, "{outcome:?}");
    assert!(outcome.plans == 0 && outcome.end.duration_s < 10.0);
}

#[test]
fn own_controller_with_an_output_that_is_not_finite_stops_by_name() {
    let bad = ControllerOutput {
        kappa: f32::NAN,
        ..ControllerOutput::default()
    };
    let mut fastest = 0.0f32;
    let outcome = regulate(&ahead(bad), 1, 0, |record| {
        let motion = record.lead.motion;
        assert!(motion.v.is_finite() && motion.psi.0.is_finite());
        fastest = fastest.max(motion.v);
    });
    let end = outcome.unwrap().end;
    assert_eq!(end.kind, crate::run::end::EndKind::Stopped);
    assert_eq!(end.condition, Some(Condition::NotANumber));
    assert!(
        fastest > 0.1 && end.label().contains("not a number"),
        "{end:?}"
    );
    assert!(end.failure().unwrap().contains("controller"));
}

/// The built-in fusion as an estimator of the user.
struct Same {
    fusion: RobotFusion,
    floor_drift: f32,
    state: Option<robot::State>,
    latest: robot::Output,
    rejoins: Arc<AtomicU32>,
}

impl Same {
    fn of(scenario: &Scenario, rejoins: &Arc<AtomicU32>) -> Self {
        Self {
            fusion: scenario.completed_robot().lead.fusion.build().unwrap(),
            floor_drift: scenario.mission.floor_drift as f32,
            state: None,
            latest: robot::Output::default(),
            rejoins: rejoins.clone(),
        }
    }

    fn output(&self) -> EstimatorOutput {
        EstimatorOutput {
            front: self.latest.front,
            rear: self.latest.rear,
            robot: self.latest.robot,
        }
    }
}

impl Estimator for Same {
    fn start(&mut self, center: &Estimate, relative: &Estimate) {
        self.state = Some(self.fusion.start(center, relative, self.floor_drift));
    }

    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput {
        let state = self.state.as_mut().unwrap();
        self.latest = self.fusion.step(state, inputs);
        self.output()
    }

    fn rejoin(&mut self, known: PairAxle, beam: &Estimate) -> Option<EstimatorOutput> {
        let state = self.state.as_mut().unwrap();
        self.latest = self.fusion.rejoin(state, known, &self.latest, beam);
        self.rejoins.fetch_add(1, Relaxed);
        Some(self.output())
    }
}

/// Records of a trial in which the rear board restarts, as text.
fn records(scenario: &Scenario) -> Vec<String> {
    let mut simulation = Simulation::new(scenario, 3, 1).unwrap();
    let failure = Failure {
        role: Role::axle(1),
        at: 5000,
        mode: FailureMode::Off,
    };
    simulation.boards().plan(vec![failure], Some(300));
    simulation.recover();
    let mut records = Vec::new();
    let outcome = regulate_on(&mut simulation, scenario, |record| {
        records.push(format!("{record:?}"));
    });
    records.push(format!("{:?}", outcome.unwrap()));
    records
}

#[test]
fn fusion_as_own_estimator_gives_the_same_records_with_the_restart_of_an_axle() {
    let mut scenario = Scenario::default();
    let built_in = records(&scenario);
    let rejoins = Arc::new(AtomicU32::new(0));
    let (same, counter) = (scenario.clone(), rejoins.clone());
    scenario.own = Own::default().with_estimator(move || Same::of(&same, &counter));
    let own = records(&scenario);
    assert!(built_in.len() > 1000 && built_in.last().unwrap().contains("Reached"));
    for (epoch, (own, built_in)) in own.iter().zip(&built_in).enumerate() {
        assert_eq!(own, built_in, "{epoch}");
    }
    assert_eq!((own.len(), rejoins.load(Relaxed)), (built_in.len(), 1));
}

#[test]
fn each_trial_has_parts_of_its_own_on_the_front_board_alone() {
    let made = Arc::new(AtomicU32::new(0));
    let counter = made.clone();
    let mut scenario = Scenario::default();
    scenario.own = Own::default().with_controller(move || {
        counter.fetch_add(1, Relaxed);
        Ahead {
            last: ControllerOutput::default(),
        }
    });
    for trial in 0..3 {
        Simulation::new(&scenario, 1, trial).unwrap();
        assert_eq!(u64::from(made.load(Relaxed)), trial + 1);
    }
    // A copy has the same parts; a scenario file has none.
    assert_eq!(scenario.clone(), scenario);
    let mut scenario = Scenario {
        own: scenario.own,
        ..Scenario::in_world(None).unwrap()
    };
    let text = scenario.to_toml().unwrap();
    let read = Scenario::parse(None, &text, "test", &[]).unwrap();
    assert!(read.own.names().is_empty() && read != scenario);
    assert_eq!(format!("{:?}", scenario.own), "[\"controller\"]");
    scenario.own = Own::default();
    assert_eq!(read, scenario);
}
