//! The lead node in a loop with axles that follow their references exactly.

use super::*;
use crate::control::path::{PathPoint, TrajectoryPoint};
use crate::fusion::ekf::Verdict;
use crate::safety::Conditions;

/// True postures of both axles, each of which reports in an odometric frame of its own.
#[derive(Clone)]
pub(super) struct World {
    pub(super) node: LeadNode,
    axles: [Posture; 2],
    number: u64,
    /// Epochs by which the beam's messages are late.
    late: usize,
    /// Posture of the front axle in the rear axle's coordinates, by epoch.
    bends: Vec<Posture>,
}

const FRAMES: [Posture; 2] = [Posture::new(3.0, -2.0, 1.0), Posture::new(-1.0, 4.0, -2.5)];
const DT: f32 = 0.01;

impl World {
    /// World with the robot at rest at the origin and its frame straight.
    pub(super) fn new(task: Task) -> Self {
        let mut node = node();
        node.command(task);
        Self {
            node,
            axles: [0.185, -0.185].map(|x| Posture::new(x, 0.0, 0.0)),
            number: 0,
            late: 0,
            bends: Vec::new(),
        }
    }

    /// Midpoint between the axles, with the direction of their chord.
    pub(super) fn center(&self) -> Posture {
        let [front, rear] = self.axles;
        let (x, y) = (front.x - rear.x, front.y - rear.y);
        Posture::new(rear.x + 0.5 * x, rear.y + 0.5 * y, y.atan2(x))
    }

    pub(super) fn step(&mut self) -> Output {
        self.step_with(&mut Own::default())
    }

    pub(super) fn step_with(&mut self, parts: &mut Own<'_>) -> Output {
        let (now, node) = (self.number * EPOCH, &mut self.node);
        self.bends.push(self.axles[0].relative_to(self.axles[1]));
        let of = self.bends.len().saturating_sub(1 + self.late);
        let beam = beam(of as Micros * EPOCH, self.bends[of]);
        let beats = [Node::axle(0), Node::axle(1)]
            .map(|sender| beat(sender, now, OperatingState::Active, 0));
        for message in beam.iter().chain(&beats) {
            node.receive(now, message);
        }
        let uptime = self.number.min(255) as u8;
        let own = [0, 1].map(|k| (self.axles[k].relative_to(FRAMES[k]), uptime));
        let (before, lost, mut outbox) = (node.pairs[0].nis, node.state.lost, Outbox::new());
        let output = epoch_with(node, self.number, own, &mut outbox, parts);
        let (nis, after) = (output.fused.beam.nis, node.pairs[0].nis);
        let tested = matches!(output.fused.beam.verdict, Verdict::Used | Verdict::Gated);
        let mean = before + (nis.min(40.0) - before) / 256.0;
        let expected = if tested { mean } else { before };
        assert!(
            node.state.unsound || (after - expected).abs() <= 1e-5 * expected,
            "{after} {expected}"
        );
        let gave_up = output.failed.is_some() && output.motion.v.abs() < REST_M_S;
        let expected = match output.supervision.state {
            OperatingState::Armed if !output.done => LeadMode::Hold,
            OperatingState::Active if !(output.done || lost || gave_up) => LeadMode::Active,
            _ => output.mode,
        };
        assert_eq!(output.mode, expected);
        let statuses = outbox.iter().filter_map(|message| match *message {
            Message::LeadStatus {
                mode,
                steering_rad,
                velocity_m_s,
                ..
            } => Some((mode, steering_rad, velocity_m_s)),
            _ => None,
        });
        let motion = output.motion;
        assert!(statuses.eq([(expected, motion.psi.0, motion.v)]));
        for message in outbox.iter() {
            match *message {
                Message::ReferencePosture { axle, posture, .. } => {
                    self.axles[axle.index()] = FRAMES[axle.index()].compose(posture);
                }
                Message::ReferenceMotion {
                    axle,
                    velocity_m_s: v,
                    yaw_rate_rad_s: omega,
                    acceleration_m_s2: a,
                    yaw_acceleration_rad_s2: turn,
                    ..
                } => {
                    let by = [v + 0.5 * DT * a, omega + 0.5 * DT * turn].map(|rate| rate * DT);
                    let axle = &mut self.axles[axle.index()];
                    *axle = axle.advance(by[0], by[1]);
                }
                _ => {}
            }
        }
        self.number += 1;
        output
    }

