//! The lead node of a robot of three to five axles, in a loop with axles that follow their references exactly.

use super::super::fused::Fused;
use super::*;
use crate::control::path::{PathPoint, TrajectoryPoint};
use crate::control::regulator::Tolerance;
use crate::fusion::ekf::Verdict;
use crate::fusion::joint::BeamUpdate;
use crate::math::trig::wrap_angle;
use crate::time::{EPOCH, TICK};
use crate::topology::{MAX_AXLES, Topology};

const LENGTH_M: f32 = 0.37;
const DT: f32 = 0.01;

/// True postures of the axles, each of which reports in an odometric frame of its own.
struct World {
    robot: Topology,
    node: LeadNode,
    axles: Vec<Posture>,
    /// Origin of each axle's odometric frame, and epoch of its start.
    frames: Vec<(Posture, u64)>,
    number: u64,
    /// True if the pairs are fused at the ticks before the step.
    ahead: bool,
}

impl World {
    /// Robot at rest with O at the origin and its frames straight.
    fn new(axles: usize, task: Task) -> Self {
        let mut config = RobotConfig::default();
        config.geometry.axles = axles as u32;
        let mut node = LeadNode::new(config.build_lead().unwrap());
        node.initialize(&config.placement(Posture::ORIGIN, &Default::default()));
        node.command(task);
        let x = |axle: usize| LENGTH_M * (0.5 * (axles - 1) as f32 - axle as f32);
        let frame = |axle: usize| (Posture::new(axle as f32, -2.0, 1.5 - axle as f32), 0);
        Self {
            robot: Topology::new(axles).unwrap(),
            node,
            axles: (0..axles).map(|k| Posture::new(x(k), 0.0, 0.0)).collect(),
            frames: (0..axles).map(frame).collect(),
            number: 0,
            ahead: false,
        }
    }

    fn step(&mut self) -> Output {
        let now = self.number * EPOCH;
        let sequence = sequence(now);
        for frame in self.robot.frames() {
            let k = usize::from(frame.0);
            let posture = self.axles[k].relative_to(self.axles[k + 1]);
            let covariance = diagonal([1e-9, 1e-9, 1e-8]);
            for message in [
                Message::BeamUncertainty {
                    frame,
                    sequence,
                    covariance,
                },
                Message::BeamPosture {
                    frame,
                    sequence,
                    posture,
                    gauges: 5,
                },
            ] {
                self.node.receive(now, &message);
            }
        }
        for axle in self.robot.axles() {
            let (origin, start) = self.frames[axle.index()];
            let posture = self.axles[axle.index()].relative_to(origin);
            let uptime = (self.number - start).min(255) as u8;
            let sender = Node::Axle(axle);
            let beat = beat(sender, now, OperatingState::Active, 0);
            self.node.receive(now, &beat);
            for message in axle_report(axle, now, posture, uptime, None) {
                self.node.receive(now, &message);
            }
        }
        let phases = self.node.phases();
        if self.ahead {
            let before = self.node.clone();
            let mut at = *phases.start();
            while at < *phases.end() {
                self.node.fuse_ahead(now + at, &mut Own::default());
                at += TICK;
            }
            assert!(self.node != before, "no pair fused ahead");
        }
        let mut outbox = Outbox::new();
        let output = self.node.step(now + phases.end(), &mut outbox);
        for message in outbox.iter() {
            match *message {
                Message::ReferencePosture { axle, posture, .. } => {
                    let origin = self.frames[axle.index()].0;
                    self.axles[axle.index()] = origin.compose(posture);
                }
                Message::ReferenceMotion {
                    axle,
                    velocity_m_s: v,
                    yaw_rate_rad_s: omega,
                    acceleration_m_s2: a,
                    yaw_acceleration_rad_s2: turn,
                    ..
                } => {
                    let axle = &mut self.axles[axle.index()];
                    let [ds, dphi] = [v + 0.5 * DT * a, omega + 0.5 * DT * turn].map(|it| it * DT);
                    *axle = axle.advance(ds, dphi);
                }
                _ => {}
            }
        }
        self.number += 1;
        output
    }

    /// Posture of O by the definition: mean of the midpoints of neighbours, heading from the last axle to the first.
    fn center(&self) -> Posture {
        let middles = self.axles.windows(2).map(|pair| {
            let [a, b] = [pair[0], pair[1]];
            [0.5 * (a.x + b.x), 0.5 * (a.y + b.y)]
        });
        let share = 1.0 / self.robot.frame_count() as f32;
        let [x, y] = middles.fold([0.0; 2], |sum, at| {
            [sum[0] + share * at[0], sum[1] + share * at[1]]
        });
        let (first, last) = (self.axles[0], self.axles[self.axles.len() - 1]);
        Posture::new(x, y, (first.y - last.y).atan2(first.x - last.x))
    }
}

