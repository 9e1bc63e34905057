use super::super::Placement;
use super::*;
use crate::fusion::constants::{GYRO_BIAS, SCALE, ZERO};
use crate::fusion::ekf::Verdict;
use crate::fusion::robot::{self, Mode};
use crate::math::{Posture, Wrench};
use crate::node::robot::RobotConfig;
use crate::node::testing::{Cause, assert_watched, beat, supervisor_in};
use crate::time::Stamped;

const NOW: Micros = 1_000_000;

/// A lead node and its estimate.
#[derive(Clone)]
struct Watched {
    node: LeadNode,
    fused: Option<Fused>,
}

impl Watched {
    fn conditions(&self) -> Conditions {
        self.node.watch(NOW, self.fused.as_ref())
    }

    fn request(&self) -> Option<StateRequest> {
        self.node.request(self.fused.as_ref())
    }

    fn fused(&mut self) -> &mut robot::Output {
        &mut self.fused.as_mut().unwrap().estimates
    }

    fn pair(&mut self) -> &mut Pair {
        &mut self.node.pairs[0]
    }

    fn receive_heartbeat(&mut self, node: Node, ago: Micros, state: OperatingState, reason: u8) {
        let time = NOW - ago;
        let message = beat(node, time, state, reason);
        self.node.state.peers.receive(time, &message);
    }

    /// Receives a heartbeat in this state, `armed` µs after the lead node was armed.
    fn rests(&mut self, node: Node, state: OperatingState, armed: Micros) {
        self.receive_heartbeat(node, 0, state, 0);
        self.node.state.armed = armed;
    }

    fn reported(&mut self, axle: usize, ago: Micros) {
        let posture = Stamped::new(Posture::ORIGIN, NOW - ago);
        self.node.tracks[axle].report.whole = Some((posture, NOW));
    }

    /// Sets the relative heading by the beam, and the age of the measurement.
    fn bent(&mut self, turn: f32, ago: Micros) {
        let posture = Posture::new(0.37, 0.0, turn);
        self.pair().posture = Some(Stamped::new(posture, NOW - ago));
    }

    fn used(&mut self, ago: Micros) {
        self.pair().used = Some(Stamped::new(NOW - ago, NOW));
    }

    fn pulled(&mut self, force_x: f32, ago: Micros) {
        let wrench = Wrench {
            force_x,
            ..Wrench::ZERO
        };
        self.pair().wrench = Some(Stamped::new(wrench, NOW - ago));
    }

    fn moves(&mut self, axle: usize, v: f32, omega: f32) {
        self.node.tracks[axle].report.twist = Twist::new(v, omega);
    }

    fn set_constant(&mut self, constant: usize, value: f32) {
        let fusion = self.pair().fusion.as_mut().unwrap();
        fusion.set_constant(constant, value);
    }
}

fn in_state(state: OperatingState) -> Watched {
    with_mode(state, Mode::Joint)
}

/// A robot in this state, with a goal and without conditions. Its relative heading is 0.2 rad.
fn with_mode(state: OperatingState, mode: Mode) -> Watched {
    let mut config = RobotConfig::default();
    config.lead.fusion.mode = mode;
    let mut node = LeadNode::new(config.build_lead().unwrap());
    let relative = Posture::new(0.37, 0.0, 0.2);
    let sigmas = [1e-3; 3];
    node.initialize(&Placement {
        center: Estimate::with_sigmas(Posture::ORIGIN, sigmas),
        relative: Estimate::with_sigmas(relative, sigmas),
        floor_drift: 0.01,
    });
    node.command(Task::regulate(Posture::ORIGIN));
    node.state.supervisor = supervisor_in(state);
    let fused = robot::Output {
        front: Estimate::with_sigmas(relative, sigmas),
        rear: Estimate::with_sigmas(Posture::ORIGIN, sigmas),
        robot: Estimate::with_sigmas(Posture::ORIGIN, sigmas),
        ..robot::Output::default()
    };
    let mut watched = Watched {
        node,
        fused: Some(Fused::of_pair(fused)),
    };
    for node in [Node::axle(0), Node::axle(1)] {
        watched.receive_heartbeat(node, 0, OperatingState::Active, 0);
    }
    (0..2).for_each(|axle| watched.reported(axle, 0));
    watched.bent(0.2, 0);
    watched.used(0);
    watched.pulled(0.0, 0);
    watched
}

