//! Reading of a log: inputs and outputs of each board, in order.
//!
//! A truncated, damaged or foreign file is rejected as bad input, with the fault and its position. No file can make
//! the reader panic or take much more memory than the file.
//!
//! [`stream`] keeps one record of the file and [`MAX_OUTPUT_DELAY_MS`] of the front board's events in memory;
//! [`read`] keeps all events.

use super::intact;
use crate::entry::{
    ABOUT, AxleTick, BeamTick, BusEntry, Can, END, Exact, FORMATS, Hex, HostCommandEntry, LeadBits,
    Off, Start, TruthEntry,
};
use core_algos::bus::CanFrame;
use core_algos::control::train;
use core_algos::link::protocol::Placement;
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::node::{axle, beam, lead};
use core_algos::topology::{MAX_AXLES, Role, Topology, Wheels};
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::is_of_nodes;
use host_sim::targets::host_command::HostCommand;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader};
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{Cursor, Read, Seek};

/// Limit of the delay of the lead node's output after the front board's tick in a log, ms; a later output is an error.
pub const MAX_OUTPUT_DELAY_MS: u32 = 10_000;

/// Start, loss, command or tick of a board in a log.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The nodes of the board were started.
    Start {
        /// First tick of the nodes, ms.
        tick: u32,
        /// Parameters of the nodes.
        config: Box<RobotConfig>,
        /// Initial estimate of the lead node; `None` without an estimate.
        place: Option<Box<Placement>>,
    },
    /// The board was switched off or lost, or its record ended: tick (ms) and reason.
    Off(u32, String),
    /// The lead node received a command before this tick, ms.
    Command(u32, HostCommand),
    /// Inputs and outputs of the board at a tick.
    Tick(Box<RecordedTick>),
}

impl Event {
    /// Parameters of the nodes if the event is a start, else `None`.
    pub fn config(&self) -> Option<&RobotConfig> {
        match self {
            Self::Start { config, .. } => Some(config),
            _ => None,
        }
    }

    /// Time of the event, ms.
    pub fn tick(&self) -> u32 {
        match self {
            Self::Start { tick, .. } | Self::Off(tick, _) | Self::Command(tick, _) => *tick,
            Self::Tick(step) => step.tick,
        }
    }
}

/// Inputs and outputs of a board at a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedTick {
    /// Time of the tick, ms.
    pub tick: u32,
    /// Sensor samples of the tick.
    pub samples: Samples,
    /// Frames that arrived before the tick.
    pub received: Vec<CanFrame>,
    /// Wheel torques that the board commanded, N m.
    pub torque_nm: Wheels<Exact>,
    /// Frames that the board sent.
    pub sent: Vec<CanFrame>,
    /// Output of the lead node; `None` if none belongs to this tick.
    pub lead: Option<Box<lead::Output>>,
}

/// Metadata of a log and true states of the robot, without the events of the boards.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// Metadata of the run.
    pub about: BTreeMap<String, String>,
    /// Metadata of the end of the run.
    pub end: BTreeMap<String, String>,
    /// True state of the robot by time of the run, ms.
    pub truth: BTreeMap<u32, TruthEntry>,
    /// Common time of the boards at the start of the run, µs.
    pub zero_us: Option<i64>,
    /// Number of ticks of the board that has the most ticks.
    pub ticks: usize,
}

/// First bytes of the parameters, which a log without the number of axles lacks. Such a log also lacks the last table,
/// that of the train.
const TWO_AXLES: [u8; 1] = [2];
/// Last bytes of the lead node's output, which a log without inner axles lacks.
const NO_INNER_AXLES: [u8; 3] = [0; 3];

/// Events of each board in order of time, by board in the order of [`Topology::boards`].
pub type Events = Vec<Vec<Event>>;

/// Complete content of a log.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Axles of the robot.
    pub robot: Topology,
    /// Metadata and true states of the log.
    pub run: Run,
    /// Events of all boards.
    pub boards: Events,
}