fn gap(a: Posture, b: Posture) -> (f32, f32) {
    (
        (a.x - b.x).hypot(a.y - b.y),
        wrap_angle(a.phi - b.phi).abs(),
    )
}

/// Steps until the task is done.
fn finish(world: &mut World) -> Output {
    for _ in 0..6000 {
        let output = world.step();
        assert_eq!(world.node.supervision().first(), None);
        if output.done {
            return output;
        }
    }
    panic!("not done: {:?}", world.center());
}

#[test]
fn chain_reaches_its_goal_with_straight_frames_and_knows_every_axle() {
    for axles in 3..=MAX_AXLES {
        let goal = Posture::new(1.2, 0.9, 0.7);
        let mut world = World::new(axles, Task::regulate(goal));
        let output = finish(&mut world);
        let (off, turn) = gap(world.center(), goal);
        assert!(off < 5e-3 && turn < 5e-3, "{axles}: {off} {turn}");
        // The filter expects tyres that yield to the frames; those of this world do not.
        let (off, turn) = gap(output.fused.robot.posture, world.center());
        assert!(off < 4e-3 && turn < 4e-3, "{axles}: {off} {turn}");
        let straight = Posture::new(LENGTH_M, 0.0, 0.0);
        for pair in world.axles.windows(2) {
            let (off, turn) = gap(pair[0].relative_to(pair[1]), straight);
            assert!(off < 1e-3 && turn < 5e-3, "{axles}: {off} {turn}");
        }
        let inner: Vec<_> = output.inner.into_iter().flatten().collect();
        assert_eq!(inner.len(), axles - 2);
        let estimated = [output.fused.front.posture]
            .into_iter()
            .chain(inner)
            .chain([output.fused.rear.posture]);
        for (estimate, axle) in estimated.zip(&world.axles) {
            let (off, turn) = gap(estimate, *axle);
            assert!(off < 5e-3 && turn < 5e-3, "{axles}: {off} {turn}");
        }
    }
}

#[test]
fn pairs_fused_ahead_give_the_outputs_of_one_step() {
    let goal = Posture::new(-0.8, 0.4, -0.5);
    let mut worlds = [false, true].map(|ahead| World {
        ahead,
        ..World::new(4, Task::regulate(goal))
    });
    for _ in 0..700 {
        let [one, other] = worlds.each_mut().map(World::step);
        assert_eq!(one, other);
    }
    assert!(worlds[0].node.state.governor.motion.v.abs() > 0.05);
}

/// After its restart the odometry of an inner axle begins anew; both neighbours and beams locate it.
#[test]
fn restarted_inner_axle_is_found_by_its_neighbours() {
    let mut world = World::new(3, Task::Idle);
    for _ in 0..100 {
        world.step();
    }
    // The axle was moved by its frames while its board was off.
    world.axles[1] = Posture::new(0.01, 0.02, 0.1);
    world.frames[1] = (world.axles[1], world.number);
    let mut output = Output::default();
    for _ in 0..60 {
        output = world.step();
    }
    let (off, turn) = gap(output.inner[0].unwrap(), world.axles[1]);
    assert!(off < 3e-3 && turn < 5e-3, "{off} {turn}");
    let (off, turn) = gap(output.fused.front.posture, world.axles[0]);
    assert!(off < 3e-3 && turn < 5e-3, "{off} {turn}");
}

/// The covariance of O never falls below that of perfectly correlated pairs.
#[test]
fn covariance_of_o_is_the_mean_over_the_pairs() {
    let mut world = World::new(5, Task::regulate(Posture::new(2.0, 0.0, 0.0)));
    let mut output = Output::default();
    for _ in 0..900 {
        output = world.step();
    }
    let fused: Vec<_> = world
        .node
        .fusing
        .pairs()
        .iter()
        .map(|it| it.robot)
        .collect();
    for i in 0..3 {
        let mean = fused.iter().map(|it| it.covariance[i][i]).sum::<f32>() / 4.0;
        let found = output.fused.robot.covariance[i][i];
        assert!((found / mean - 1.0).abs() < 1e-4, "{i}: {found} {mean}");
    }
}

