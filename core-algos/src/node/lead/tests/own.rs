//! A controller and an estimator of the user in the lead node.

use super::drives::World;
use super::*;
use crate::control::controller::{ControllerOutput, KinematicController};
use crate::fusion::estimator::{Estimator, EstimatorOutput};
use crate::fusion::robot::{Inputs, PairAxle, RobotFusion};
use crate::safety::Conditions;

/// Drives straight ahead for a number of epochs, then gives its last output.
struct Ahead {
    epochs: u32,
    last: ControllerOutput,
    begun: u32,
    steps: u32,
}

const DONE: ControllerOutput = ControllerOutput {
    v: 0.1,
    kappa: 0.0,
    done: true,
};

impl Ahead {
    fn new(epochs: u32, last: ControllerOutput) -> Self {
        Self {
            epochs,
            last,
            begun: 0,
            steps: 0,
        }
    }
}

impl KinematicController for Ahead {
    fn begin(&mut self) {
        (self.begun, self.steps) = (self.begun + 1, 0);
    }

    fn step(&mut self, _input: &regulator::Input) -> ControllerOutput {
        self.steps += 1;
        match self.steps > self.epochs {
            true => self.last,
            false => ControllerOutput {
                v: 0.1,
                ..ControllerOutput::default()
            },
        }
    }
}

fn with(controller: &mut Ahead) -> Own<'_> {
    Own {
        controller: Some(controller),
        ..Own::default()
    }
}

const FAR: Task = Task::Regulate {
    goal: Posture::new(3.0, 1.0, 0.0),
    within: crate::control::regulator::Tolerance {
        position_m: 0.1,
        heading_rad: 0.1,
    },
};

#[test]
fn own_controller_is_done_at_rest_and_begins_at_each_task() {
    let mut world = World::new(FAR);
    let mut ahead = Ahead::new(300, DONE);
    for task in 1..=3 {
        let mut last = Output::default();
        for epoch in 0..600 {
            last = world.step_with(&mut with(&mut ahead));
            assert_eq!((ahead.begun, last.failed), (task, None));
            // The command of a task is not yet done, even if the robot is at rest.
            assert!(epoch > 0 || !last.done);
            let speed = last.motion.v.abs();
            assert_eq!(last.done, last.phase == Phase::Done);
            assert!(!last.done || speed < REST_M_S, "{epoch}: {speed}");
        }
        assert!(last.done && last.mode == LeadMode::Hold && ahead.steps > 300);
        let driven = world.center().x / task as f32;
        assert!((driven - 0.3).abs() < 0.03, "{driven}");
        world.node.command(FAR);
    }
    // A new start of the node is a new task too.
    world.node.restart();
    world
        .node
        .step_with(0, &mut Outbox::new(), &mut with(&mut ahead));
    assert_eq!(ahead.begun, 4);
}

#[test]
fn controller_output_that_is_not_finite_brakes_and_ends_the_task() {
    for (v, kappa) in [
        (f32::NAN, 0.0),
        (f32::INFINITY, 0.0),
        (0.1, f32::NAN),
        (0.1, f32::NEG_INFINITY),
    ] {
        for done in [false, true] {
            let mut world = World::new(FAR);
            let mut bad = Ahead::new(200, ControllerOutput { v, kappa, done });
            let mut failed = 0;
            let mut last = Output::default();
            for _ in 0..600 {
                let before = last.motion.v;
                last = world.step_with(&mut with(&mut bad));
                let Motion { v, psi, .. } = last.motion;
                assert!(v.is_finite() && psi.0.is_finite() && !last.done);
                assert_eq!(last.supervision.reason, None, "the robot brakes by itself");
                if last.failed.is_some() {
                    failed += 1;
                    assert!(failed == 1 || v < before || v == 0.0, "{v} {before}");
                }
            }
            assert!(failed > 300 && bad.steps == 201);
            assert_eq!(last.failed, Some(Condition::NotANumber));
            assert_eq!((last.motion.v, last.mode), (0.0, LeadMode::Hold));
            let present = world.node.watch(0, None);
            assert!(
                present.contains(Condition::GaveUp) && !present.contains(Condition::NotANumber)
            );
            // The next task begins afresh.
            world.node.command(FAR);
            let next = world.step_with(&mut with(&mut bad));
            assert_eq!((next.failed, bad.begun), (None, 2));
        }
    }
}