impl Recording {
    /// Number of ticks of the board that has the most ticks.
    pub fn ticks(&self) -> usize {
        self.run.ticks
    }
}

/// Reads a log in memory; `name` is the name of the log in errors.
pub fn read(bytes: &[u8], name: &str) -> Result<Recording, Error> {
    let robot = robot(Cursor::new(bytes), name)?;
    let mut boards = vec![Vec::new(); robot.board_count()];
    let mut keep = |role, event| boards[robot.place(role)].push(event);
    let run = stream(Cursor::new(bytes), robot, name, &mut keep)?;
    Ok(Recording { robot, run, boards })
}

/// Axles of the robot in a log, from the metadata at its start; two without metadata, which [`stream`] refuses.
pub fn robot(mut file: impl Read, name: &str) -> Result<Topology, Error> {
    let refuse = |what: String| Error::input(format!("{name}: {what}"));
    let mut records = LinearReader::new();
    // A damaged log is refused by `stream`, which names the place.
    while let Some(Ok(event)) = records.next_event() {
        match event {
            LinearReadEvent::ReadRequest(length) => {
                let read = file.read(records.insert(length));
                records.notify_read(read.map_err(|error| refuse(error.to_string()))?);
            }
            LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data) {
                Ok(Record::Metadata(about)) if about.name == ABOUT => {
                    let scenario = about.metadata.get("scenario").map_or("", String::as_str);
                    return robot_of(scenario).map_err(refuse);
                }
                Ok(_) => {}
                Err(_) => break,
            },
        }
    }
    Ok(Topology::PAIR)
}

/// Axles of the robot of a scenario in a log; a scenario without this number has two.
fn robot_of(scenario: &str) -> Result<Topology, String> {
    let table: toml::Table = scenario.parse().unwrap_or_default();
    let axles = table
        .get("robot")
        .and_then(|robot| robot.get("geometry")?.get("axles")?.as_integer());
    let Some(axles) = axles else {
        return Ok(Topology::PAIR);
    };
    let robot = usize::try_from(axles).ok().and_then(Topology::new);
    robot.ok_or_else(|| format!("robot.geometry.axles = {axles}: must be from 2 to {MAX_AXLES}"))
}

/// Reads a log of `robot` (see [`robot`]) and passes the events of each board to `to`, in order; `name` identifies the
/// log in errors.
///
/// The checksums are checked before the first event, the messages during reading. An error therefore also means that
/// the events passed so far are invalid.
pub fn stream(
    mut file: impl Read + Seek,
    robot: Topology,
    name: &str,
    to: &mut dyn FnMut(Role, Event),
) -> Result<Run, Error> {
    let refuse = |what: String| Error::input(format!("{name}: {what}"));
    intact::check(&mut file).map_err(refuse)?;
    file.rewind().map_err(|error| refuse(error.to_string()))?;
    let mut reader = Reader::new(robot, to);
    let mut topics: HashMap<u16, String> = HashMap::new();
    let mut position = 0u64;
    let mut records = LinearReader::new();
    while let Some(event) = records.next_event() {
        let broken =
            |error: McapError| refuse(format!("after {position} messages: {}", explain(&error)));
        let record = match event.map_err(broken)? {
            LinearReadEvent::ReadRequest(length) => {
                let read = file.read(records.insert(length));
                records.notify_read(read.map_err(|error| broken(error.into()))?);
                continue;
            }
            LinearReadEvent::Record { data, opcode } => mcap::parse_record(opcode, data),
        };
        match record.map_err(broken)? {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                position += 1;
                let Some(topic) = topics.get(&header.channel_id) else {
                    return Err(refuse(format!("message {position}: unknown channel")));
                };
                reader
                    .take(topic, &data)
                    .map_err(|what| refuse(format!("message {position} on {topic}: {what}")))?;
                // Ticks before the start of the run have log time zero.
                if reader.run.zero_us.is_none() && header.log_time > 0 {
                    let last = match reader.board_of(topic) {
                        Some((role, "tick")) => reader.boards[reader.robot.place(role)].last,
                        _ => None,
                    };
                    reader.run.zero_us =
                        last.map(|last| 1000 * i64::from(last) - (header.log_time / 1000) as i64);
                }
            }
            Record::Metadata(metadata) if metadata.name == ABOUT => {
                reader.run.about = metadata.metadata;
                if let Some(other) = reader
                    .run
                    .about
                    .get("format")
                    .filter(|of| !FORMATS.contains(&of.as_str()))
                {
                    return Err(refuse(format!(
                        "log of format {other}: this program reads formats {}",
                        FORMATS.join(" and ")
                    )));
                }
            }
            Record::Metadata(metadata) if metadata.name == END => {
                reader.run.end = metadata.metadata;
            }
            _ => {}
        }
    }
    let run = reader.finish();
    if !run.about.contains_key("format") {
        return Err(refuse(
            "not a log of cfmmr: the metadata record `cfmmr` is missing".to_owned(),
        ));
    }
    if run.ticks == 0 {
        return Err(refuse(
            "contains no ticks of boards, so it cannot be replayed".to_owned(),
        ));
    }
    Ok(run)
}