#[test]
fn chain_drives_forward_and_back_on_command() {
    let mut world = World::new(3, Task::Idle);
    let drive = |world: &mut World, speed_m_s: f32, curvature: f32, epochs: usize| {
        let mut last = Output::default();
        for _ in 0..epochs {
            world.node.command(Task::Drive {
                speed_m_s,
                curvature,
            });
            last = world.step();
        }
        last
    };
    let output = drive(&mut world, 0.15, 1.0, 600);
    assert!((output.motion.v - 0.15).abs() < 1e-3, "{:?}", output.motion);
    let circle = world.axles[0].relative_to(world.axles[1]);
    assert!((circle.phi - LENGTH_M).abs() < 0.02, "{circle:?}");
    for (pair, axles) in world.node.pairs.iter().zip(world.axles.windows(2)) {
        let bend = wrap_angle(axles[0].phi - axles[1].phi);
        assert!(
            (pair.bend.mean - bend).abs() < 5e-3,
            "{} {bend}",
            pair.bend.mean
        );
    }
    let output = drive(&mut world, -0.15, 0.0, 600);
    assert!((output.motion.v + 0.15).abs() < 1e-3, "{:?}", output.motion);
    let last = world.axles[1].relative_to(world.axles[2]);
    assert!(last.phi.abs() < 0.02, "{last:?}");
}

/// Without commands the robot drives on for the time of the dead man, then comes to rest, and its task is done.
#[test]
fn chain_without_commands_comes_to_rest() {
    let mut world = World::new(3, Task::Idle);
    let task = Task::Drive {
        speed_m_s: 0.15,
        curvature: 0.5,
    };
    for _ in 0..400 {
        world.node.command(task);
        world.step();
    }
    let outputs: Vec<_> = (0..200).map(|_| world.step()).collect();
    let silent = (DEAD_MAN / EPOCH) as usize - 2;
    let driving = outputs.iter().take(silent);
    assert!(driving.clone().all(|it| it.motion.v > 0.14 && !it.done));
    let done = outputs.iter().position(|it| it.done).unwrap();
    assert!(done > silent && outputs[done].motion.v.abs() < REST_M_S);
    assert_eq!(outputs[done].mode, LeadMode::Hold);
}

/// Points of the trajectory that have passed make room for more.
#[test]
fn trajectory_of_a_chain_has_room_for_more_points() {
    let within = Tolerance::default();
    let mut world = World::new(3, Task::Track { within });
    let mut next = 0u16;
    let mut fill = |world: &mut World| {
        while world.node.path_task.trajectory_room() > 0 {
            let time_s = 0.1 * f32::from(next);
            let s = 0.1 * time_s;
            let point = PathPoint {
                posture: Posture::new(LENGTH_M + s, 0.0, 0.0),
                kappa: 0.0,
                s,
            };
            let point = TrajectoryPoint {
                time_s,
                v: 0.1,
                point,
            };
            world.node.path_task.push_trajectory_point(point).unwrap();
            next += 1;
        }
        next
    };
    let held = fill(&mut world);
    for _ in 0..400 {
        world.step();
    }
    // Four seconds less the time to build the curve.
    assert!((36..=41).contains(&(fill(&mut world) - held)));
}

/// Of the frames' updates the output has a rejected one, else that with the larger NIS.
#[test]
fn worst_update_of_the_frames_is_reported() {
    let update = |verdict, nis| BeamUpdate {
        verdict,
        nis,
        ..BeamUpdate::default()
    };
    let [used, other, gated] = [
        update(Verdict::Used, 3.0),
        update(Verdict::Used, 2.0),
        update(Verdict::Gated, 1.0),
    ];
    for (a, b, worst) in [
        (used, gated, gated),
        (gated, used, gated),
        (used, other, used),
        (other, used, used),
    ] {
        let mut pairs = [robot::Output::default(); MAX_FRAMES];
        (pairs[0].beam, pairs[1].beam) = (a, b);
        let fused = joined(&pairs);
        assert_eq!(fused.estimates.beam, worst);
        assert_eq!(fused.is_refused(), worst.verdict == Verdict::Gated);
    }
}

/// A chain too far from its path stops, and its path counts as lost.
#[test]
fn path_far_from_a_chain_is_lost() {
    let within = Tolerance::default();
    let mut world = World::new(3, Task::Follow { within });
    for k in 0..100u8 {
        let s = 0.01 * f32::from(k);
        let point = PathPoint {
            posture: Posture::new(LENGTH_M + s, 0.9, 0.0),
            kappa: 0.0,
            s,
        };
        world.node.path_task.push_path_point(point).unwrap();
    }
    for _ in 0..100 {
        world.step();
    }
    assert!(world.node.path_task.is_lost());
    assert_eq!(world.node.state.governor.motion.v, 0.0);
}

