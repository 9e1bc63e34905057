//! MCAP file of a run, with a channel for each topic.

use super::sink::Sink;
use super::standard;
use crate::dbc;
use crate::entry::{
    ABOUT, AxleTruth, BusEntry, Can, Decoded, END, FrameTruth, Hex, LeadEntry, LoggedFrame, Pose,
    TruthEntry, format_of, inner_names,
};
use crate::topics::{Topic, estimate_of, of_board, topics, truth_of};
use crate::{About, Line, failed};
use core_algos::bus::{self, CanFrame};
use core_algos::link::framing::crc32c;
use core_algos::math::Posture;
use core_algos::node::lead::MAX_INNER;
use core_algos::safety::{Class, OperatingState};
use core_algos::topology::{AxleId, Role, Topology};
use foxglove::messages::{
    FrameTransforms, Log, PoseInFrame, PosesInFrame, SceneUpdate, log::Level,
};
use foxglove::{Channel, ChannelBuilder, Encode, PartialMetadata, RawChannel};
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::name_of;
use host_sim::run::end::{EndKind, RunEnd};
use host_sim::run::recovery::Status;
use host_sim::run::robot::Record;
use host_sim::targets::TargetReport;
use host_sim::world::body::Body;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Number of epochs between two messages of the scene.
const SCENE_EPOCHS: u64 = 5;
/// Epochs between two points of the path driven so far, and between two messages of that path.
const TRUE_PATH_EPOCHS: [u64; 2] = [10, 100];
/// Approximate limit of points in a message of the driven path; a longer path is thinned.
const TRUE_PATH_POINTS: usize = 300;

/// Approximate limit of points in a message of the reference path.
const REFERENCE_POINTS: usize = 2_000;

/// Log time of a message from simulated time, ns.
fn at(nanos: u64) -> PartialMetadata {
    PartialMetadata::with_log_time(nanos)
}

fn nanos(tick: u32) -> u64 {
    u64::from(tick) * 1_000_000
}

/// Channel of a log for one topic with messages in JSON.
struct Json {
    channel: Arc<RawChannel>,
    /// True if the log goes to a file, which takes all messages; viewers take only subscribed topics.
    filed: bool,
}

impl Json {
    fn new(sink: &Sink, topics: &[Topic], topic: &str) -> Result<Self, Error> {
        let known = topics.iter().find(|known| known.name == topic);
        let schema = known.map(|known| &known.schema);
        let schema = schema.ok_or_else(|| failed(format!("no topic {topic}")))?;
        ChannelBuilder::new(topic)
            .context(sink.context())
            .message_encoding("json")
            .schema(foxglove::Schema::new(
                schema.name,
                "jsonschema",
                schema.json().into_bytes(),
            ))
            .build_raw()
            .map(|channel| Self {
                channel,
                filed: sink.is_file(),
            })
            .map_err(failed)
    }

    /// Opens the channels of the topic `what` of each board.
    fn of_boards(
        sink: &Sink,
        topics: &[Topic],
        robot: Topology,
        what: &str,
    ) -> Result<Vec<Self>, Error> {
        let names = robot
            .boards()
            .map(|board| of_board(robot.name(board), what));
        names.map(|name| Self::new(sink, topics, &name)).collect()
    }

    /// Opens the channels of the true states of axles and frames of a robot with more than two axles.
    fn truths(sink: &Sink, topics: &[Topic], robot: Topology) -> Result<Vec<Self>, Error> {
        let boards = robot.boards().filter(|_| robot.axle_count() > 2);
        let names = boards.map(|board| truth_of(robot.name(board)));
        names.map(|name| Self::new(sink, topics, &name)).collect()
    }

    fn write(&self, buffer: &mut Vec<u8>, nanos: u64, entry: &impl Serialize) {
        if !self.filed && !self.channel.has_sinks() {
            return;
        }
        buffer.clear();
        // No entry's `Serialize` fails, and writing to memory does not fail.
        if serde_json::to_writer(&mut *buffer, entry).is_ok() {
            self.channel.log_with_meta(buffer, at(nanos));
        }
    }
}