/// Causes from heartbeats: the front axle is silent and the rear axle stops or does not arm; then the reverse.
const HEARTBEATS: [[Cause<Watched>; 3]; 2] = {
    use OperatingState::{Active, Fault, Idle, SafeStop};
    const LOST: &[Condition] = &[Condition::NeighbourLost];
    const FAULT: &[Condition] = &[Condition::NeighbourFault];
    [
        [
            (
                LOST,
                |w| w.receive_heartbeat(Node::axle(0), 50_001, Active, 0),
                |w| w.receive_heartbeat(Node::axle(0), 50_000, Active, 0),
            ),
            (
                FAULT,
                |w| w.receive_heartbeat(Node::axle(1), 0, SafeStop, 0x80),
                |w| w.receive_heartbeat(Node::axle(1), 0, SafeStop, 0),
            ),
            (
                FAULT,
                |w| w.rests(Node::axle(1), Idle, 310_000),
                |w| w.rests(Node::axle(1), Idle, 300_000),
            ),
        ],
        [
            (
                LOST,
                |w| w.receive_heartbeat(Node::axle(1), 50_001, Active, 0),
                |w| w.receive_heartbeat(Node::axle(1), 50_000, Active, 0),
            ),
            (
                FAULT,
                |w| w.receive_heartbeat(Node::axle(0), 0, Fault, 0x80),
                |w| w.receive_heartbeat(Node::axle(0), 0, Active, 0x80),
            ),
            (
                FAULT,
                |w| w.rests(Node::axle(0), Idle, 300_001),
                |w| w.rests(Node::axle(0), Active, 310_000),
            ),
        ],
    ]
};

/// Causes of the requirements table while the robot drives.
const WHILE_DRIVING: &[Cause<Watched>] = {
    use Condition::{
        BeamInconsistent, BeamLost, CommanderSilent, EstimateInconsistent, EstimateVague,
        FrameBent, GaveUp, MessageLost, NotANumber, WheelsInconsistent, WrenchHigh,
    };
    &[
        (
            &[MessageLost],
            |w| w.reported(0, 20_001),
            |w| w.reported(0, 20_000),
        ),
        (
            &[MessageLost],
            |w| w.reported(1, 20_001),
            |w| w.reported(1, 20_000),
        ),
        (&[BeamLost], |w| w.used(100_001), |w| w.used(100_000)),
        (&[BeamLost], |w| w.pair().used = None, |_| {}),
        (&[FrameBent], |w| w.bent(1.41, 0), |w| w.bent(1.39, 0)),
        (
            &[FrameBent],
            |w| w.bent(-1.41, 50_000),
            |w| w.bent(-1.41, 50_001),
        ),
        (&[FrameBent], |w| w.bent(f32::NAN, 0), |w| w.bent(0.3, 0)),
        (&[WrenchHigh], |w| w.pulled(25.1, 0), |w| w.pulled(24.9, 0)),
        (
            &[WrenchHigh],
            |w| w.pulled(-25.1, 50_000),
            |w| w.pulled(-25.1, 50_001),
        ),
        (
            &[NotANumber],
            |w| w.fused().robot.covariance[0][2] = f32::NAN,
            |_| {},
        ),
        (
            &[EstimateInconsistent],
            |w| w.fused().beam.verdict = Verdict::Gated,
            |w| w.fused().beam.verdict = Verdict::Used,
        ),
        (
            &[EstimateVague],
            |w| w.fused().robot.covariance[1][1] = 25.1,
            |w| w.fused().robot.covariance[1][1] = 24.9,
        ),
        (
            &[WheelsInconsistent],
            |w| w.set_constant(SCALE, 1.0),
            |w| w.set_constant(SCALE, 0.0),
        ),
        (
            &[BeamInconsistent],
            |w| w.pair().nis = 3.001,
            |w| w.pair().nis = 3.0,
        ),
        (
            &[BeamInconsistent],
            |w| w.pair().nis = f32::NAN,
            |w| w.pair().nis = 0.0,
        ),
        (
            &[CommanderSilent],
            |w| w.node.state.lost = true,
            |w| w.node.state.lost = false,
        ),
        // Only one inconsistent part and one reason of a failure are reported at a time.
        (
            &[GaveUp],
            |w| w.node.state.failed = Some(GaveUp),
            |w| w.node.state.failed = None,
        ),
    ]
};

