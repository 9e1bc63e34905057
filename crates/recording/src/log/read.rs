//! Reading a log again: what each board got and did, in order.
//!
//! A file that is cut short, damaged, or none of this program is refused as bad input with what is
//! wrong with it and where; nothing in a file can make the reader panic or take much more memory
//! than the file.

use super::intact;
use crate::entry::{
    ABOUT, AxleTick, BeamTick, BusEntry, Can, END, Exact, FORMAT, HostCommandEntry, LeadBits, Off,
    Start, TruthEntry,
};
use core_algos::bus::CanFrame;
use core_algos::link::protocol::Place;
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::node::{axle, beam, lead};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::is_of_nodes;
use host_sim::targets::host_command::HostCommand;
use mcap::McapError;
use mcap::read::ChunkFlattener;
use mcap::records::Record;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, HashMap};

/// Event of a board.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Its nodes were started.
    Start {
        /// The first tick, ms.
        tick: u32,
        /// Parameters.
        config: Box<RobotConfig>,
        /// Initial estimate of the lead node.
        place: Option<Box<Place>>,
    },
    /// It was switched off or lost, or its record ended, at this tick, ms, for this reason.
    Off(u32, String),
    /// The lead node was told something before this tick, ms.
    Command(u32, HostCommand),
    /// A tick.
    Tick(Box<Step>),
}

impl Event {
    /// The parameters, of a start.
    pub fn config(&self) -> Option<&RobotConfig> {
        match self {
            Self::Start { config, .. } => Some(config),
            _ => None,
        }
    }

    /// Time, ms.
    pub fn tick(&self) -> u32 {
        match self {
            Self::Start { tick, .. } | Self::Off(tick, _) | Self::Command(tick, _) => *tick,
            Self::Tick(step) => step.tick,
        }
    }
}

/// One tick of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Time, ms.
    pub tick: u32,
    /// Samples.
    pub samples: Samples,
    /// Frames that arrived.
    pub received: Vec<CanFrame>,
    /// Torques it commanded, N m.
    pub torque_nm: [Exact; 2],
    /// Frames it sent.
    pub sent: Vec<CanFrame>,
    /// The lead node's output, when it came with this tick's answer.
    pub lead: Option<Box<lead::Output>>,
}

/// A log.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Metadata of the run.
    pub about: BTreeMap<String, String>,
    /// Result.
    pub end: BTreeMap<String, String>,
    /// Events of each board, in the order of [`Role::ALL`].
    pub boards: [Vec<Event>; 3],
    /// The true state, by time of the run, ms.
    pub truth: BTreeMap<u32, TruthEntry>,
    /// Common time of the boards at the start of the run, µs.
    pub zero_us: Option<i64>,
}

impl Recording {
    /// Ticks of the board that has most.
    pub fn ticks(&self) -> usize {
        let ticks = |events: &Vec<Event>| {
            let ticks = events
                .iter()
                .filter(|event| matches!(event, Event::Tick(_)));
            ticks.count()
        };
        self.boards.iter().map(ticks).max().unwrap_or_default()
    }
}

/// Incomplete entries while a log is read.
#[derive(Default)]
struct Pending {
    /// Frames that each board sent at the tick whose entry comes next.
    sent: [Vec<(u32, CanFrame)>; 3],
    /// Outputs of the lead node by tick, ms: of a board at a link they come later than the tick.
    leads: HashMap<u32, Box<lead::Output>>,
}

/// Reads a log; `name` stands in errors.
pub fn read(bytes: &[u8], name: &str) -> Result<Recording, Error> {
    let refuse = |what: String| Error::input(format!("{name}: {what}"));
    let mut recording = Recording::default();
    let mut pending = Pending::default();
    let mut topics: HashMap<u16, String> = HashMap::new();
    let mut position = 0u64;
    intact::check(bytes).map_err(refuse)?;
    let records = ChunkFlattener::new(bytes).map_err(|error| refuse(explain(&error)))?;
    for record in records {
        let record = record
            .map_err(|error| refuse(format!("after {position} messages: {}", explain(&error))))?;
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                position += 1;
                let Some(topic) = topics.get(&header.channel_id) else {
                    return Err(refuse(format!("message {position}: unknown channel")));
                };
                recording
                    .take(&mut pending, topic, &data)
                    .map_err(|what| refuse(format!("message {position} on {topic}: {what}")))?;
                // Ticks before the start of the run have its time.
                if recording.zero_us.is_none() && header.log_time > 0 {
                    let of_topic = |role: &Role| {
                        let board = topic
                            .strip_prefix("/boards/")
                            .and_then(|rest| rest.strip_suffix("/tick"));
                        board == Some(role.name())
                    };
                    let role = Role::ALL.into_iter().find(of_topic);
                    let last = role.and_then(|role| recording.boards[role as usize].last());
                    recording.zero_us = last.map(|last| {
                        1000 * i64::from(last.tick()) - (header.log_time / 1000) as i64
                    });
                }
            }
            Record::Metadata(metadata) if metadata.name == ABOUT => {
                recording.about = metadata.metadata;
                if let Some(other) = recording.about.get("format").filter(|of| *of != FORMAT) {
                    return Err(refuse(format!(
                        "log of format {other}: this program reads format {FORMAT}"
                    )));
                }
            }
            Record::Metadata(metadata) if metadata.name == END => {
                recording.end = metadata.metadata;
            }
            _ => {}
        }
    }
    recording.settle(&mut pending);
    if !recording.about.contains_key("format") {
        return Err(refuse(
            "not a log of cfmmr: the metadata record `cfmmr` is missing".to_owned(),
        ));
    }
    if recording.ticks() == 0 {
        return Err(refuse(
            "contains no ticks of boards, so it cannot be replayed".to_owned(),
        ));
    }
    Ok(recording)
}