/// Text about an error of the MCAP format.
fn explain(error: &McapError) -> String {
    match error {
        McapError::UnexpectedEof | McapError::UnexpectedEoc | McapError::BadFooter => {
            "the file is truncated".to_owned()
        }
        McapError::UnsupportedCompression(which) => {
            format!("compressed by {which}: cfmmr writes logs without compression")
        }
        error => format!("damaged: {error}"),
    }
}

fn parse<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    serde_json::from_slice(data).map_err(|error| error.to_string())
}

/// Events and frames of a board that are read so far.
#[derive(Default)]
struct Board {
    /// Time of the latest event, ms.
    last: Option<u32>,
    /// True while the board is on. Frames and outputs of a board that is off are ignored.
    on: bool,
    ticks: usize,
    /// Frames that the board sent since its latest recorded tick, each with its tick, ms.
    sent: Vec<(u32, CanFrame)>,
}

/// Content of a log that is read so far.
struct Reader<'a> {
    run: Run,
    robot: Topology,
    boards: Vec<Board>,
    /// Latest events of the front board, which wait for the outputs of the lead node.
    front: VecDeque<Event>,
    /// Outputs of the lead node by tick, ms; a board behind a link delivers them later than the tick.
    leads: HashMap<u32, Box<lead::Output>>,
    /// Time of the front board's latest event that was passed on, ms; `None` from the board's start until an event was
    /// passed on.
    released: Option<u32>,
    to: &'a mut dyn FnMut(Role, Event),
}

impl<'a> Reader<'a> {
    fn new(robot: Topology, to: &'a mut dyn FnMut(Role, Event)) -> Self {
        Self {
            run: Run::default(),
            robot,
            boards: robot.boards().map(|_| Board::default()).collect(),
            front: VecDeque::new(),
            leads: HashMap::new(),
            released: None,
            to,
        }
    }