#[test]
fn each_cause_brings_its_condition_alone_and_among_all_others() {
    let sound = in_state(OperatingState::Active);
    for beats in HEARTBEATS {
        let causes = [&beats, WHILE_DRIVING].concat();
        assert_watched(&sound, &causes, Watched::conditions);
    }
}

#[test]
fn each_failure_reason_and_inconsistent_part_has_its_condition() {
    let parts = [
        (SCALE, Condition::WheelsInconsistent),
        (ZERO, Condition::GaugesInconsistent),
        (GYRO_BIAS, Condition::GyrosInconsistent),
    ];
    for (constant, condition) in parts {
        let mut watched = in_state(OperatingState::Active);
        watched.set_constant(constant, 1.0);
        assert_eq!(watched.conditions(), Conditions::only(condition));
    }
    for reason in [Condition::GaveUp, Condition::NoProgress] {
        let mut watched = in_state(OperatingState::Active);
        watched.node.state.failed = Some(reason);
        assert_eq!(watched.conditions(), Conditions::only(reason));
    }
}

/// Conditions of each cause in every state.
#[test]
fn powered_and_driving_conditions_occur_in_their_states_alone() {
    use OperatingState::{Active, Armed, Fault, SafeStop};
    for state in OperatingState::ALL {
        let found = |spoil: fn(&mut Watched), condition| {
            let mut watched = in_state(state);
            spoil(&mut watched);
            watched.conditions().contains(condition)
        };
        let powered = matches!(state, Armed | Active | SafeStop);
        assert_eq!(found(|w| w.fused = None, Condition::NeighbourLost), powered);
        for of_estimate in [Condition::EstimateInconsistent, Condition::EstimateVague] {
            assert!(!found(|w| w.fused = None, of_estimate));
        }
        let stopped = |w: &mut Watched| w.receive_heartbeat(Node::axle(1), 0, Fault, 0x80);
        assert_eq!(found(stopped, Condition::NeighbourFault), powered);
        let late = |w: &mut Watched| w.reported(1, 20_001);
        assert_eq!(found(late, Condition::MessageLost), powered);
        let refused = |w: &mut Watched| w.fused().beam.verdict = Verdict::Gated;
        assert_eq!(
            found(refused, Condition::EstimateInconsistent),
            state == Active
        );
        let silent = |w: &mut Watched| w.receive_heartbeat(Node::axle(0), 50_001, Active, 0);
        assert!(found(silent, Condition::NeighbourLost), "{state:?}");
    }
}

/// The lead node counts the time in which the axles have to arm while it is armed or active.
#[test]
fn arming_time_runs_while_armed_or_active() {
    let mut node = in_state(OperatingState::Armed).node;
    for (state, armed, held) in [
        (OperatingState::Armed, 10_000, 10_000),
        (OperatingState::Active, 20_000, 0),
        (OperatingState::Armed, 30_000, 10_000),
        (OperatingState::Armed, 40_000, 20_000),
        (OperatingState::SafeStop, 0, 0),
        (OperatingState::Armed, 10_000, 10_000),
        (OperatingState::Idle, 0, 0),
    ] {
        node.hold(state);
        assert_eq!(
            (node.state.armed, node.state.held),
            (armed, held),
            "{state:?}"
        );
    }
    // A robot that is held for more than 60 s is released.
    for epochs in 1..=6001 {
        assert!(!node.state.released, "{epochs}");
        node.hold(OperatingState::Armed);
    }
    assert!(node.state.released);
}