    /// True if a difference of 1 cm between `odom` and `map` remains after a step.
    fn keeps_odom(&self) -> bool {
        let mut other = self.clone();
        other.node.state.odom.as_mut().unwrap().y += 0.01;
        let map = other.step().fused.robot.posture;
        distance(other.node.state.odom.unwrap(), map) > 9e-3
    }

    /// Steps until the task is done; returns the time, s.
    fn run(&mut self, mut each: impl FnMut(&mut Self, &Output)) -> f32 {
        for epochs in 1..6000 {
            let output = self.step();
            assert_eq!(self.node.supervision().first(), None);
            each(self, &output);
            if output.done {
                return DT * epochs as f32;
            }
        }
        panic!("not done: {:?}", self.center());
    }

    /// Number of epochs in a state among the next 7000.
    fn epochs(&self, state: OperatingState) -> usize {
        let mut other = self.clone();
        let states = (0..7000).map(|_| other.step().supervision.state);
        states.filter(|found| *found == state).count()
    }
}

fn distance(a: Posture, b: Posture) -> f32 {
    (a.x - b.x).hypot(a.y - b.y)
}

/// Point at arc length `s` of a circle of radius 0.8 m that leaves the origin along x and bends to the left.
fn on_circle(s: f32) -> PathPoint {
    PathPoint {
        posture: Posture::ORIGIN.advance(s, s / 0.8),
        kappa: 1.0 / 0.8,
        s,
    }
}

/// At the goal the motors hold the robot for the longest allowed time, then release it until the next command.
#[test]
fn robot_reaches_a_goal_aside_and_behind_and_is_released_after_the_hold() {
    let goal = Posture::new(-0.6, 0.4, 0.3);
    let mut world = World::new(Task::regulate(goal));
    assert_eq!(world.node.latest_goal(), Some(goal));
    let mut parts = vec![];
    world.run(|world, output| {
        if output.phase == Phase::Plan {
            let mut ahead = world.node.clone();
            let mut plans = || {
                let before = ahead.clone();
                ahead.prepare();
                ahead != before
            };
            parts.push((0..20).filter(|_| plans()).count());
        }
        let busy = world.node.activity(world.number * EPOCH) == Activity::Busy;
        let planned = output.phase != Phase::Done;
        assert!(busy != output.done && planned != output.done && output.motion.v.abs() < 0.25);
    });
    assert_eq!(world.node.state.aim, Some(goal));
    assert!(!parts.is_empty() && parts.iter().all(|count| *count == 7));
    let [x, y, turn] = world.center().minus(goal);
    assert!(x.hypot(y) < 0.01 && turn.abs() < 0.0175, "{x} {y} {turn}");
    // The motors hold for 60 s. A stop follows: 0.1 s to rest, 0.1 s of rest and 0.75 s to release.
    assert_eq!(world.epochs(OperatingState::Armed), 6_001);
    assert!((94..=96).contains(&world.epochs(OperatingState::SafeStop)));
    (0..6200).for_each(|_| assert_eq!(world.step().supervision.reason, None));
    assert_eq!(world.node.supervision().operating(), OperatingState::Idle);
    world.node.command(Task::regulate(goal));
    world.run(|_, _| ());
    // The second stop has its whole time.
    assert!((94..=96).contains(&world.epochs(OperatingState::SafeStop)));
    world.node.restart();
    let new = LeadNode::new(RobotConfig::default().build_lead().unwrap());
    assert_eq!(world.node, new);
}