/// Finite outputs beyond every limit are limited by the governor.
#[test]
fn huge_controller_output_is_limited() {
    for (v, kappa) in [
        (f32::MAX, f32::MAX),
        (-f32::MAX, -f32::MAX),
        (f32::MAX, 0.0),
    ] {
        let output = ControllerOutput {
            v,
            kappa,
            done: false,
        };
        let mut world = World::new(FAR);
        let mut huge = Ahead::new(0, output);
        for _ in 0..300 {
            let motion = world.step_with(&mut with(&mut huge)).motion;
            assert!(
                motion.v.abs() < 0.5 && motion.psi.0.abs() < 1.0,
                "{motion:?}"
            );
        }
    }
}

/// The built-in fusion as an estimator of the user.
struct Same {
    fusion: RobotFusion,
    state: Option<robot::State>,
    latest: robot::Output,
    starts: u32,
    rejoins: u32,
}

impl Same {
    fn new(fusion: RobotFusion) -> Self {
        Self {
            fusion,
            state: None,
            latest: robot::Output::default(),
            starts: 0,
            rejoins: 0,
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
        self.state = Some(self.fusion.start(center, relative, 0.01));
        self.starts += 1;
    }

    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput {
        let state = self.state.as_mut().expect("started");
        self.latest = self.fusion.step(state, inputs);
        self.output()
    }

    fn rejoin(&mut self, known: PairAxle, beam: &Estimate) -> Option<EstimatorOutput> {
        let state = self.state.as_mut().expect("started");
        self.latest = self.fusion.rejoin(state, known, &self.latest, beam);
        self.rejoins += 1;
        Some(self.output())
    }
}

fn by(estimator: &mut dyn Estimator) -> Own<'_> {
    Own {
        estimator: Some(estimator),
        ..Own::default()
    }
}

#[test]
fn fusion_as_own_estimator_drives_bit_for_bit_alike() {
    let mut built_in = World::new(FAR);
    let mut own = built_in.clone();
    let mut same = Same::new(own.node.with.fusion);
    let mut distance = 0.0f32;
    for epoch in 0..1500 {
        let output = built_in.step();
        assert_eq!(own.step_with(&mut by(&mut same)), output, "{epoch}");
        distance = distance.max(output.fused.robot.posture.x);
    }
    assert!(distance > 1.0 && same.starts == 1 && same.rejoins == 0);
    // A pose starts the estimator again.
    let place = Placement {
        center: Estimate::with_sigmas(Posture::new(0.5, 0.0, 0.0), [1e-3; 3]),
        relative: Estimate::with_sigmas(Posture::new(0.37, 0.0, 0.0), [1e-3; 3]),
        floor_drift: 0.01,
    };
    for world in [&mut built_in, &mut own] {
        world.node.initialize(&place);
    }
    for _ in 0..50 {
        assert_eq!(own.step_with(&mut by(&mut same)), built_in.step());
    }
    assert_eq!(same.starts, 2);
}