/// Opens a channel for messages with a schema of Foxglove.
fn standard_channel<T: Encode>(sink: &Sink, topic: &str) -> Channel<T> {
    ChannelBuilder::new(topic).context(sink.context()).build()
}

/// Name of an axle's coordinate frame.
fn transform_of(robot: Topology, axle: AxleId) -> &'static str {
    match axle.0 {
        0 => "front_axle",
        number if usize::from(number) + 1 == robot.axle_count() => "rear_axle",
        1 => "axle_2",
        2 => "axle_3",
        _ => "axle_4",
    }
}

/// Log of a run, to a file or to live viewers.
pub struct Mcap {
    sink: Sink,
    robot: Topology,
    about: Vec<(String, String)>,
    /// Target and build of each board.
    boards: Vec<String>,
    body: Body,
    transforms: Channel<FrameTransforms>,
    truth_robot: Channel<PoseInFrame>,
    estimate_robot: Channel<PoseInFrame>,
    true_path: Channel<PosesInFrame>,
    goal: Channel<PoseInFrame>,
    reference: Channel<PosesInFrame>,
    scene: Channel<SceneUpdate>,
    log: Channel<Log>,
    lead: Json,
    truth: Json,
    /// True states of the boards' axles and frames; empty for two axles.
    truths: Vec<Json>,
    /// Estimates of the axles between the first and the last.
    inner: Vec<Channel<PoseInFrame>>,
    bus: Json,
    order: Json,
    start: Vec<Json>,
    ticks: Vec<Json>,
    off: Vec<Json>,
    buffer: Vec<u8>,
    /// Common time of the boards at the start of the run, µs.
    zero: i64,
    /// Latest heartbeat of each node.
    statuses: Vec<Option<Status>>,
    /// Latest estimate and its time of validity, ns.
    estimate: Option<(u64, Posture)>,
    /// Latest estimates of the axles between the first and the last.
    inner_estimates: [Option<Posture>; MAX_INNER],
    true_path_so_far: Vec<Pose>,
    epochs: u64,
    end: RunEnd,
    whole: bool,
    /// Goal of the run, sent to viewers that connect later; below, reference path.
    planned_goal: Option<PoseInFrame>,
    planned_path: Option<PosesInFrame>,
}