/// The robot stops and holds as on a command, but its task is not done.
#[test]
fn a_robot_whose_commander_is_lost_stops_and_is_not_done() {
    for lost in [false, true] {
        let mut world = World::new(Task::regulate(Posture::new(2.0, 0.0, 0.0)));
        for _ in 0..300 {
            assert!(!world.step().done);
        }
        assert!(world.node.state.governor.motion.v > 0.1);
        match lost {
            true => world.node.on_host_lost(),
            false => world.node.command(Task::Stop),
        }
        let ends: Vec<Output> = (0..200).map(|_| world.step()).collect();
        assert!(ends.iter().all(|output| !(lost && output.done)));
        let end = ends[199];
        assert_eq!((end.mode, end.done), (LeadMode::Hold, !lost));
        assert_eq!(end.supervision.state, OperatingState::Armed);
        assert!(end.motion.v.abs() < 1e-3, "{end:?}");
        world
            .node
            .command(Task::regulate(Posture::new(2.0, 0.0, 0.0)));
        world.run(|_, _| ());
    }
}

#[test]
fn the_robot_follows_a_circle_and_rests_at_its_end() {
    let mut world = World::new(Task::Idle);
    for number in 0..=120 {
        let point = on_circle(0.01 * number as f32);
        world.node.path_task().push_path_point(point).unwrap();
    }
    world.node.path_task().finish_path();
    let mut stopped = world.node.clone();
    stopped.command(Task::Stop);
    assert_eq!(stopped.path_task().path_room(), path_task::PATH_POINTS);
    // The path stays after faults were cleared.
    let room = world.node.path_task().path_room();
    world.node.command(Task::Clear);
    assert_eq!(world.node.path_task().path_room(), room);
    world.node.command(Task::follow());
    let duration = world.run(|world, output| {
        let at = world.center();
        let off = distance(at, Posture::new(0.0, 0.8, 0.0)) - 0.8;
        // The frame is straight at first, so the robot leaves the circle by up to 3 cm.
        let most = if at.x < 0.3 { 0.03 } else { 0.004 };
        assert!(off.abs() < most, "{at:?} {off}");
        assert!(output.motion.v <= 0.2 + 1e-3);
    });
    assert!((6.0..9.0).contains(&duration), "{duration}");
    let at = world.center();
    assert!(distance(at, on_circle(1.2).posture) < 3e-3, "{at:?}");
    // At the end `odom` follows `map` again, and a new task clears the path.
    assert!(world.step().done && !world.keeps_odom());
    world.node.command(Task::regulate(at));
    assert_eq!(world.node.path_task().path_room(), path_task::PATH_POINTS);
}

impl World {
    /// At rest at the origin with a path of 0.6 m on the circle, and the command to follow it.
    fn on_path() -> Self {
        let mut world = Self::new(Task::Idle);
        for number in 0..=60 {
            let point = on_circle(0.01 * number as f32);
            world.node.path_task().push_path_point(point).unwrap();
        }
        world.node.path_task().finish_path();
        world.node.command(Task::follow());
        world
    }

    /// Time until the task ends without success, s, and its reason. The axles stay where they are from `held` s on.
    fn fail(&mut self, held: f32) -> (f32, Condition) {
        for epochs in 1..3000 {
            let time = DT * epochs as f32;
            let axles = self.axles;
            let output = self.step();
            assert!(!output.done, "{time}");
            if time >= held {
                self.axles = axles;
            }
            if let Some(reason) = output.failed {
                return (time, reason);
            }
        }
        panic!("neither done nor failed");
    }
}