    /// Board of a topic and kind of its messages; `None` if the topic belongs to no board.
    fn board_of<'t>(&self, topic: &'t str) -> Option<(Role, &'t str)> {
        let (name, kind) = topic.strip_prefix("/boards/")?.split_once('/')?;
        let role = self
            .robot
            .boards()
            .find(|role| self.robot.name(*role) == name)?;
        Some((role, kind))
    }

    /// Passes on the front board's events before `before`, ms; all events if `None`.
    fn release(&mut self, before: Option<u32>) {
        let old = |event: &Event| before.is_none_or(|before| event.tick() < before);
        while let Some(mut event) = self.front.pop_front_if(|event| old(event)) {
            self.released = Some(event.tick());
            if let Event::Tick(step) = &mut event {
                step.lead = self.leads.remove(&step.tick);
            }
            (self.to)(Role::LEAD, event);
        }
    }

    /// Passes on all waiting events of the front board, and forgets outputs without a tick.
    fn settle(&mut self) {
        self.release(None);
        self.leads.clear();
        self.released = None;
    }

    fn finish(mut self) -> Run {
        self.settle();
        let ticks = self.boards.iter().map(|board| board.ticks);
        self.run.ticks = ticks.max().unwrap_or_default();
        self.run
    }

    /// Takes a message; ignores topics that replay does not need.
    fn take(&mut self, topic: &str, data: &[u8]) -> Result<(), String> {
        match topic {
            "/truth" => {
                let entry: TruthEntry = parse(data)?;
                let tick = (entry.time_s * 1e3).round() as u32;
                self.run.truth.insert(tick, entry);
            }
            "/bus" => {
                let entry: BusEntry = parse(data)?;
                let robot = self.robot;
                let named = |role: &Role| robot.name(*role) == entry.board;
                let sender = robot.boards().find(named);
                let sender = sender.ok_or_else(|| format!("no board {}", entry.board))?;
                let frames = entry.frames.into_iter();
                let board = &mut self.boards[robot.place(sender)];
                if board.on {
                    let frames = frames.map(|logged| (entry.tick, logged.frame.0));
                    board.sent.extend(frames);
                }
            }
            "/lead" => {
                let LeadBits { tick, bits } = parse(data)?;
                let output = bits
                    .value_or_earlier(&[], &NO_INNER_AXLES)
                    .ok_or("the bits of the lead node's output do not decode")?;
                if self.released.is_some_and(|released| tick <= released) {
                    return Err(format!(
                        "recorded more than {MAX_OUTPUT_DELAY_MS} ms after its tick"
                    ));
                }
                if self.boards[self.robot.place(Role::LEAD)].on {
                    self.leads.insert(tick, output);
                }
            }
            "/host/order" => {
                let entry: HostCommandEntry = parse(data)?;
                let given = entry
                    .bits
                    .value()
                    .ok_or("its bits do not decode to a command")?;
                self.push(Role::LEAD, Event::Command(entry.tick, given))?;
            }
            _ => {
                if let Some((role, kind)) = self.board_of(topic) {
                    self.of_board(role, kind, data)?;
                }
            }
        }
        Ok(())
    }

    fn of_board(&mut self, role: Role, kind: &str, data: &[u8]) -> Result<(), String> {
        let frames = |received: Vec<Can>| received.into_iter().map(|can| can.0).collect();
        let board = &mut self.boards[self.robot.place(role)];
        let event = match (kind, role) {
            ("start", _) => {
                board.sent.clear();
                if role == Role::LEAD {
                    self.settle();
                }
                let entry: Start = parse(data)?;
                let config = entry
                    .parameters
                    .value_or_earlier(&TWO_AXLES, &Hex::of(&train::Config::default()).0);
                let place = entry.place.as_ref().map(|bits| bits.value().map(Box::new));
                let place = place.map(|place| place.ok_or("its initial estimate does not decode"));
                Event::Start {
                    tick: entry.tick,
                    config: Box::new(config.ok_or("its parameters do not decode in this version")?),
                    place: place.transpose()?,
                }
            }
            ("off", _) => {
                let Off { tick, reason } = parse(data)?;
                Event::Off(tick.max(board.last.unwrap_or(tick)), reason)
            }
            ("tick", Role::Beam(_)) => {
                let entry: BeamTick = parse(data)?;
                Event::Tick(Box::new(RecordedTick {
                    tick: entry.tick,
                    samples: Samples::Beam(beam::Samples {
                        counts: entry.counts,
                        conditions: entry.conditions,
                    }),
                    received: frames(entry.received),
                    torque_nm: Wheels::both(Exact(0.0)),
                    sent: sent_at(&mut board.sent, entry.tick),
                    lead: None,
                }))
            }
            ("tick", _) => {
                let entry: AxleTick = parse(data)?;
                Event::Tick(Box::new(RecordedTick {
                    tick: entry.tick,
                    samples: Samples::Axle(axle::Samples {
                        encoder: entry.encoder.into(),
                        gyro_rad_s: entry.gyro_rad_s.map(|value| value.0),
                        acceleration_m_s2: entry.acceleration_m_s2.map(|value| value.0),
                        conditions: entry.conditions,
                    }),
                    received: frames(entry.received),
                    torque_nm: entry.torque_nm.into(),
                    sent: sent_at(&mut board.sent, entry.tick),
                    lead: None,
                }))
            }
            _ => return Ok(()),
        };
        self.push(role, event)
    }

    fn push(&mut self, role: Role, event: Event) -> Result<(), String> {
        let board = &mut self.boards[self.robot.place(role)];
        let tick = event.tick();
        // A restarted board may count its time from zero.
        let begins = matches!(event, Event::Start { .. });
        if !begins && board.last.is_some_and(|last| last > tick) {
            return Err("its time is before the previous message".to_owned());
        }
        board.last = Some(tick);
        board.on = !matches!(event, Event::Off(..));
        board.ticks += usize::from(matches!(event, Event::Tick(_)));
        if role == Role::LEAD {
            self.front.push_back(event);
            self.release(Some(tick.saturating_sub(MAX_OUTPUT_DELAY_MS)));
        } else {
            (self.to)(role, event);
        }
        Ok(())
    }
}

