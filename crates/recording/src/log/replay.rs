//! Replay of a recorded run: the nodes of each board receive the recorded inputs again.
//!
//! [`Comparison`] runs each board alone on its recorded inputs and finds the first difference.
//!
//! [`replay_estimates`] runs the boards with other parameters. The boards then send other frames, so each recorded
//! frame is replaced by the replayed frame of its sender and tick. A lost frame stays lost, and a frame that was
//! never sent does not arrive. The motion is the recorded motion: the robot does not drive by the new estimates.

use super::read::{Event, Events, RecordedTick, Run};
use crate::entry::{Exact, Pose, TruthEntry, epoch_of};
use core_algos::bus::{self, CanFrame};
use core_algos::fusion::ekf::Verdict;
use core_algos::fusion::robot;
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Role, Side, Topology, Wheels};
use host_sim::base::error::Error;
use host_sim::base::statistics::nees;
use host_sim::base::statistics::square;
use host_sim::run::bit_compare::{lead_difference, show_frame};
use host_sim::targets::{Fault, InProcess, Outgoing, Target};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// First difference between a replay and the record.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Divergence {
    /// Tick of the difference, ms.
    pub tick: u32,
    /// Name of the board.
    pub board: &'static str,
    /// Name of the differing signal.
    pub signal: String,
    /// Recorded value of the signal.
    pub recorded: String,
    /// Replayed value of the signal.
    pub replayed: String,
}

impl std::fmt::Display for Divergence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            tick,
            board,
            signal,
            recorded,
            replayed,
        } = self;
        write!(
            f,
            "tick {tick}, {board} board: {signal} was {recorded}, replayed {replayed}"
        )
    }
}

/// Board in this process that replays recorded inputs.
struct ReplayedBoard {
    robot: Topology,
    name: &'static str,
    target: InProcess,
    on: bool,
    /// Latest output of the lead node; `None` before the first output.
    lead: Option<lead::Output>,
}

/// Torques and frames of a replayed board at a tick.
struct TickResult {
    torque_nm: Wheels<f32>,
    sent: Vec<CanFrame>,
}

impl ReplayedBoard {
    fn new(robot: Topology, role: Role) -> Self {
        Self {
            robot,
            name: robot.name(role),
            target: InProcess::new(robot, role),
            on: false,
            lead: None,
        }
    }

    fn failed(&self, tick: u32, fault: Fault) -> Error {
        let why = match fault {
            Fault::Fatal(error) => error.to_string(),
            Fault::Silent(why) => why,
            Fault::Restarted => "restarted".to_owned(),
        };
        Error::input(format!("tick {tick}, {} board: {why}", self.name))
    }

    /// Applies any event except a tick to the board; `change` maps the recorded parameters of a start.
    fn event(
        &mut self,
        event: &Event,
        change: &dyn Fn(&RobotConfig) -> RobotConfig,
    ) -> Result<(), Error> {
        let (tick, result) = match event {
            Event::Start {
                tick,
                config,
                place,
            } => {
                self.on = true;
                let config = change(config);
                (*tick, self.target.start(&config, *tick, place.as_deref()))
            }
            Event::Off(..) => {
                self.on = false;
                self.target.switch_off()?;
                return Ok(());
            }
            Event::Command(tick, command) => (*tick, self.target.command(command)),
            Event::Tick(_) => return Ok(()),
        };
        result.map_err(|fault| self.failed(tick, fault))
    }

    /// Replays a tick. The frames `received` arrive before the tick.
    fn step(&mut self, step: &RecordedTick, received: &[CanFrame]) -> Result<TickResult, Error> {
        let failed = |replayed_board: &Self, fault| replayed_board.failed(step.tick, fault);
        let now = Micros::from(step.tick) * TICK;
        for frame in received {
            // The board ignored frames that do not decode.
            if let Ok(message) = bus::decode(frame) {
                self.target.receive(now, frame, &message);
            }
        }
        let begun = self.target.begin(step.tick, &step.samples);
        begun.map_err(|fault| failed(self, fault))?;
        let mut sent = Vec::new();
        let output = self.target.finish(&mut |outgoing| {
            if let Outgoing::Message(message) = outgoing
                && let Ok(frame) = bus::encode(message)
            {
                sent.push(frame);
            }
        });
        let output = output.map_err(|fault| failed(self, fault))?;
        self.lead = output.lead.or(self.lead);
        Ok(TickResult {
            torque_nm: output.torque_nm,
            sent,
        })
    }