/// A board executes orders of a host after the reports of the epoch and before the work of its lead node.
#[test]
fn orders_are_executed_before_the_work_of_the_lead_node() {
    for axles in 2..=MAX_AXLES {
        let robot = Topology::new(axles).unwrap();
        let order = order_phase(robot);
        assert!((TICK..begin_phase(robot)).contains(&order), "{axles}");
        assert!(begin_phase(robot) <= step_phase(robot) && step_phase(robot) < EPOCH);
    }
}

/// A single pair is the robot: nothing is joined.
#[test]
fn robot_of_two_axles_has_the_estimates_of_its_pair() {
    let estimate = |x: f32| Estimate::new(Posture::new(x, 0.2, 0.3), diagonal([x, 2.0, 3.0]));
    let pair = robot::Output {
        front: estimate(1.0),
        rear: estimate(0.6),
        robot: estimate(0.7),
        ..robot::Output::default()
    };
    assert_eq!(Fused::of_pair(pair).estimates, pair);
}

/// Three axles, joined.
fn joined(pairs: &[robot::Output; MAX_FRAMES]) -> Fused {
    let anchors = &mut [Posture::ORIGIN; MAX_FRAMES];
    Fused::new(Topology::new(3).unwrap(), pairs, anchors)
}

/// A pair of axles that stand at `front` and `rear`.
fn pair_at([front, rear]: [Posture; 2]) -> robot::Output {
    let [x, y] = [front.x + rear.x, front.y + rear.y].map(|sum| 0.5 * sum);
    let estimate = |at| Estimate::new(at, diagonal([1.0, 4.0, 2.0]));
    robot::Output {
        front: estimate(front),
        rear: estimate(rear),
        robot: estimate(Posture::new(x, y, 0.0)),
        ..robot::Output::default()
    }
}

/// A bent chain moves, and the filters of its pairs have wrong places and headings. Each axle moves as it does in
/// truth, as seen from itself: no axle slides sideways.
#[test]
fn axles_move_as_in_truth_though_the_headings_of_the_pairs_differ() {
    let robot = Topology::new(5).unwrap();
    let mut axles = [Posture::ORIGIN; MAX_AXLES];
    for k in 1..MAX_AXLES {
        axles[k] = axles[k - 1].compose(Posture::new(-0.35, 0.05, 0.5));
    }
    let wrong = [
        Posture::new(0.1, -0.2, 0.3),
        Posture::new(-0.1, 0.1, -0.2),
        Posture::new(0.0, 0.3, 0.1),
        Posture::new(0.2, 0.0, -0.4),
    ];
    let motion = Posture::new(0.004, 0.001, 0.02);
    let mut anchors = [Posture::ORIGIN; MAX_FRAMES];
    let mut last: Option<[Posture; MAX_AXLES]> = None;
    for _ in 0..200 {
        let mut pairs = [robot::Output::default(); MAX_FRAMES];
        for (k, pair) in pairs.iter_mut().enumerate() {
            *pair = pair_at([axles[k], axles[k + 1]].map(|it| wrong[k].compose(it)));
        }
        let before = anchors[0];
        let fused = Fused::new(robot, &pairs, &mut anchors);
        let now: [_; MAX_AXLES] = std::array::from_fn(|k| fused.axle(k));
        let next = axles.map(|it| motion.compose(it));
        if let Some(last) = last {
            for k in 0..MAX_AXLES {
                let found = now[k].relative_to(last[k]);
                let [dx, dy, dphi] = found.minus(next[k].relative_to(axles[k]));
                assert!(dx.abs() + dy.abs() + dphi.abs() < 2e-5, "{k}: {found:?}");
            }
        }
        // The covariance turns with the pair.
        let (sin, cos) = before.phi.sin_cos();
        let expected = cos * cos + 4.0 * sin * sin;
        let found = fused.estimates.front.covariance[0][0];
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        (axles, last) = (next, Some(now));
    }
    let turned = anchors[3].phi + wrong[3].phi;
    let front = anchors[0].phi + wrong[0].phi;
    assert!(wrap_angle(turned - front).abs() < 1e-3, "{turned} {front}");
}

