//! The lead node in a loop with axles that follow their references exactly.

use super::*;
use crate::control::path::{PathPoint, TrajectoryPoint};
use crate::fusion::ekf::Verdict;
use crate::safety::Conditions;

/// Causes of a condition at the epoch after.
type Cause = fn(&mut LeadNode, &mut robot::Output, &mut Micros);

#[test]
fn every_condition_of_a_robot_that_drives_has_its_cause() {
    let mut world = World::new();
    world
        .node
        .command(Task::regulate(Posture::new(1.0, 0.0, 0.0)));
    for _ in 0..200 {
        world.step();
    }
    let fused = world.step().fused;
    let now = (world.number - 1) * EPOCH + LEAD_PHASE;
    let cases: [(Option<Condition>, Cause); 17] = [
        (None, |_, _, _| ()),
        (Some(Condition::NotANumber), |_, fused, _| {
            fused.robot.posture.x = f32::NAN
        }),
        (Some(Condition::NotANumber), |_, fused, _| {
            fused.robot.covariance[0][1] = f32::NAN
        }),
        (Some(Condition::EstimateVague), |_, fused, _| {
            fused.robot.covariance[0][0] = 26.0
        }),
        (Some(Condition::EstimateInconsistent), |_, fused, _| {
            fused.beam.verdict = Verdict::Gated
        }),
        (None, |_, _, now| *now += LATE - LEAD_PHASE),
        (Some(Condition::MessageLost), |_, _, now| {
            *now += LATE - LEAD_PHASE + 1
        }),
        (Some(Condition::NeighbourLost), |_, _, now| *now += 51_000),
        (Some(Condition::BeamLost), |_, _, now| {
            *now += BEAM_PATIENCE + 1
        }),
        (Some(Condition::NeighbourFault), |node, _, now| {
            node.receive(
                *now,
                &beat(Node::RearAxle, *now, OperatingState::SafeStop, 1),
            );
        }),
        (None, |node, _, now| {
            node.receive(*now, &beat(Node::RearAxle, *now, OperatingState::Idle, 0));
            node.state.armed = ARMING;
        }),
        (Some(Condition::NeighbourFault), |node, _, now| {
            node.receive(*now, &beat(Node::RearAxle, *now, OperatingState::Idle, 0));
            node.state.armed = ARMING + 1;
        }),
        (None, |node, _, now| node.pull(*now, 0.04, 30.0)),
        (None, |node, _, now| node.pull(*now, 0.06, 20.0)),
        (None, |node, _, now| node.pull(*now - 100_000, 0.06, 30.0)),
        (Some(Condition::WrenchHigh), |node, _, now| {
            node.pull(*now, -0.06, 30.0)
        }),
        (Some(Condition::GaveUp), |node, _, _| {
            node.state.gave_up = true
        }),
    ];
    for (k, (condition, cause)) in cases.into_iter().enumerate() {
        let (mut node, mut fused, mut now) = (world.node.clone(), fused, now);
        cause(&mut node, &mut fused, &mut now);
        let seen = node.watch(now, Some(&fused));
        match condition {
            Some(condition) => assert!(seen.contains(condition), "{k}: {seen:?}"),
            None => assert_eq!(seen, Conditions::NONE, "{k}"),
        }
    }
}

impl LeadNode {
    /// A bent beam at `time` that pulls, N.
    fn pull(&mut self, time: Micros, bend: f32, force_x: f32) {
        self.state.beam_posture = Some(Stamped::new(Posture::new(0.37, 0.0, bend), time));
        let wrench = Wrench {
            force_x,
            ..Wrench::ZERO
        };
        self.state.wrench = Some(Stamped::new(wrench, time));
    }
}

/// Both axles in the world; each reports in an odometric frame of its own.
#[derive(Clone)]
struct World {
    node: LeadNode,
    axles: [Posture; 2],
    twists: [Twist; 2],
    number: u64,
}

const FRAMES: [Posture; 2] = [Posture::new(3.0, -2.0, 1.0), Posture::new(-1.0, 4.0, -2.5)];
const HALF: f32 = 0.185;
const DT: f32 = 0.01;
const HOLD_S: f32 = 1.5;

impl World {
    /// At rest at the origin, with the frame straight.
    fn new() -> Self {
        let mut config = RobotConfig::default();
        config.lead.hold_s = HOLD_S;
        let mut node = LeadNode::new(config.build_lead().unwrap());
        node.initialize(&Place {
            center: Estimate::with_sigmas(Posture::ORIGIN, [1e-3; 3]),
            relative: Estimate::with_sigmas(Posture::new(2.0 * HALF, 0.0, 0.0), [1e-3; 3]),
            floor_drift: 0.01,
        });
        Self {
            node,
            axles: [HALF, -HALF].map(|x| Posture::new(x, 0.0, 0.0)),
            twists: [Twist::default(); 2],
            number: 0,
        }
    }