    /// First difference between the recorded and the replayed tick; `None` without a difference.
    fn divergence(&self, step: &RecordedTick, done: &TickResult) -> Option<Divergence> {
        let part = |signal: String, recorded: String, replayed: String| {
            Some(Divergence {
                tick: step.tick,
                board: self.name,
                signal,
                recorded,
                replayed,
            })
        };
        let count = step.sent.len().max(done.sent.len());
        if let Some(i) = (0..count).find(|&i| step.sent.get(i) != done.sent.get(i)) {
            let show = |frame: Option<&CanFrame>| match frame {
                Some(frame) => show_frame(self.robot, frame),
                None => "absent".to_owned(),
            };
            return part(
                "frame on the bus".to_owned(),
                show(step.sent.get(i)),
                show(done.sent.get(i)),
            );
        }
        for (side, name) in [(Side::Left, "left"), (Side::Right, "right")] {
            let (recorded, replayed) = (step.torque_nm[side], Exact(done.torque_nm[side]));
            if recorded != replayed {
                return part(
                    format!("{name} wheel torque"),
                    format!("{:e} N m", recorded.0),
                    format!("{:e} N m", replayed.0),
                );
            }
        }
        let recorded = step.lead.as_deref()?;
        let replayed = self.lead.unwrap_or_default();
        let (path, recorded, replayed) = lead_difference(recorded, &replayed)?;
        part(format!("lead node{path}"), recorded, replayed)
    }
}

/// Replayed board, with time (ms) of the first fault or of the first difference from the record.
struct ComparedBoard {
    replayed_board: ReplayedBoard,
    found: Option<(u32, Result<Divergence, Error>)>,
}

impl ComparedBoard {
    fn take(&mut self, event: &Event) -> Result<Option<Divergence>, Error> {
        let replayed_board = &mut self.replayed_board;
        replayed_board.event(event, &|config| *config)?;
        let Event::Tick(step) = event else {
            return Ok(None);
        };
        if !replayed_board.on {
            return Err(Error::input(format!(
                "tick {}: no start of the {} board is recorded before this tick",
                step.tick, replayed_board.name
            )));
        }
        let done = replayed_board.step(step, &step.received)?;
        Ok(replayed_board.divergence(step, &done))
    }
}

/// Comparison of this program's nodes with a recording, event by event.
pub struct Comparison {
    robot: Topology,
    boards: Vec<ComparedBoard>,
}

impl Comparison {
    /// Comparison without events.
    pub fn new(robot: Topology) -> Self {
        let board = |role| ComparedBoard {
            replayed_board: ReplayedBoard::new(robot, role),
            found: None,
        };
        Self {
            robot,
            boards: robot.boards().map(board).collect(),
        }
    }

    /// Takes the next event of a board; ignores events after the board's first fault or difference.
    pub fn take(&mut self, role: Role, event: &Event) {
        let board = &mut self.boards[self.robot.place(role)];
        if board.found.is_none() {
            let found = board.take(event).transpose();
            board.found = found.map(|found| (event.tick(), found));
        }
    }

    /// Earliest difference of all boards; `None` without a difference. An error if the replay of a board failed before
    /// the earliest difference.
    pub fn first(self) -> Result<Option<Divergence>, Error> {
        let mut first: Option<Divergence> = None;
        for (tick, found) in self.boards.into_iter().filter_map(|board| board.found) {
            if first.as_ref().is_some_and(|first| first.tick < tick) {
                continue;
            }
            let found = found?;
            if first.as_ref().is_none_or(|first| found.tick < first.tick) {
                first = Some(found);
            }
        }
        Ok(first)
    }
}

/// Estimates of the lead node by time of validity, ms.
pub type Estimates = BTreeMap<u32, robot::Output>;

/// Recorded estimates of the lead node, until the common time of the boards jumps back.
#[derive(Default)]
pub struct RecordedEstimates {
    /// Estimates by time of validity, ms.
    pub estimates: Estimates,
    last: u32,
    over: bool,
}

impl RecordedEstimates {
    /// Takes the next event of a board; stores the estimates of the front board.
    pub fn take(&mut self, role: Role, event: &Event) {
        if role != Role::LEAD {
            return;
        }
        self.over |= event.tick() < self.last;
        self.last = event.tick();
        if let Event::Tick(step) = event
            && let Some(output) = step.lead.as_ref().filter(|_| !self.over)
        {
            self.estimates.insert(epoch_of(step.tick), output.fused);
        }
    }
}