/// An axle restarts, with and without a beam that locates the axle.
#[test]
fn fusion_as_own_estimator_rejoins_bit_for_bit_alike() {
    for (restarted, with_beam) in [(0, true), (1, true), (1, false)] {
        let mut built_in = node();
        let mut own = node();
        let mut same = Same::new(own.with.fusion);
        let mut known = 0;
        for number in (0..100).chain(130..260) {
            let restart = if number < 130 { 0 } else { 130 };
            let x = 1e-3 * number as f32;
            for message in beam(number * EPOCH, Posture::new(0.37, 0.01, 0.05)) {
                if with_beam {
                    built_in.receive(number * EPOCH, &message);
                    own.receive(number * EPOCH, &message);
                }
            }
            let mut axles = [(Posture::new(x, 0.0, 0.0), number as u8); 2];
            axles[restarted] = (
                Posture::new(x - 1e-3 * restart as f32, 0.0, 0.0),
                (number - restart) as u8,
            );
            let expected = epoch(&mut built_in, number, axles);
            let outbox = &mut Outbox::new();
            let output = epoch_with(&mut own, number, axles, outbox, &mut by(&mut same));
            assert_eq!(output, expected, "{number}");
            known += u32::from(output.fused != robot::Output::default());
        }
        assert!(known > 150, "{known}");
        assert_eq!(same.rejoins, u32::from(with_beam));
    }
}

/// Gives the estimates of the built-in fusion, changed.
struct Changed {
    same: Same,
    change: fn(&mut EstimatorOutput),
    from: u32,
}

impl Estimator for Changed {
    fn start(&mut self, center: &Estimate, relative: &Estimate) {
        self.same.start(center, relative);
    }

    fn step(&mut self, inputs: &Inputs) -> EstimatorOutput {
        let mut output = self.same.step(inputs);
        if self.from == 0 {
            (self.change)(&mut output);
        }
        self.from = self.from.saturating_sub(1);
        output
    }
}

#[test]
fn estimate_that_is_not_sound_stops_the_robot() {
    let changes: [fn(&mut EstimatorOutput); 4] = [
        |it| it.front.posture.x = f32::NAN,
        |it| it.rear.posture.phi = f32::INFINITY,
        |it| it.robot.covariance[0][1] = f32::NAN,
        |it| it.robot.covariance[2][2] = -1.0,
    ];
    for change in changes {
        let mut world = World::new(FAR);
        let same = Same::new(world.node.with.fusion);
        let mut bad = Changed {
            same,
            change,
            from: 200,
        };
        for epoch in 0..200 {
            let output = world.step_with(&mut by(&mut bad));
            assert_eq!(output.supervision.reason, None, "{epoch}");
        }
        let output = world.step_with(&mut by(&mut bad));
        assert_eq!(output.supervision.reason, Some(Condition::NotANumber));
        assert_eq!(output.supervision.state, OperatingState::Fault);
        assert_eq!(output.mode, LeadMode::Idle);
        assert_eq!(output.fused, robot::Output::default());
        assert!(world.node.state.odom.unwrap().is_finite());
        // Sound estimates end the condition.
        bad.change = |_| ();
        world.step_with(&mut by(&mut bad));
        assert!(!world.node.state.unsound);
    }
}

#[test]
fn task_and_references_follow_the_own_estimate() {
    let mut world = World::new(Task::Idle);
    let same = Same::new(world.node.with.fusion);
    let mut aside = Changed {
        same,
        change: |it| {
            for part in [&mut it.front, &mut it.rear, &mut it.robot] {
                part.posture.y += 0.5;
            }
        },
        from: 0,
    };
    let output = (0..10)
        .map(|_| world.step_with(&mut by(&mut aside)))
        .last()
        .unwrap();
    assert!((output.fused.robot.posture.y - 0.5).abs() < 1e-3);
    assert!((world.node.state.odom.unwrap().y - 0.5).abs() < 1e-3);
    // By the estimate the robot is at its goal.
    world
        .node
        .command(Task::regulate(Posture::new(0.0, 0.5, 0.0)));
    let mut done = false;
    for _ in 0..300 {
        done = world.step_with(&mut by(&mut aside)).done;
    }
    let at = world.center();
    assert!(done && at.x.hypot(at.y) < 0.02, "{at:?}");
    assert_eq!(
        world
            .node
            .watch(0, None)
            .both(Conditions::only(Condition::NotANumber)),
        Conditions::NONE
    );
}