    /// Midpoint between the axles, with the direction of their chord.
    fn center(&self) -> Posture {
        let [front, rear] = self.axles;
        let (x, y) = (front.x - rear.x, front.y - rear.y);
        Posture::new(rear.x + 0.5 * x, rear.y + 0.5 * y, y.atan2(x))
    }

    fn step(&mut self) -> Output {
        let now = self.number * EPOCH;
        let mut heard = vec![
            beat(Node::FrontAxle, now, OperatingState::Active, 0),
            beat(Node::RearAxle, now, OperatingState::Active, 0),
        ];
        for axle in AxleId::BOTH {
            let (posture, twist) = (self.axles[axle.index()], self.twists[axle.index()]);
            let own = posture.relative_to(FRAMES[axle.index()]);
            let uptime = self.number.min(255) as u8;
            let [at, mut motion] = axle_report(axle, now, own, uptime, None);
            if let Message::AxleMotion {
                velocity_m_s,
                yaw_rate_rad_s,
                ..
            } = &mut motion
            {
                (*velocity_m_s, *yaw_rate_rad_s) = (twist.v, twist.omega);
            }
            heard.extend([at, motion]);
        }
        heard.extend(beam(now, self.axles[0].relative_to(self.axles[1])));
        for message in &heard {
            self.node.receive(now, message);
        }
        let mut outbox = Outbox::new();
        let before = self.node.state.nis;
        let output = self.node.step(now + LEAD_PHASE, &mut outbox);
        let (nis, after) = (output.fused.beam.nis, self.node.state.nis);
        let mean = before + (nis - before) / 256.0;
        assert!(
            before == after || (after - mean).abs() < 1e-6,
            "{before} {nis} {after}"
        );
        self.twists = [Twist::default(); 2];
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
                    let (k, half) = (axle.index(), 0.5 * DT);
                    let [ds, dphi] = [v + half * a, omega + half * turn].map(|rate| rate * DT);
                    self.axles[k] = self.axles[k].advance(ds, dphi);
                    self.twists[k] = Twist::new(v + DT * a, omega + DT * turn);
                }
                _ => {}
            }
        }
        self.number += 1;
        output
    }

    /// True if a difference of `odom` from `map` stays.
    fn keeps_odom(&self) -> bool {
        let mut other = self.clone();
        other.node.state.odom.as_mut().unwrap().y += 0.01;
        let map = other.step().fused.robot.posture;
        distance(other.node.state.odom.unwrap(), map) > 9e-3
    }

    /// Steps until the task is done; its path and duration.
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
}

fn distance(a: Posture, b: Posture) -> f32 {
    (a.x - b.x).hypot(a.y - b.y)
}

/// On a circle of radius 0.8 m to the left, from the origin.
fn on_circle(s: f32) -> PathPoint {
    PathPoint {
        posture: Posture::ORIGIN.advance(s, s / 0.8),
        kappa: 1.0 / 0.8,
        s,
    }
}

/// Held for as long as it may be, the robot is let go.
#[test]
fn the_robot_comes_to_a_goal_aside_and_behind_and_is_held_there() {
    let mut world = World::new();
    let goal = Posture::new(-0.6, 0.4, 0.3);
    world.node.command(Task::regulate(goal));
    assert_eq!(world.node.latest_goal(), Some(goal));
    assert!(!world.node.has_own_controller());
    let (mut most, mut changes) = (0.0f32, vec![]);
    world.run(|world, output| {
        if output.phase == Phase::Plan {
            let mut ahead = world.node.clone();
            changes.push(
                (0..20)
                    .filter(|_| {
                        let before = ahead.clone();
                        ahead.prepare();
                        ahead != before
                    })
                    .count(),
            );
        }
        most = most.max(output.motion.v.abs());
        let busy = if output.done {
            Activity::Resting
        } else {
            Activity::Busy
        };
        assert_eq!(world.node.activity(world.number * EPOCH), busy);
        assert_eq!(output.phase == Phase::Done, output.done);
    });
    assert!((0.05..=0.25).contains(&most), "{most}");
    assert_eq!(world.node.state.aim, Some(goal));
    assert!(
        !changes.is_empty() && changes.iter().all(|count| *count == 7),
        "{changes:?}"
    );
    let at = world.center();
    assert!(
        distance(at, goal) < 0.01 && (at.phi - goal.phi).abs() < 0.0175,
        "{at:?}"
    );
    let held = (0..1000)
        .map(|_| world.step())
        .take_while(|output| output.mode == LeadMode::Hold)
        .count();
    assert!((held as f32 * DT - HOLD_S).abs() < 0.03, "{held}");
    assert!(distance(world.center(), at) < 2e-4);
    // 0.1 s to rest, 0.1 s of rest and 0.75 s to release.
    let letting = (0..1000)
        .map(|_| world.step().supervision.state)
        .take_while(|state| *state == OperatingState::SafeStop)
        .count();
    assert!((93..=96).contains(&letting), "{letting}");
    assert_eq!(world.step().supervision.state, OperatingState::Idle);
}