/// Before the start of the fusion the age of the beam's posture counts. A fusion without the beam never loses the
/// beam.
#[test]
fn beam_is_lost_only_for_a_fusion_that_uses_it() {
    let lost = Condition::BeamLost;
    for (mode, uses) in [
        (Mode::Joint, true),
        (Mode::Intersection, true),
        (Mode::Odometry, false),
    ] {
        let mut watched = with_mode(OperatingState::Active, mode);
        watched.used(100_001);
        assert_eq!(watched.conditions().contains(lost), uses, "{mode:?}");
        watched.pair().fusion = None;
        for (ago, old) in [(50_000, false), (50_001, true)] {
            watched.bent(0.2, ago);
            assert_eq!(
                watched.conditions().contains(lost),
                old && uses,
                "{mode:?} {ago}"
            );
        }
    }
}

/// The bend is the beam's if its posture is fresh, else the estimate's. The wrench counts only on a bent frame.
#[test]
fn bend_is_by_beam_or_estimate_and_wrench_counts_on_a_bent_frame() {
    for (by_beam, by_axles, bent) in [
        (Some(0.2), 1.5, false),
        (Some(1.5), 0.2, true),
        (None, 1.5, true),
        (None, -1.5, true),
        (None, f32::NAN, true),
        (None, 0.2, false),
    ] {
        let mut watched = in_state(OperatingState::Active);
        watched.fused().front.posture.phi = by_axles;
        match by_beam {
            Some(turn) => watched.bent(turn, 0),
            None => watched.pair().posture = None,
        }
        let found = watched.conditions().contains(Condition::FrameBent);
        assert_eq!(found, bent, "{by_beam:?} {by_axles}");
    }
    for (turn, high) in [
        (0.05, false),
        (-0.05, false),
        (0.051, true),
        (-0.051, true),
        (f32::NAN, true),
    ] {
        let mut watched = in_state(OperatingState::Active);
        watched.pulled(30.0, 0);
        watched.bent(turn, 0);
        let found = watched.conditions().contains(Condition::WrenchHigh);
        assert_eq!(found, high, "{turn}");
    }
    let mut unknown = in_state(OperatingState::Idle);
    unknown.pulled(30.0, 0);
    (unknown.fused, unknown.pair().posture) = (None, None);
    assert!(!unknown.conditions().contains(Condition::WrenchHigh));
}

/// Each of three causes alone makes the end of a task uncertain, and has no effect before the end.
#[test]
fn end_with_inconsistency_or_wide_covariance_is_uncertain() {
    let causes: [fn(&mut Watched); 3] = [
        |w| w.set_constant(ZERO, 1.0),
        |w| w.pair().nis = 3.1,
        |w| w.fused().robot.covariance[0][0] = 0.01,
    ];
    for apply in causes {
        for done in [false, true] {
            let mut watched = in_state(OperatingState::Active);
            watched.node.state.done = done;
            let uncertain = Condition::ReachedUncertain;
            assert!(!watched.conditions().contains(uncertain));
            apply(&mut watched);
            assert_eq!(watched.conditions().contains(uncertain), done);
        }
    }
    let mut vague = in_state(OperatingState::Active);
    (vague.node.state.done, vague.fused) = (true, None);
    assert!(!vague.conditions().contains(Condition::ReachedUncertain));
}

/// The condition holds 200 ms after the latest speed command; other tasks have no such limit.
#[test]
fn drive_without_commands_for_200_ms_reports_commander_silent() {
    let by_hand = Task::Drive {
        speed_m_s: 0.1,
        curvature: 0.0,
    };
    for (task, ms, silent) in [
        (by_hand, 199, false),
        (by_hand, 200, true),
        (Task::regulate(Posture::ORIGIN), 900, false),
        (Task::Stop, 900, false),
    ] {
        let mut watched = in_state(OperatingState::Active);
        watched.node.command(task);
        assert_eq!(watched.node.state.silent, 0);
        watched.node.state.silent = ms * 1_000;
        let found = watched.conditions().contains(Condition::CommanderSilent);
        assert_eq!(found, silent, "{task:?} {ms}");
    }
}