#[test]
fn blocked_robot_makes_no_progress_within_three_seconds_and_releases_its_motors() {
    let goal = Task::regulate(Posture::new(1.0, 0.0, 0.0));
    for (world, held, most) in [
        (World::new(goal), 0.0, 3.3),
        (World::new(goal), 3.0, 8.5),
        (World::on_path(), 0.0, 3.3),
        (World::on_path(), 2.0, 5.0),
    ] {
        let mut world = world;
        let (time, reason) = world.fail(held);
        assert_eq!(reason, Condition::NoProgress, "{held}");
        assert!((held + 2.0..most).contains(&time), "{held}: {time}");
        let mut after = world.step();
        (0..60).for_each(|_| after = world.step());
        assert_eq!((after.mode, after.failed), (LeadMode::Hold, Some(reason)));
        assert_eq!(world.node.activity(world.number * EPOCH), Activity::Resting);
        let held = world.epochs(OperatingState::Armed);
        assert!((5_900..=6_001).contains(&held), "{held}");
        // The same task succeeds without the obstacle.
        let task = world.node.state.task;
        world.node.command(task);
        assert!(world.run(|_, _| ()) > 1.0);
    }
}

#[test]
fn end_of_a_path_is_missed_if_the_estimate_lies_outside_the_tolerance() {
    for (off, missed) in [(0.12, false), (0.18, true)] {
        let mut world = World::on_path();
        (0..100).for_each(|_| assert!(!world.step().done));
        // The robot drives by `odom`; over the remaining 0.45 m a difference from the estimate shrinks to 64 %.
        world.node.state.odom.as_mut().unwrap().y += off;
        match missed {
            true => assert_eq!(world.fail(f32::MAX).1, Condition::GaveUp),
            false => assert!(world.run(|_, _| ()) > 1.0),
        }
    }
}

#[test]
fn robot_that_leaves_its_path_stops_with_a_fault() {
    let mut world = World::on_path();
    (0..200).for_each(|_| assert_eq!(world.step().supervision.reason, None));
    world.node.state.odom.as_mut().unwrap().y += 0.6;
    (0..3).for_each(|_| assert!(!world.step().done));
    let output = world.step();
    assert_eq!(output.supervision.reason, Some(Condition::PathLost));
    assert_eq!(output.supervision.state, OperatingState::SafeStop);
}

#[test]
fn robot_without_the_beam_stops_after_the_degraded_distance() {
    let mut config = RobotConfig::default();
    config.lead.supervisor.degraded_distance_m = 0.2;
    let task = Task::regulate(Posture::new(2.0, 0.0, 0.0));
    let mut world = World::new(task);
    world.node = node_of(&config);
    world.node.command(task);
    for _ in 0..300 {
        world.step();
    }
    let from = world.center();
    world.late = 1000;
    // The last measurement is not used again.
    assert_ne!(world.step().fused.beam.verdict, Verdict::Used);
    let stopped = (0..1000).any(|_| {
        world.step();
        world.node.supervision().first().is_some()
    });
    assert!(stopped);
    let first = world.node.supervision().first();
    assert_eq!(first, Some(Condition::DegradedTooLong));
    // The loss counts after 0.15 s.
    let driven = distance(from, world.center());
    assert!((0.2..0.25).contains(&driven), "{driven}");
}

/// Without reports of an epoch the references continue from the odometry before.
#[test]
fn references_continue_through_an_epoch_without_reports() {
    let mut world = World::new(Task::regulate(Posture::new(2.0, 0.3, 0.0)));
    for _ in 0..300 {
        world.step();
    }
    assert!(world.node.state.governor.motion.v > 0.1);
    let mut outbox = Outbox::new();
    world
        .node
        .step(world.number * EPOCH + LEAD_PHASE, &mut outbox);
    let postures = outbox.iter().filter_map(|message| match *message {
        Message::ReferencePosture { axle, posture, .. } => Some((axle, posture)),
        _ => None,
    });
    let found: Vec<_> = postures.collect();
    assert_eq!(found.len(), 2);
    for (axle, posture) in found {
        let at = FRAMES[axle.index()].compose(posture);
        let [x, y, turn] = at.minus(world.axles[axle.index()]);
        assert!(x.hypot(y) < 3e-4 && turn.abs() < 1e-3, "{x} {y} {turn}");
    }
}