/// Estimates of the lead node if the boards run with other parameters (`change`).
pub fn replay_estimates(
    robot: Topology,
    boards: &Events,
    change: &dyn Fn(&RobotConfig) -> RobotConfig,
) -> Result<Estimates, Error> {
    let replayed = robot.boards().map(|role| ReplayedBoard::new(robot, role));
    let mut replayed: Vec<_> = replayed.collect();
    let mut rest: Vec<_> = boards
        .iter()
        .map(|events| events.iter().peekable())
        .collect();
    // `recorded`: tick at which each recorded frame was last sent. `now`: replayed frame by identifier and tick.
    let mut recorded: HashMap<(u16, u8, [u8; 8]), u32> = HashMap::new();
    let mut now: HashMap<(u16, u32), CanFrame> = HashMap::new();
    let key = |frame: &CanFrame| (frame.id, frame.length, frame.data);
    let mut estimates = Estimates::new();
    while let Some(tick) = rest
        .iter_mut()
        .filter_map(|rest| rest.peek().map(|event| event.tick()))
        .min()
    {
        // Frames are exchanged after all boards have run the tick, because a frame arrives at a later tick.
        let (mut sent, mut sent_now) = (Vec::new(), Vec::new());
        for (replayed_board, rest) in replayed.iter_mut().zip(&mut rest) {
            while let Some(event) = rest.next_if(|event| event.tick() <= tick) {
                let result = replayed_board.event(event, change);
                // With other estimates the robot is at another point of its path, so further path points may find no
                // room. That affects steering, not estimation.
                if !matches!(event, Event::Command(..)) {
                    result?;
                }
                let Event::Tick(step) = event else {
                    continue;
                };
                let received: Vec<CanFrame> = step
                    .received
                    .iter()
                    .filter_map(|frame| match recorded.get(&key(frame)) {
                        Some(at) => now.get(&(frame.id, *at)).copied(),
                        None => Some(*frame),
                    })
                    .collect();
                let done = replayed_board.step(step, &received)?;
                sent.extend(step.sent.iter().map(|frame| (key(frame), tick)));
                let replayed = done.sent.into_iter();
                sent_now.extend(replayed.map(|frame| ((frame.id, tick), frame)));
                if step.lead.is_some()
                    && let Some(lead) = replayed_board.lead
                {
                    estimates.insert(epoch_of(tick), lead.fused);
                }
            }
        }
        recorded.extend(sent);
        now.extend(sent_now);
    }
    Ok(estimates)
}

/// Errors and consistency of the estimates of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quality {
    /// Root mean square of the midpoint's position error, m; `None` without the true state.
    pub position_rms_m: Option<f64>,
    /// Largest position error, m; `None` without the true state.
    pub position_max_m: Option<f64>,
    /// Root mean square of the heading error, rad; `None` without the true state.
    pub heading_rms_rad: Option<f64>,
    /// Position error at the end, m; `None` without the true state.
    pub final_position_m: Option<f64>,
    /// Heading error at the end, rad; `None` without the true state.
    pub final_heading_rad: Option<f64>,
    /// Root mean square of the position error of the front axle in the rear axle's frame, m; `None` without the true
    /// state.
    pub relative_rms_m: Option<f64>,
    /// Mean normalised estimation error squared (NEES) of the midpoint; 3 if its covariance is right. `None` without
    /// the true state.
    pub mean_nees: Option<f64>,
    /// Mean normalised innovation squared (NIS) of the beam; 0.1 to 0.5 is expected.
    pub mean_nis: f64,
    /// Fraction of innovations that the gate rejected.
    pub refused: f64,
    /// Number of estimates.
    pub count: usize,
}

impl Quality {
    /// Errors of estimates relative to the true states at the same times.
    pub fn of(estimates: &Estimates, run: &Run) -> Self {
        let zero_us = run.zero_us.unwrap_or_default();
        let mut errors = Errors::default();
        let (mut nis, mut used, mut refused) = (0.0, 0u32, 0u32);
        for (time, fused) in estimates {
            let beam = &fused.beam;
            match beam.verdict {
                Verdict::Used => {
                    nis += f64::from(beam.nis);
                    used += 1;
                }
                Verdict::Gated => {
                    nis += f64::from(beam.nis);
                    used += 1;
                    refused += 1;
                }
                _ => {}
            }
            if let Some(truth) = true_state(&run.truth, 1000 * i64::from(*time) - zero_us) {
                errors.add(fused, truth);
            }
        }
        let share = |sum: f64, count: u32| sum / f64::from(count.max(1));
        Self {
            mean_nis: share(nis, used),
            refused: share(refused.into(), used),
            count: estimates.len(),
            ..errors.quality()
        }
    }
}