impl Mcap {
    /// Creates a file with the metadata of the run.
    pub fn new(sink: Sink, about: &About) -> Result<Self, Error> {
        let scenario = about.scenario.to_toml()?;
        let robot = about.scenario.robot.topology();
        let topics = topics(robot);
        let sum = |text: &str| format!("{:08x}", crc32c(text.as_bytes()));
        let described = [
            ("format", format_of(robot).to_owned()),
            ("build", about.build.to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("command", about.command.to_owned()),
            ("seed", about.seed.to_string()),
            ("trial", about.trial.to_string()),
            ("world", about.scenario.world.label()),
            ("scenario_hash", sum(&scenario)),
            ("scenario", scenario),
            ("messages_hash", sum(&dbc::description(robot))),
        ];
        // The metadata are also at the start, so that a truncated log can be replayed.
        sink.metadata(ABOUT, &described);
        Ok(Self {
            robot,
            about: described.map(|(key, value)| (key.to_owned(), value)).into(),
            boards: vec![String::new(); robot.board_count()],
            body: Body::of(&about.scenario.world.plant),
            transforms: standard_channel(&sink, "/tf"),
            truth_robot: standard_channel(&sink, "/truth/robot"),
            estimate_robot: standard_channel(&sink, "/estimate/robot"),
            true_path: standard_channel(&sink, "/truth/path"),
            goal: standard_channel(&sink, "/goal"),
            reference: standard_channel(&sink, "/reference/path"),
            scene: standard_channel(&sink, "/scene"),
            log: standard_channel(&sink, "/log"),
            lead: Json::new(&sink, &topics, "/lead")?,
            truth: Json::new(&sink, &topics, "/truth")?,
            truths: Json::truths(&sink, &topics, robot)?,
            inner: inner_names(robot)
                .map(|name| standard_channel(&sink, &estimate_of(name)))
                .collect(),
            bus: Json::new(&sink, &topics, "/bus")?,
            order: Json::new(&sink, &topics, "/host/order")?,
            start: Json::of_boards(&sink, &topics, robot, "start")?,
            ticks: Json::of_boards(&sink, &topics, robot, "tick")?,
            off: Json::of_boards(&sink, &topics, robot, "off")?,
            buffer: Vec::with_capacity(1024),
            zero: 0,
            statuses: vec![None; robot.node_count()],
            estimate: None,
            inner_estimates: [None; MAX_INNER],
            true_path_so_far: Vec::new(),
            epochs: 0,
            end: RunEnd {
                kind: EndKind::Interrupted,
                ..RunEnd::default()
            },
            whole: false,
            planned_goal: None,
            planned_path: None,
            sink,
        })
    }

    /// Writes goal and path of the run.
    pub fn plan(&mut self, goal: [f64; 3], path: &[[f64; 3]]) {
        let goal = standard::in_world(0, &goal.into());
        self.goal.log_with_meta(&goal, at(0));
        self.planned_goal = Some(goal);
        if !path.is_empty() {
            let stride = path.len().div_ceil(REFERENCE_POINTS);
            let points = path.iter().step_by(stride).copied();
            let poses: Vec<Pose> = points.map(Pose::from).collect();
            let path = standard::path(0, &poses);
            self.reference.log_with_meta(&path, at(0));
            self.planned_path = Some(path);
        }
    }

    /// Waits for a viewer if the run is served; an error if `interrupt` is set meanwhile.
    pub fn await_viewer(&self, interrupt: &AtomicBool) -> Result<(), Error> {
        match self.sink.server() {
            Some(server) => server.await_viewer(interrupt),
            None => Ok(()),
        }
    }

    /// Sends viewers the time, and new viewers the goal and the reference path.
    fn serve(&self, time: u64) {
        let Some(server) = self.sink.server() else {
            return;
        };
        server.time(time);
        for (channel, viewer) in server.joined() {
            let (goal, reference) = (&self.planned_goal, &self.planned_path);
            if let Some(goal) = goal.as_ref().filter(|_| channel == self.goal.id()) {
                self.goal
                    .log_with_meta_to_sink(goal, at(time), Some(viewer));
            }
            if let Some(path) = reference
                .as_ref()
                .filter(|_| channel == self.reference.id())
            {
                self.reference
                    .log_with_meta_to_sink(path, at(time), Some(viewer));
            }
        }
    }

    /// Time of the run at a tick of the boards, ns; zero for ticks before the start.
    fn nanos(&self, tick: u32) -> u64 {
        let micros = i64::from(tick) * 1000 - self.zero;
        u64::try_from(micros).unwrap_or_default() * 1000
    }

    /// Writes an event of the recording.
    pub fn note(&mut self, line: &Line) {
        let at = |tick: u32| self.nanos(tick);
        match line {
            Line::Zero(zero) => self.zero = *zero,
            Line::Axle(role, entry) => {
                let time = at(entry.tick);
                self.ticks[self.robot.place(*role)].write(&mut self.buffer, time, entry);
            }
            Line::Beam(role, entry) => {
                let time = at(entry.tick);
                self.ticks[self.robot.place(*role)].write(&mut self.buffer, time, entry);
            }
            Line::Lead(tick, output) => {
                let epoch = crate::entry::epoch_of(*tick);
                let (time, held) = (at(*tick), at(epoch));
                let epoch_s = f64::from(epoch) * 1e-3 - self.zero as f64 * 1e-6;
                let mut entry = LeadEntry::new(*tick, epoch_s, output);
                entry.bits = Hex::of(&**output);
                self.lead.write(&mut self.buffer, time, &entry);
                self.estimate = Some((held, output.fused.robot.posture));
                self.inner_estimates = output.inner;
            }
            Line::Board(role, what) => self.boards[self.robot.place(*role)].clone_from(what),
            Line::Frames { role, tick, frames } => self.frames(*role, *tick, frames),
            Line::Command(entry) => {
                let time = at(entry.tick);
                self.order.write(&mut self.buffer, time, entry);
            }
            Line::Start(role, started) => {
                let (entry, report) = &**started;
                let time = at(entry.tick);
                self.start[self.robot.place(*role)].write(&mut self.buffer, time, entry);
                self.started(*role, &entry.parameters_hash, report.as_ref());
            }
            Line::Off(role, entry) => {
                let time = at(entry.tick);
                self.off[self.robot.place(*role)].write(&mut self.buffer, time, entry);
                let name = self.robot.name(*role);
                let text = format!("{name} board off: {}", entry.reason);
                self.write_message(entry.tick, Level::Error, name, text);
            }
        }
    }

    /// Records target and build of a started board; the lead board's parameter hash goes into the metadata.
    fn started(&mut self, role: Role, parameters: &str, report: Option<&TargetReport>) {
        let board = &mut self.boards[self.robot.place(role)];
        if let (true, Some(report)) = (board.is_empty(), report) {
            *board = format!("{}, {}", report.target, report.build);
        }
        if self.epochs == 0 && role == Role::LEAD {
            let hash = ("parameters_hash".to_owned(), parameters.to_owned());
            self.about.push(hash);
        }
    }

    fn frames(&mut self, role: Role, tick: u32, frames: &[CanFrame]) {
        let robot = self.robot;
        let messages: Vec<_> = frames.iter().map(|frame| bus::decode(frame).ok()).collect();
        let logged = frames
            .iter()
            .zip(&messages)
            .map(|(frame, message)| LoggedFrame {
                name: name_of(robot, frame.id).unwrap_or("unknown"),
                frame: Can(*frame),
                message: message.as_ref().map(|message| Decoded::new(robot, message)),
            });
        let entry = BusEntry {
            tick,
            board: robot.name(role).to_owned(),
            frames: logged.collect(),
        };
        let time = self.nanos(tick);
        self.bus.write(&mut self.buffer, time, &entry);
        let messages = messages.iter().flatten();
        for status in messages.filter_map(|message| Status::of(robot, tick, message)) {
            self.status(tick, status);
        }
    }

    /// Writes a text message about a heartbeat if state or reason of the node has changed.
    fn status(&mut self, tick: u32, status: Status) {
        let Some(place) = self.robot.place_of_node(status.node) else {
            return;
        };
        let last = self.statuses[place].replace(status);
        let same =
            last.is_some_and(|last| (last.state, last.reason) == (status.state, status.reason));
        if same {
            return;
        }
        let level = match (status.state, status.reason.map(|reason| reason.class())) {
            (OperatingState::Fault, _) | (_, Some(Class::Cut)) => Level::Error,
            (OperatingState::SafeStop, _) | (_, Some(_)) => Level::Warning,
            _ => Level::Info,
        };
        self.write_message(tick, level, status.name, status.to_string());
    }

    fn write_message(&self, tick: u32, level: Level, name: &str, message: String) {
        let time = self.nanos(tick);
        let log = Log {
            timestamp: Some(standard::stamp(time)),
            level: level as i32,
            message,
            name: name.to_owned(),
            ..Log::default()
        };
        self.log.log_with_meta(&log, at(time));
    }

    /// Writes the topics that contain the estimate and the true state, at the end of an epoch.
    pub fn write_epoch(&mut self, record: &Record) {
        let tick = (record.time_s * 1e3).round() as u32;
        let time = nanos(tick);
        self.serve(time);
        // The true state of a real robot is unknown.
        let known = record.midpoint[0].is_finite();
        let robot = Pose::from(record.midpoint);
        let mut frames = Vec::new();
        if known {
            let names = self
                .robot
                .axles()
                .map(|axle| transform_of(self.robot, axle));
            let axles = names.zip(&record.axles);
            frames.push(("robot", robot));
            frames.extend(axles.map(|(name, axle)| (name, axle.posture.into())));
        }
        if let Some((held, posture)) = self.estimate {
            let estimate = Pose::from(posture);
            let pose = standard::in_world(held, &estimate);
            self.estimate_robot.log_with_meta(&pose, at(time));
            frames.push(("robot_estimate", estimate));
            for (channel, axle) in self.inner.iter().zip(self.inner_estimates) {
                if let Some(axle) = axle {
                    let pose = standard::in_world(held, &axle.into());
                    channel.log_with_meta(&pose, at(time));
                }
            }
        }
        let transforms = standard::transforms(time, &frames);
        self.transforms.log_with_meta(&transforms, at(time));
        if known {
            self.write_truth(record, time);
        }
        self.epochs += 1;
    }

    /// Writes the topics that contain the true state of a simulated robot.
    fn write_truth(&mut self, record: &Record, time: u64) {
        let robot = Pose::from(record.midpoint);
        let pose = standard::in_world(time, &robot);
        self.truth_robot.log_with_meta(&pose, at(time));
        self.truth
            .write(&mut self.buffer, time, &TruthEntry::from(record));
        let (axles, frames) = self
            .truths
            .split_at(record.axles.len().min(self.truths.len()));
        for (channel, axle) in axles.iter().zip(&record.axles) {
            let entry = AxleTruth::new(record.time_s, axle);
            channel.write(&mut self.buffer, time, &entry);
        }
        for (channel, frame) in frames.iter().zip(&record.frames) {
            let entry = FrameTruth::new(record.time_s, frame);
            channel.write(&mut self.buffer, time, &entry);
        }
        if self.epochs.is_multiple_of(SCENE_EPOCHS) {
            let scene = standard::scene(time, record, &self.body);
            self.scene.log_with_meta(&scene, at(time));
        }
        if self.epochs.is_multiple_of(TRUE_PATH_EPOCHS[0]) {
            self.true_path_so_far.push(robot);
        }
        if self.epochs.is_multiple_of(TRUE_PATH_EPOCHS[1]) {
            let stride = self
                .true_path_so_far
                .len()
                .div_ceil(TRUE_PATH_POINTS)
                .max(1);
            let true_path = standard::path(time, self.true_path_so_far.iter().step_by(stride));
            self.true_path.log_with_meta(&true_path, at(time));
        }
    }

    /// Writes the metadata records about boards and end of the run.
    fn metadata(&mut self) {
        let mut with_boards = false;
        for (role, board) in self.robot.boards().zip(std::mem::take(&mut self.boards)) {
            if !board.is_empty() {
                let key = format!("board_{}", self.robot.name(role));
                self.about.push((key, board));
                with_boards = true;
            }
        }
        if with_boards {
            // Readers use the latest record of a name.
            self.sink.metadata(ABOUT, &self.about);
        }
        let mut end = self.end.fields();
        end.push(("whole".to_owned(), self.whole.to_string()));
        end.push(("epochs".to_owned(), self.epochs.to_string()));
        self.sink.metadata(END, &end);
    }

    /// Completes the log with the end of the run.
    pub fn close(&mut self, end: &RunEnd) -> Result<(), Error> {
        self.end = end.clone();
        self.whole = true;
        self.metadata();
        let closed = self.sink.close();
        self.about.clear();
        Ok(closed?)
    }

    /// Path of the file; `None` for a log without a file.
    pub fn path(&self) -> Option<PathBuf> {
        self.sink.path()
    }
}

impl Drop for Mcap {
    fn drop(&mut self) {
        if !self.about.is_empty() {
            self.metadata();
        }
    }
}