/// The beam's posture is used up to 30 ms late.
#[test]
fn late_posture_of_the_beam_is_advanced_by_odometry() {
    for late in [0, 1, 3, 4] {
        let mut world = World::new(Task::regulate(Posture::new(0.6, 0.3, 0.0)));
        world.late = late;
        for number in 0..600 {
            let bend = world.axles[0].relative_to(world.axles[1]);
            let output = world.step();
            let used = output.fused.beam.verdict == Verdict::Used;
            assert!(number < 10 || used == (late < 4), "{late}");
            let found = output.fused.relative_heading().0;
            let near = (found - bend.phi).abs() < 4e-3;
            assert!(near || late == 4, "{late}: {found} {bend:?}");
        }
    }
}

/// 0.5 m along the circle in 5 s, with speed and acceleration zero at the ends.
#[test]
fn the_robot_is_on_its_trajectory_at_every_time() {
    let mut world = World::new(Task::Idle);
    let arc_length = |time: f32| {
        let t = (time / 5.0).min(1.0);
        0.5 * t * t * t * (10.0 + t * (6.0 * t - 15.0))
    };
    for number in 0..=100 {
        let time_s = 0.05 * number as f32;
        let t = time_s / 5.0;
        let v = 0.1 * 30.0 * t * t * (1.0 - t) * (1.0 - t);
        let point = on_circle(arc_length(time_s));
        let point = TrajectoryPoint { time_s, v, point };
        world.node.path_task().push_trajectory_point(point).unwrap();
    }
    world.node.path_task().finish_trajectory();
    world.node.command(Task::track());
    let mut begun = None;
    world.run(|world, output| {
        let Some(target) = output.target else { return };
        let begun = *begun.get_or_insert(world.number);
        let time = DT * (world.number - begun) as f32;
        let meant = on_circle(arc_length(time)).posture;
        assert!(distance(target, meant) < 1e-3, "{time}: {target:?}");
        let off = distance(world.center(), on_circle(arc_length(time + DT)).posture);
        assert!(off < 0.01, "{time}: {off}");
    });
    assert!(distance(world.center(), on_circle(0.5).posture) < 3e-3);
}

/// The robot drives backwards with a curvature of −0.8 1/m. Without commands it brakes after 200 ms; the governor
/// decelerates by 0.8 m/s², over v²/2a.
#[test]
fn driven_robot_follows_its_commands_and_stops_without_them() {
    let order = Task::Drive {
        speed_m_s: -0.15,
        curvature: -0.8,
    };
    let mut world = World::new(order);
    let drive = |world: &mut World, epochs: usize| {
        for number in 0..epochs {
            if number % 5 == 0 {
                world.node.command(order);
            }
            assert!(!world.step().done);
        }
        world.center()
    };
    let before = drive(&mut world, 300);
    assert!(world.keeps_odom());
    let [.., turn] = drive(&mut world, 200).minus(before);
    assert!((turn - 0.15 * 0.8 * 2.0).abs() < 2e-3, "{turn}");
    let chord = 2.0 / 0.8 * (0.5f32 * 0.24).sin();
    assert!((distance(world.center(), before) - chord).abs() < 2e-3);
    for round in 0..2 {
        assert_eq!(world.node.supervision().count(Class::Notice), round);
        world.node.command(order);
        let slower = (1..=30).find(|_| world.step().motion.v > -0.1499);
        assert_eq!(slower, Some(20));
        let outputs: Vec<Output> = (0..300).map(|_| world.step()).collect();
        let slow = |output: &Output| output.motion.v.abs() < REST_M_S;
        let mut pairs = outputs.windows(2);
        assert!(pairs.all(|two| two[1].done == slow(&two[0])));
        let last = outputs[299];
        assert_eq!((last.done, last.mode), (true, LeadMode::Hold));
        assert_eq!(world.node.supervision().first(), None);
        drive(&mut world, 400);
    }
    let before = world.center();
    world.node.command(Task::Stop);
    world.run(|_, output| assert!(output.motion.v <= 0.0));
    // The speed falls from the first interval on.
    let stopping_distance = 0.15 * 0.15 / 1.6 - 0.15 * DT;
    assert!((distance(world.center(), before) - stopping_distance).abs() < 1e-4);
    let after = world.center();
    (0..50).for_each(|_| assert_eq!(world.step().mode, LeadMode::Hold));
    assert!(distance(world.center(), after) < 1e-3);
    drive(&mut world, 300);
    // After `Task::Idle` the stop takes 0.15 s, the rest 0.1 s and the release 0.75 s.
    world.node.command(Task::Idle);
    assert!((99..=102).contains(&world.epochs(OperatingState::SafeStop)));
}