#[test]
fn the_robot_follows_a_circle_and_rests_at_its_end() {
    let mut world = World::new();
    let end = on_circle(1.2);
    for number in 0..=120 {
        let point = on_circle(0.01 * number as f32);
        world.node.path_task().push_path_point(point).unwrap();
    }
    world.node.path_task().finish_path();
    let mut stopped = world.node.clone();
    stopped.command(Task::Stop);
    assert_eq!(stopped.path_task().path_room(), path_task::PATH_POINTS);
    world.node.command(Task::Follow);
    let duration = world.run(|world, output| {
        let at = world.center();
        let off = distance(at, Posture::new(0.0, 0.8, 0.0)) - 0.8;
        // The frame is straight at first.
        assert!(
            off.abs() < if at.x < 0.3 { 0.03 } else { 0.004 },
            "{at:?} {off}"
        );
        assert!(output.motion.v <= 0.2 + 1e-3);
    });
    assert!((6.0..9.0).contains(&duration), "{duration}");
    let at = world.center();
    assert!(distance(at, end.posture) < 3e-3, "{at:?}");
    // Pushed, it does not drive again, until the path is given anew.
    assert!(world.step().done && !world.keeps_odom());
    world.node.command(Task::regulate(at));
    assert_eq!(world.node.path_task().path_room(), path_task::PATH_POINTS);
}

/// 0.5 m along the circle in 5 s, with speed and acceleration zero at the ends.
#[test]
fn the_robot_is_on_its_trajectory_at_every_time() {
    let mut world = World::new();
    let way = |time: f32| {
        let t = (time / 5.0).min(1.0);
        0.5 * t * t * t * (10.0 + t * (6.0 * t - 15.0))
    };
    for number in 0..=100 {
        let time_s = 0.05 * number as f32;
        let t = time_s / 5.0;
        let v = 0.1 * 30.0 * t * t * (1.0 - t) * (1.0 - t);
        let point = on_circle(way(time_s));
        let point = TrajectoryPoint { time_s, v, point };
        world.node.path_task().push_trajectory_point(point).unwrap();
    }
    world.node.path_task().finish_trajectory();
    world.node.command(Task::Track);
    let mut begun = None;
    world.run(|world, output| {
        let Some(target) = output.target else { return };
        let begun = *begun.get_or_insert(world.number);
        let time = DT * (world.number - begun) as f32;
        let meant = on_circle(way(time)).posture;
        assert!(distance(target, meant) < 1e-3, "{time}: {target:?}");
        let off = distance(world.center(), on_circle(way(time + DT)).posture);
        assert!(off < 0.01, "{time}: {off}");
    });
    assert!(distance(world.center(), on_circle(0.5).posture) < 3e-3);
}

/// Curvature -0.8 1/m backwards; the governor stops by 0.8 m/s², over v²/2a.
#[test]
fn the_robot_drives_as_ordered_and_stops_on_its_way() {
    let mut world = World::new();
    let order = Task::Drive {
        speed_m_s: -0.15,
        curvature: -0.8,
    };
    let drive = |world: &mut World, epochs: usize| {
        for _ in 0..epochs {
            world.node.command(order);
            world.step();
        }
        world.center()
    };
    let before = drive(&mut world, 300);
    assert!(world.keeps_odom());
    let [.., turn] = drive(&mut world, 200).minus(before);
    assert!((turn - 0.15 * 0.8 * 2.0).abs() < 2e-3, "{turn}");
    let chord = 2.0 / 0.8 * (0.5f32 * 0.24).sin();
    assert!((distance(world.center(), before) - chord).abs() < 2e-3);
    let before = world.center();
    world.node.command(Task::Stop);
    world.run(|_, output| assert!(output.motion.v <= 0.0));
    let way = distance(world.center(), before);
    // The first interval is already slower.
    assert!(
        (way - (0.15 * 0.15 / 1.6 - 0.15 * DT)).abs() < 1e-4,
        "{way}"
    );
    let after = world.center();
    for _ in 0..50 {
        assert_eq!(world.step().mode, LeadMode::Hold);
    }
    assert!(distance(world.center(), after) < 1e-3);
    drive(&mut world, 300);
    // Dismissed, it is a stop of 0.15 s, of 0.1 s of rest and of 0.75 s to release.
    world.node.command(Task::Idle);
    let stopping = (0..1000)
        .map(|_| world.step())
        .take_while(|output| output.supervision.state == OperatingState::SafeStop)
        .count();
    assert!((99..=102).contains(&stopping), "{stopping}");
}