/// True postures at a time of the run, µs, interpolated between entries: midpoint in the global frame, front axle in
/// the rear axle's frame. `None` outside the recorded time.
fn true_state(truth: &BTreeMap<u32, TruthEntry>, at_us: i64) -> Option<(Pose, Pose)> {
    let at = u32::try_from(at_us.div_euclid(1000)).ok()?;
    let (before, first) = truth.range(..=at).next_back()?;
    let since = at_us as f64 * 1e-3 - f64::from(*before);
    if since == 0.0 {
        return Some((first.robot, first.relative));
    }
    let (after, second) = truth.range(at + 1..).next()?;
    let share = since / f64::from(after - before);
    let between = |a: Pose, b: Pose| {
        let turn = std::f64::consts::TAU;
        let angle = b.phi_rad - a.phi_rad;
        Pose {
            x_m: a.x_m + share * (b.x_m - a.x_m),
            y_m: a.y_m + share * (b.y_m - a.y_m),
            phi_rad: a.phi_rad + share * (angle - turn * (angle / turn).round()),
        }
    };
    let robot = between(first.robot, second.robot);
    Some((robot, between(first.relative, second.relative)))
}

/// Sums and maxima of errors, from which [`Quality`] is computed.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    position: f64,
    position_max: f64,
    heading: f64,
    relative: f64,
    nees: f64,
    last: [f64; 2],
    count: u32,
}

impl Errors {
    fn add(&mut self, fused: &robot::Output, (robot, apart): (Pose, Pose)) {
        let estimated = Pose::from(fused.robot.posture);
        let distance = libm::hypot(estimated.x_m - robot.x_m, estimated.y_m - robot.y_m);
        let turn = std::f64::consts::TAU;
        let heading = estimated.phi_rad - robot.phi_rad;
        let heading = heading - turn * (heading / turn).round();
        let relative = Pose::from(fused.front.posture.relative_to(fused.rear.posture));
        let apart = [relative.x_m - apart.x_m, relative.y_m - apart.y_m];
        self.position += square(distance);
        self.position_max = self.position_max.max(distance);
        self.heading += square(heading);
        self.relative += square(apart[0]) + square(apart[1]);
        self.nees += nees(&fused.robot, robot.into());
        self.last = [distance, heading];
        self.count += 1;
    }