impl LeadNode {
    /// Sets a frame bent by `bend` that pulls with a force in N, both measured at `time`.
    fn pull(&mut self, time: Micros, bend: f32, force_x: f32) {
        self.pairs[0].posture = Some(Stamped::new(Posture::new(0.37, 0.0, bend), time));
        let wrench = Wrench {
            force_x,
            ..Wrench::ZERO
        };
        self.pairs[0].wrench = Some(Stamped::new(wrench, time));
    }
}

#[test]
fn every_condition_of_a_robot_that_drives_has_its_cause() {
    let mut world = World::new(Task::regulate(Posture::new(1.0, 0.0, 0.0)));
    (0..200).for_each(|_| assert!(!world.step().done));
    let (sound, idle) = (world.step().fused, OperatingState::Idle);
    for case in 0..18 {
        let (mut node, mut fused) = (world.node.clone(), sound);
        let mut now = (world.number - 1) * EPOCH + LEAD_PHASE;
        let receive_status = |node: &mut LeadNode, state, reason| {
            node.receive(now, &beat(Node::axle(1), now, state, reason));
        };
        match case {
            1 => now += LATE - LEAD_PHASE,
            2 | 13 => receive_status(&mut node, idle, 0),
            3 => node.pull(now, 0.04, 30.0),
            4 => node.pull(now, 0.06, 20.0),
            5 => node.pull(now - 100_000, 0.06, 30.0),
            6 => fused.robot.posture.x = f32::NAN,
            7 => fused.robot.covariance[0][1] = f32::NAN,
            8 => fused.robot.covariance[0][0] = 26.0,
            9 => fused.beam.verdict = Verdict::Gated,
            10 => now += LATE - LEAD_PHASE + 1,
            11 => now += 51_000,
            12 => now += BEAM_PATIENCE + 1,
            14 => receive_status(&mut node, OperatingState::SafeStop, 1),
            15 => node.pull(now, -0.06, 30.0),
            16 => node.state.failed = Some(Condition::GaveUp),
            17 => node.state.failed = Some(Condition::NoProgress),
            _ => {}
        }
        if case == 2 {
            node.state.armed = ARMING;
        }
        let expected = match case {
            6 | 7 => Condition::NotANumber,
            8 => Condition::EstimateVague,
            9 => Condition::EstimateInconsistent,
            10 => Condition::MessageLost,
            11 => Condition::NeighbourLost,
            12 => Condition::BeamLost,
            13 | 14 => Condition::NeighbourFault,
            15 => Condition::WrenchHigh,
            16 => Condition::GaveUp,
            17 => Condition::NoProgress,
            _ => Condition::Restarted,
        };
        let conditions = node.watch(now, Some(&Fused::of_pair(fused)));
        assert_eq!(conditions == Conditions::NONE, case < 6, "{case}");
        assert_eq!(conditions.contains(expected), case > 5, "{case}");
    }
}