/// An error of the file's format in plain words.
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

impl Recording {
    /// True if a board is recorded at this point of the log.
    fn is_on(&self, role: Role) -> bool {
        let last = self.boards[role as usize].last();
        last.is_some_and(|last| !matches!(last, Event::Off(..)))
    }

    /// Gives the outputs of the lead node to the ticks since its latest start.
    fn settle(&mut self, pending: &mut Pending) {
        let leads = &mut pending.leads;
        for event in self.boards[Role::Front as usize].iter_mut().rev() {
            match event {
                Event::Tick(step) => step.lead = leads.remove(&step.tick).or(step.lead.take()),
                Event::Start { .. } => break,
                _ => {}
            }
        }
        leads.clear();
    }

    /// Takes in a message; one on a topic that replay does not need is left alone.
    fn take(&mut self, pending: &mut Pending, topic: &str, data: &[u8]) -> Result<(), String> {
        match topic {
            "/truth" => {
                let entry: TruthEntry = parse(data)?;
                let tick = (entry.time_s * 1e3).round() as u32;
                self.truth.insert(tick, entry);
            }
            "/bus" => {
                let entry: BusEntry = parse(data)?;
                let frames = entry.frames.into_iter();
                if self.is_on(entry.board) {
                    pending.sent[entry.board as usize]
                        .extend(frames.map(|said| (entry.tick, said.frame.0)));
                }
            }
            "/lead" => {
                let LeadBits { tick, bits } = parse(data)?;
                let output = bits
                    .value()
                    .ok_or("the bits of the lead node's output do not decode")?;
                if self.is_on(Role::Front) {
                    pending.leads.insert(tick, output);
                }
            }
            "/host/order" => {
                let entry: HostCommandEntry = parse(data)?;
                let given = entry
                    .bits
                    .value()
                    .ok_or("its bits do not decode to a command")?;
                self.push(Role::Front, Event::Command(entry.tick, given))?;
            }
            _ => {
                let board = topic.strip_prefix("/boards/");
                let parts = board.and_then(|rest| rest.split_once('/'));
                let named = |(board, what)| {
                    let role = Role::ALL.into_iter().find(|role| role.name() == board)?;
                    Some((role, what))
                };
                if let Some((role, what)) = parts.and_then(named) {
                    self.of_board(pending, role, what, data)?;
                }
            }
        }
        Ok(())
    }

    fn of_board(
        &mut self,
        pending: &mut Pending,
        role: Role,
        what: &str,
        data: &[u8],
    ) -> Result<(), String> {
        let frames = |received: Vec<Can>| received.into_iter().map(|can| can.0).collect();
        let event = match (what, role) {
            ("start", _) => {
                if role == Role::Front {
                    self.settle(pending);
                }
                pending.sent[role as usize].clear();
                let entry: Start = parse(data)?;
                let config = entry.parameters.value();
                let place = entry.place.as_ref().map(|bits| bits.value().map(Box::new));
                let place = place.map(|place| place.ok_or("its place does not decode"));
                Event::Start {
                    tick: entry.tick,
                    config: Box::new(config.ok_or("its parameters do not decode in this version")?),
                    place: place.transpose()?,
                }
            }
            ("off", _) => {
                let Off { tick, reason } = parse(data)?;
                let last = self.boards[role as usize].last().map_or(tick, Event::tick);
                Event::Off(tick.max(last), reason)
            }
            ("tick", Role::Beam) => {
                let entry: BeamTick = parse(data)?;
                Event::Tick(Box::new(Step {
                    tick: entry.tick,
                    samples: Samples::Beam(beam::Samples {
                        counts: entry.counts,
                        conditions: entry.conditions,
                    }),
                    received: frames(entry.received),
                    torque_nm: [Exact(0.0); 2],
                    sent: sent_at(&mut pending.sent[role as usize], entry.tick),
                    lead: None,
                }))
            }
            ("tick", _) => {
                let entry: AxleTick = parse(data)?;
                Event::Tick(Box::new(Step {
                    tick: entry.tick,
                    samples: Samples::Axle(axle::Samples {
                        encoder: entry.encoder,
                        gyro_rad_s: entry.gyro_rad_s.map(|value| value.0),
                        acceleration_m_s2: entry.acceleration_m_s2.map(|value| value.0),
                        conditions: entry.conditions,
                    }),
                    received: frames(entry.received),
                    torque_nm: entry.torque_nm,
                    sent: sent_at(&mut pending.sent[role as usize], entry.tick),
                    lead: None,
                }))
            }
            _ => return Ok(()),
        };
        self.push(role, event)
    }

    fn push(&mut self, role: Role, event: Event) -> Result<(), String> {
        let events = &mut self.boards[role as usize];
        // A board that was restarted may count from zero.
        let begins = matches!(event, Event::Start { .. });
        if !begins && events.last().is_some_and(|last| last.tick() > event.tick()) {
            return Err("its time is before the previous message".to_owned());
        }
        events.push(event);
        Ok(())
    }
}

/// The frames of the nodes at a tick; those of other ticks belong to ticks whose answers never came.
fn sent_at(sent: &mut Vec<(u32, CanFrame)>, tick: u32) -> Vec<CanFrame> {
    let of_nodes = |(at, frame): &(u32, CanFrame)| *at == tick && is_of_nodes(frame);
    let frames = sent.drain(..).filter(of_nodes);
    frames.map(|(_, frame)| frame).collect()
}