    fn quality(&self) -> Quality {
        if self.count == 0 {
            return Quality::default();
        }
        let count = f64::from(self.count);
        let rms = |sum: f64| Some((sum / count).sqrt());
        Quality {
            position_rms_m: rms(self.position),
            position_max_m: Some(self.position_max),
            heading_rms_rad: rms(self.heading),
            final_position_m: Some(self.last[0]),
            final_heading_rad: Some(self.last[1]),
            relative_rms_m: rms(self.relative),
            mean_nees: Some(self.nees / count),
            ..Quality::default()
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::read;
    use super::*;
    use crate::{About, Destinations, Session};
    use core_algos::math::Posture;
    use core_algos::node::lead::Task;
    use host_sim::run::end::RunEnd;
    use host_sim::run::robot::Robot;
    use host_sim::run::simulation::Simulation;
    use host_sim::scenario::Scenario;
    use host_sim::targets;
    use host_sim::targets::HostCommand;
    use host_sim::targets::{Failure, FailureMode};
    use std::fs;

    fn scenario(axles: u32) -> Scenario {
        let mut scenario = Scenario::default();
        scenario.robot.geometry.axles = axles;
        scenario.world.sensors.gyro.fitted = true;
        scenario.world.sensors.accelerometer.fitted = true;
        scenario.world.bus.loss = 0.02;
        scenario
    }

    /// Log of `ticks` ticks, as bytes; the robot drives from 0.2 s on.
    pub(in crate::log) fn recorded(ticks: u32, prepare: impl FnOnce(&mut Simulation)) -> Vec<u8> {
        recorded_of(2, ticks, prepare)
    }

    /// As [`recorded`], of a robot with this number of axles.
    fn recorded_of(axles: u32, ticks: u32, prepare: impl FnOnce(&mut Simulation)) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let scenario = scenario(axles);
        let about = About {
            command: "test",
            build: "test",
            seed: 5,
            trial: 0,
            scenario: &scenario,
        };
        let args = Destinations {
            log: Some(path.clone()),
            ..Destinations::default()
        };
        let session = Session::begin(&args, &about).unwrap().unwrap();
        let targets = session.tap(targets::in_process(scenario.robot.topology()), &scenario);
        let mut simulation = Simulation::on(targets, &scenario, 5, 0).unwrap();
        simulation.observe(Box::new(session.clone()));
        prepare(&mut simulation);
        let goal = Posture::ORIGIN;
        for tick in 0..ticks {
            // The robot rests until the boards have received each other's messages.
            if tick == 200 {
                let task = Task::regulate(goal);
                simulation.command(&HostCommand::Task(task)).unwrap();
            }
            simulation.step().unwrap();
        }
        assert!(!path.exists(), "not before it is whole");
        session.close(&RunEnd::default()).unwrap();
        fs::read(path).unwrap()
    }

    /// First difference between this program's nodes and a recording.
    pub(in crate::log) fn compare(boards: &Events) -> Result<Option<Divergence>, Error> {
        // A robot has one board fewer than twice its axles.
        let robot = Topology::new(boards.len().div_ceil(2)).unwrap();
        let mut comparison = Comparison::new(robot);
        for (role, events) in robot.boards().zip(boards) {
            events.iter().for_each(|event| comparison.take(role, event));
        }
        comparison.first()
    }

    fn step(recording: &mut read::Recording, role: Role, tick: u32) -> &mut RecordedTick {
        let place = recording.robot.place(role);
        let events = recording.boards[place].iter_mut();
        let mut steps = events.filter_map(|event| match event {
            Event::Tick(step) => Some(step),
            _ => None,
        });
        steps.find(|step| step.tick == tick).unwrap()
    }

    #[test]
    fn a_recording_replays_bit_for_bit_and_one_bit_is_found() {
        let recording = read::read(&recorded(1500, |_| ()), "log").unwrap();
        assert_eq!(recording.ticks(), 1500);
        assert_eq!(compare(&recording.boards).unwrap(), None);

        let mut other = recording.clone();
        let torque = &mut step(&mut other, Role::axle(1), 1400).torque_nm.right;
        assert!(torque.0 != 0.0, "under way");
        *torque = Exact(f32::from_bits(torque.0.to_bits() ^ 1));
        let found = compare(&other.boards).unwrap().unwrap();
        assert_eq!((found.tick, found.board), (1400, "rear"));
        assert_eq!(found.signal, "right wheel torque");

        // One additional encoder count changes the axle's output at once.
        let mut other = recording.clone();
        if let core_algos::node::board::Samples::Axle(samples) =
            &mut step(&mut other, Role::LEAD, 1300).samples
        {
            samples.encoder.left = samples.encoder.left.map(|count| count + 1);
        }
        let found = compare(&other.boards).unwrap().unwrap();
        assert_eq!((found.tick, found.board), (1300, "front"));

        let mut other = recording.clone();
        let sent = &mut step(&mut other, Role::beam(0), 1200).sent;
        sent[1].data[0] ^= 1;
        let found = compare(&other.boards).unwrap().unwrap();
        assert_eq!((found.tick, found.board), (1200, "beam"));
        assert_eq!(found.signal, "frame on the bus");

        let mut other = recording;
        let lead = step(&mut other, Role::LEAD, 1203).lead.as_mut().unwrap();
        lead.fused.robot.covariance[2][0] += 1e-9;
        let found = compare(&other.boards).unwrap().unwrap();
        assert_eq!(found.tick, 1203);
        assert_eq!(found.signal, "lead node.fused.robot.covariance[2][0]");
    }

    #[test]
    fn recording_of_three_axles_replays_bit_for_bit_with_every_axle_in_its_topics() {
        let bytes = recorded_of(3, 1000, |_| ());
        let recording = read::read(&bytes, "log").unwrap();
        assert_eq!(recording.robot, Topology::new(3).unwrap());
        assert_eq!(recording.run.about["format"], "4");
        for (role, events) in recording.robot.boards().zip(&recording.boards) {
            let ticks = events
                .iter()
                .filter(|event| matches!(event, Event::Tick(_)));
            assert_eq!(ticks.count(), 1000, "{role:?}");
        }
        assert_eq!(compare(&recording.boards).unwrap(), None);
        let mut topics = std::collections::BTreeMap::<String, usize>::new();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            *topics
                .entry(message.unwrap().channel.topic.clone())
                .or_default() += 1;
        }
        for topic in [
            "/truth/front",
            "/truth/axle-2",
            "/truth/rear",
            "/truth/beam-1",
            "/truth/beam-2",
        ] {
            assert_eq!(topics.get(topic), Some(&100), "{topic}: {topics:?}");
        }
        assert!(topics["/estimate/axle-2"] > 90, "{topics:?}");
        // First and last axle of the straight robot are two frames apart.
        let apart = recording.run.truth.values().next().unwrap().relative.x_m;
        assert!((apart - 2.0 * 0.37).abs() < 1e-3, "{apart}");
    }