/// Compares every state with each task, a finished or failed task, and a robot that was held for too long.
#[test]
fn requests_match_the_table() {
    use OperatingState::{Active, Armed, Boot, Fault, Idle, SafeStop};
    let goto = Task::regulate(Posture::ORIGIN);
    let tasks = [
        Task::Idle,
        Task::Clear,
        Task::Stop,
        goto,
        Task::follow(),
        Task::track(),
    ];
    let mut tried = 0;
    for state in OperatingState::ALL {
        for task in tasks {
            for (released, done, failed, v) in [
                (false, false, None, 0.0),
                (true, false, None, 0.0),
                (false, true, None, 0.1),
                (false, false, Some(Condition::GaveUp), 0.0),
                (false, false, Some(Condition::GaveUp), 0.1),
            ] {
                let mut watched = in_state(state);
                watched.node.command(task);
                let node = &mut watched.node.state;
                (node.released, node.done, node.failed) = (released, done, failed);
                node.governor.motion.v = v;
                let rests = released || matches!(task, Task::Idle | Task::Clear);
                let over = done || failed.is_some();
                let expected = match state {
                    Boot => Some(StateRequest::Ready),
                    Idle => (!rests).then_some(StateRequest::Arm),
                    Armed | Active if rests => Some(StateRequest::Disarm),
                    Armed => (!over).then_some(StateRequest::Start),
                    Active => {
                        (done || failed.is_some() && v == 0.0).then_some(StateRequest::Finish)
                    }
                    SafeStop => None,
                    Fault => (task == Task::Clear).then_some(StateRequest::Clear),
                };
                let context = format!("{state:?} {task:?} {released} {done} {failed:?} {v}");
                assert_eq!(watched.request(), expected, "{context}");
                tried += 1;
            }
        }
    }
    assert_eq!(tried, 6 * 6 * 5);
}

/// The start requires both axles at rest, in speed and in yaw rate, and no rejected measurement of the beam.
#[test]
fn the_robot_starts_once_both_axles_rest_and_the_beam_agrees() {
    let starts = |spoil: &dyn Fn(&mut Watched)| {
        let mut watched = in_state(OperatingState::Armed);
        spoil(&mut watched);
        watched.request() == Some(StateRequest::Start)
    };
    for axle in 0..2 {
        for (v, omega, rests) in [
            (0.02, -0.1, true),
            (-0.02, 0.1, true),
            (0.0201, 0.0, false),
            (-0.0201, 0.0, false),
            (0.0, 0.101, false),
            (0.0, -0.101, false),
            (f32::NAN, 0.0, false),
            (0.0, f32::NAN, false),
        ] {
            assert_eq!(
                starts(&|w| w.moves(axle, v, omega)),
                rests,
                "{axle} {v} {omega}"
            );
        }
    }
    for verdict in [
        Verdict::Absent,
        Verdict::Used,
        Verdict::Invalid,
        Verdict::Gated,
    ] {
        let expected = verdict != Verdict::Gated;
        assert_eq!(
            starts(&|w| w.fused().beam.verdict = verdict),
            expected,
            "{verdict:?}"
        );
    }
    assert!(!starts(&|w| w.fused = None));
}

/// A task that moves the robot becomes a stop when its host is lost; other tasks stay.
#[test]
fn a_lost_commander_stops_tasks_that_move_the_robot() {
    let goto = Task::regulate(Posture::ORIGIN);
    for (task, over, lost) in [
        (goto, false, true),
        (goto, true, false),
        (Task::follow(), false, true),
        (Task::track(), false, true),
        (Task::Idle, false, false),
        (Task::Stop, false, false),
        (Task::Clear, false, false),
    ] {
        let mut watched = in_state(OperatingState::Active);
        watched.node.command(task);
        watched.node.state.done = over;
        watched.node.on_host_lost();
        let state = &watched.node.state;
        assert_eq!(state.lost, lost, "{task:?} {over}");
        assert_eq!(state.task, if lost { Task::Stop } else { task });
    }
}