/// Two pairs whose estimates of the inner axle differ: the chain keeps the relative postures of both, and lies at the
/// mean of their positions and headings.
#[test]
fn pairs_are_joined_at_their_mean() {
    let relative = [
        Posture::new(0.36, 0.05, 0.3),
        Posture::new(0.37, -0.02, -0.1),
    ];
    let rear = [Posture::new(0.4, 0.9, 0.5), Posture::new(0.1, 0.7, 0.4)];
    let covariance = |k: usize| diagonal([1.0, 2.0, 3.0].map(|it| it * (k + 1) as f32));
    let mut pairs = [robot::Output::default(); MAX_FRAMES];
    for k in 0..2 {
        let front = rear[k].compose(relative[k]);
        let [x, y] = [front.x + rear[k].x, front.y + rear[k].y].map(|sum| 0.5 * sum);
        let estimate = |at| Estimate::new(at, covariance(k));
        pairs[k].front = estimate(front);
        pairs[k].rear = estimate(rear[k]);
        pairs[k].robot = estimate(Posture::new(x, y, 0.0));
    }
    let fused = joined(&pairs);
    let axles: Vec<_> = (0..3).map(|k| fused.axle(k)).collect();
    let (mut off, mut turn) = ([0.0f32; 2], 0.0);
    for k in 0..2 {
        let found = axles[k].relative_to(axles[k + 1]);
        let [dx, dy, dphi] = found.minus(relative[k]);
        assert!(dx.abs() + dy.abs() + dphi.abs() < 1e-6, "{found:?}");
        let center = pairs[k].robot.posture;
        off[0] += 0.5 * (axles[k].x + axles[k + 1].x) - center.x;
        off[1] += 0.5 * (axles[k].y + axles[k + 1].y) - center.y;
        turn += axles[k].phi - pairs[k].front.posture.phi;
    }
    assert!(
        off[0].abs() + off[1].abs() + turn.abs() < 1e-6,
        "{off:?} {turn}"
    );
    let robot::Output {
        front, rear, robot, ..
    } = fused.estimates;
    assert_eq!(
        (front.covariance, rear.covariance),
        (covariance(0), covariance(1))
    );
    assert_eq!(robot.covariance[1][1], 3.0);
}

/// The motion of O by odometry is its change less the mean correction of the pairs.
#[test]
fn motion_of_o_leaves_out_the_corrections() {
    let mut node = World::new(3, Task::Idle).node;
    node.state.map = Some(Posture::new(1.0, 2.0, 0.3));
    node.pairs[0].corrected = [0.01, -0.02, 0.04];
    node.pairs[1].corrected = [0.03, 0.06, -0.02];
    let (heading, moved) = node.moved(Posture::new(1.1, 2.2, 0.35)).unwrap();
    let [dx, dy, turn] = moved.minus(Posture::new(0.08, 0.18, 0.04));
    assert_eq!(heading, 0.3);
    assert!(dx.abs() + dy.abs() + turn.abs() < 1e-6, "{moved:?}");
}

/// A chain takes its limits from governor and regulator.
#[test]
fn chain_has_the_limits_of_governor_and_regulator() {
    let mut config = RobotConfig::default();
    config.geometry.axles = 4;
    config.lead.governor.max_acceleration_m_s2 = 0.3;
    config.lead.governor.stop_deceleration_m_s2 = 0.7;
    config.lead.governor.speed_rate_per_s = 5.0;
    config.lead.governor.reversal_hold_s = 0.15;
    config.lead.governor.max_wheel_speed_m_s = 0.5;
    config.lead.regulator.settle_time_s = 0.25;
    config.lead.regulator.accept_distance_m = 0.012;
    config.lead.regulator.accept_heading_rad = 0.03;
    config.lead.regulator.release_factor = 3.0;
    config.lead.regulator.max_attempts = 7;
    let built = config.build_lead().unwrap();
    let expected = train::Config {
        axles: 4,
        max_curvature_per_m: built.cascade.max_curvature(),
        acceleration_m_s2: 0.3,
        stop_deceleration_m_s2: 0.7,
        speed_lag_s: 0.2,
        reversal_hold_s: 0.15,
        max_wheel_speed_m_s: 0.5,
        settle_time_s: 0.25,
        accept_distance_m: 0.012,
        accept_heading_rad: 0.03,
        release_factor: 3.0,
        max_attempts: 7,
        path_speed_m_s: config.lead.course.path.max_speed_m_s,
        ..train::Config::default()
    };
    assert_eq!(built.train, Some(expected.build().unwrap()));
}