/// Takes the frames that the nodes sent at `tick`, and drops the frames of other ticks: the board did not reply to
/// those ticks.
fn sent_at(sent: &mut Vec<(u32, CanFrame)>, tick: u32) -> Vec<CanFrame> {
    let of_nodes = |(at, frame): &(u32, CanFrame)| *at == tick && is_of_nodes(frame);
    let frames = sent.drain(..).filter(of_nodes);
    frames.map(|(_, frame)| frame).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::entry::Hex;

    #[test]
    fn topics_of_three_axles_are_those_of_their_boards() {
        let robot = Topology::new(3).unwrap();
        let mut roles = Vec::new();
        let mut keep = |role, _| roles.push(role);
        let mut reader = Reader::new(robot, &mut keep);
        for board in ["axle-2", "rear", "beam-2", "beam"] {
            let topic = format!("/boards/{board}/off");
            reader
                .take(&topic, b"{\"tick\": 1, \"reason\": \"\"}")
                .unwrap();
        }
        reader.finish();
        assert_eq!(roles, [Role::axle(1), Role::axle(2), Role::beam(1)]);
        let topics = crate::topics::topics(robot);
        let known = |name: &str| topics.iter().any(|topic| topic.name == name);
        assert!(known("/boards/beam-2/tick") && !known("/boards/beam/tick"));
    }

    #[test]
    fn late_output_of_the_lead_node_is_refused() {
        let mut ticks = Vec::new();
        let mut keep = |_, event: Event| ticks.push(event.tick());
        let mut reader = Reader::new(Topology::PAIR, &mut keep);
        for tick in [0, 10, MAX_OUTPUT_DELAY_MS + 5] {
            let event = Event::Command(tick, HostCommand::Lost);
            reader.push(Role::LEAD, event).unwrap();
        }
        let mut lead = |tick: u32| {
            let bits = serde_json::to_string(&Hex::of(&lead::Output::default())).unwrap();
            let text = format!("{{\"tick\": {tick}, \"bits\": {bits}}}");
            reader.take("/lead", text.as_bytes())
        };
        assert_eq!(lead(10), Ok(()));
        let refused = lead(0).unwrap_err();
        assert_eq!(refused, "recorded more than 10000 ms after its tick");
        reader.finish();
        assert_eq!(ticks, [0, 10, MAX_OUTPUT_DELAY_MS + 5]);
    }
}