    #[test]
    fn recording_with_failing_and_restarting_boards_replays_exactly() {
        let bytes = recorded(1500, |simulation| {
            let failure = |role, at| Failure {
                role,
                at,
                mode: FailureMode::Off,
            };
            let failures = vec![failure(Role::beam(0), 700), failure(Role::axle(1), 1000)];
            simulation.boards().plan(failures, Some(100));
        });
        let recording = read::read(&bytes, "log").unwrap();
        let starts = |role: Role| {
            let events = recording.boards[recording.robot.place(role)].iter();
            events.filter(|event| event.config().is_some()).count()
        };
        assert_eq!(Role::PAIR.map(starts), [1, 2, 2]);
        assert_eq!(compare(&recording.boards).unwrap(), None);
    }

    #[test]
    fn replay_with_equal_parameters_gives_equal_estimates_and_others_differ() {
        let recording = read::read(&recorded(11_000, |_| ()), "log").unwrap();
        let mut recorded = RecordedEstimates::default();
        for event in &recording.boards[recording.robot.place(Role::LEAD)] {
            recorded.take(Role::LEAD, event);
        }
        let estimates = recorded.estimates;
        assert_eq!(estimates.len(), 1100);
        let same = replay_estimates(recording.robot, &recording.boards, &|config| *config).unwrap();
        assert!(
            same == estimates,
            "frames were lost alike, and none came otherwise"
        );

        // A wheel radius configured 1 % too large makes the estimated path about 1 % longer.
        let larger = |config: &RobotConfig| {
            let mut config = *config;
            config.geometry.wheel_radius_m *= 1.01;
            config
        };
        let wrong = replay_estimates(recording.robot, &recording.boards, &larger).unwrap();
        let path_length = |estimates: &Estimates| {
            let at = |time| estimates[&time].robot.posture;
            let (start, end) = (at(200), at(7990));
            f64::from(end.x - start.x).hypot(f64::from(end.y - start.y))
        };
        assert!(path_length(&estimates) > 1.0, "{}", path_length(&estimates));
        let ratio = path_length(&wrong) / path_length(&estimates);
        // The beam corrects a part of the error.
        assert!((1.003..1.012).contains(&ratio), "{ratio}");
        let good = Quality::of(&estimates, &recording.run);
        let bad = Quality::of(&wrong, &recording.run);
        assert!(bad.position_rms_m > good.position_rms_m);
        assert_eq!(Quality::of(&estimates, &Run::default()).mean_nees, None);
    }

    #[test]
    fn truncated_damaged_or_foreign_file_is_refused_as_bad_input() {
        let bytes = recorded(60, |_| ());
        assert!(read::read(&bytes, "log").is_ok());
        let refused = |bytes: &[u8]| {
            let error = read::read(bytes, "some.mcap").unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
            assert!(error.to_string().starts_with("some.mcap: "), "{error}");
            error.to_string()
        };
        for end in (0..bytes.len()).step_by(bytes.len() / 200) {
            refused(&bytes[..end]);
        }
        for place in (0..bytes.len()).step_by(bytes.len() / 200) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x10;
            refused(&damaged);
        }
        assert!(refused(b"time_s,x_m\n0.0,1.0\n").contains("another type of file"));
        let mut empty = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
        empty.finish().unwrap();
        let foreign = empty.into_inner().into_inner();
        assert!(refused(&foreign).contains("not a log of cfmmr"));
    }
}
