//! Link to one board of a driving robot, over its serial port. The link carries bus frames and the record: inputs and
//! outputs of each tick of the board's nodes. At the front board the link also carries orders, the numbered commands
//! of the host, and the lead node's output. A host commands the robot while the host holds the lease
//! ([`core_algos::link::lease`]).
//!
//! The link has no clock and no port: the caller passes received bytes to [`BoardLink::take`] and sends the bytes of
//! [`BoardLink::to_send`].

use crate::board::{check_hello, complete, refused};
use core_algos::bus::CanFrame;
use core_algos::link::framing::{Decoder, SerialFrame};
use core_algos::link::lease::TERM;
use core_algos::link::protocol::{
    self, CONFIG_CHUNK, MAX_CONFIG, PROTOCOL, Packed, Refusal, Reply, Request, Telemetry,
};
use core_algos::link::record::{self, Entry};
use core_algos::link::{Order, Stamp};
use core_algos::node::lead::Task;
use core_algos::time::Micros;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::targets::board_record::{BoardEvent, BoardRecord};
use host_sim::targets::{Fault, HostCommand, Room};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering::Relaxed};

/// Time after which a request is repeated, µs.
const REPEAT_AFTER_US: Micros = 250_000;
/// Time without a reply to a request after which the board counts as silent, µs.
const REPLY_TIMEOUT_US: Micros = 5_000_000;
/// Time between renewals of the lease, µs.
const RENEW_INTERVAL_US: Micros = TERM / 8;
/// Number of outputs of the lead node to await after an order before the free room in an output is current; two older
/// outputs may still arrive.
const FRESH_OUTPUTS: u32 = 3;

/// Kind of a request to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    /// Renewal of the lease.
    Lease,
    Record,
    /// A speed command, which the next speed command replaces.
    Speed,
    Other(&'static str),
}

impl Subject {
    /// Name of the request in error messages.
    fn name(self) -> &'static str {
        match self {
            Self::Lease => "lease",
            Self::Record => "record",
            Self::Speed => "speed",
            Self::Other(name) => name,
        }
    }
}

/// A request that waits for its reply.
#[derive(Clone)]
struct Pending {
    number: u8,
    what: Subject,
    frame: SerialFrame,
    /// Time of the latest transmission, µs; `None` before the first.
    sent: Option<Micros>,
    /// Time since which the reply is missing, µs; a newer speed command takes over the time of the command that it
    /// replaces.
    since: Option<Micros>,
}

/// Number of the host's latest order. A clone is a separate counter.
#[derive(Default)]
struct Sequence(Arc<AtomicU16>);

impl Clone for Sequence {
    fn clone(&self) -> Self {
        Self(Arc::new(self.0.load(Relaxed).into()))
    }
}

impl Sequence {
    /// Second handle to the same counter.
    fn shared(&self) -> Self {
        Self(self.0.clone())
    }

    /// Stamp of the next order, with the next number.
    fn next(&self, owner: u16) -> Stamp {
        let sequence = self.0.fetch_add(1, Relaxed).wrapping_add(1);
        Stamp { owner, sequence }
    }
}

/// Link to one board.
#[derive(Clone)]
pub struct BoardLink {
    robot: Topology,
    role: Role,
    decoder: Decoder,
    number: u8,
    waiting: VecDeque<Pending>,
    parts: Vec<u8>,
    latest: Option<Telemetry>,
    /// Number of outputs of the lead node since the latest reply to an order.
    outputs: u32,
    frames: Vec<CanFrame>,
    /// Configuration of the nodes, encoded, as received so far. Once complete, the configuration starts `record`.
    config: Vec<u8>,
    record: Option<BoardRecord>,
    denied: bool,
    /// Numbered orders that the board may still report as executed.
    orders: VecDeque<(u16, Order)>,
    /// Sequence number of the latest report; `None` before the first.
    report: Option<u16>,
    /// Number of reports received.
    reports: u64,
    /// Number of requests that the board has answered.
    answered: u32,
    lost: u16,
    build: String,
    /// Random number that identifies this host in its lease; below, sequence number of the host's latest order.
    owner: u16,
    sequence: Sequence,
    /// Time of the latest order or renewal sent, µs; `Some(None)` before the first is sent, `None` without the lease.
    lease_renewed: Option<Option<Micros>>,
    leased: bool,
}

impl BoardLink {
    /// Creates a link for a host that identifies itself by `owner` in its lease.
    pub fn new(robot: Topology, role: Role, owner: u16) -> Self {
        Self {
            robot,
            role,
            owner,
            decoder: Decoder::default(),
            number: 0,
            waiting: VecDeque::new(),
            parts: Vec::new(),
            latest: None,
            outputs: 0,
            frames: Vec::new(),
            config: Vec::new(),
            record: None,
            denied: false,
            orders: VecDeque::new(),
            report: None,
            reports: 0,
            answered: 0,
            lost: 0,
            build: String::new(),
            sequence: Sequence::default(),
            lease_renewed: None,
            leased: false,
        }
    }

    /// Discards all earlier requests; then requests the board's identity and its reports.
    pub fn open(&mut self) {
        let (number, sequence) = (self.number, self.sequence.shared());
        *self = Self {
            number,
            sequence,
            ..Self::new(self.robot, self.role, self.owner)
        };
        self.watch();
    }

    /// Restarts the nodes of the board and records them from their start.
    pub fn record(&mut self) {
        (self.config, self.record, self.denied) = (Vec::new(), None, false);
        for offset in (0..MAX_CONFIG as u16).step_by(CONFIG_CHUNK) {
            self.queue_request(
                Subject::Other("configuration"),
                &Request::Configuration { offset },
            );
        }
        let stamp = self.sequence.next(self.owner);
        self.queue_request(Subject::Record, &Request::Record(stamp));
    }

    /// Name of the board's role.
    pub fn name(&self) -> &'static str {
        self.robot.name(self.role)
    }

    /// Role of the board.
    pub fn role(&self) -> Role {
        self.role
    }

    /// True while the board is recorded.
    pub fn is_recorded(&self) -> bool {
        self.record.as_ref().is_some_and(BoardRecord::is_running)
    }

    /// Events of the record since the last call.
    pub fn take_events(&mut self) -> Vec<BoardEvent> {
        self.record.as_mut().map_or(Vec::new(), BoardRecord::take)
    }

    /// Takes a part of the configuration; a complete configuration starts the record.
    fn configured(&mut self, total: u16, bytes: &[u8]) -> Result<(), Error> {
        self.config.extend_from_slice(bytes);
        if bytes.is_empty() || self.config.len() < usize::from(total) {
            return Ok(());
        }
        let config = postcard::from_bytes(&self.config).map_err(|error| {
            Error::Failure(format!("{} board: configuration: {error}", self.name()))
        })?;
        self.record = Some(BoardRecord::new(self.role, config));
        Ok(())
    }

    /// Takes a report. The record ends if a report is lost or damaged, if the board's buffer overflowed, or if the
    /// board executed an order of another program.
    fn reported(&mut self, (sequence, lost): (u16, u16), entries: &[u8]) {
        let before = self.report.replace(sequence);
        let lost_before = std::mem::replace(&mut self.lost, lost);
        self.reports += 1;
        if before != Some(sequence.wrapping_sub(1)) {
            self.end_record("a report was lost");
        }
        for entry in record::entries(entries) {
            let Some(entry) = entry else {
                self.end_record("a report was damaged");
                break;
            };
            self.frames.extend(entry.frame());
            let Some(record) = &mut self.record else {
                continue;
            };
            let Entry::Carried(number) = entry else {
                record.put(&entry);
                continue;
            };
            match self.orders.iter().find(|(sent, _)| *sent == number) {
                Some((_, order)) => record.put(&Entry::Order(*order)),
                None => record.end("the board executed a command of another program".to_owned()),
            }
        }
        if lost != lost_before {
            self.end_record("the buffer of the board for the record overflowed");
        }
    }

    /// Ends the record of the board, with the reason.
    pub fn end_record(&mut self, reason: &str) {
        if let Some(record) = &mut self.record {
            record.end(reason.to_owned());
        }
    }

    /// True if the nodes have restarted since the record was requested.
    pub fn has_begun(&self) -> bool {
        self.record.as_ref().is_some_and(BoardRecord::has_begun)
    }

    /// True if the board rejected the record because its motors may be on.
    pub fn is_denied(&self) -> bool {
        self.denied
    }

    /// Asks the board to send a service tool's frame on the bus.
    pub fn send(&mut self, frame: &CanFrame) {
        let mut bus = Packed::new();
        bus.push(frame);
        self.queue_request(
            Subject::Other("bus frame"),
            &Request::Send { bus: bus.bytes() },
        );
    }

    /// Requests the board's identity, and its reports from then on.
    pub fn watch(&mut self) {
        let hello = Request::Hello {
            protocol: PROTOCOL,
            nonce: self.number.into(),
        };
        self.queue_request(Subject::Other("hello"), &hello);
        self.queue_request(Subject::Other("watch"), &Request::Watch);
    }

    /// Continues after the port was reopened. A waiting order is sent first: the board recognises its number and
    /// executes the order only once.
    pub fn rejoin(&mut self) {
        self.end_record("the port was closed");
        for pending in &mut self.waiting {
            (pending.sent, pending.since) = (None, None);
        }
        if self.lease_renewed.is_some() && self.waiting.is_empty() {
            // No order is waiting, so a request of its own renews the lease before the lease lapses.
            let stamp = self.stamp();
            self.queue_request(Subject::Lease, &Request::Keep(stamp));
        }
        self.watch();
    }

    /// Queues an order. A speed command without a reply is replaced by a newer speed command.
    pub fn command(&mut self, command: &HostCommand) {
        let what = match command {
            HostCommand::Task(Task::Drive { .. }) => Subject::Speed,
            _ => Subject::Other(command.subject()),
        };
        let late = self
            .waiting
            .pop_back_if(|late| (late.what, what) == (Subject::Speed, Subject::Speed));
        for order in command.orders() {
            let stamp = self.stamp();
            self.queue_request(what, &Request::Order { stamp, order });
            self.orders.push_back((stamp.sequence, order));
        }
        if let (Some(late), Some(latest)) = (late, self.waiting.back_mut()) {
            latest.since = late.since;
        }
        // Keeps as many orders as may still be reported as executed.
        let most = 2 * self.waiting.len() + 64;
        self.orders.drain(..self.orders.len().saturating_sub(most));
        self.outputs = 0;
    }

    /// True if an order was rejected because another host has the lease.
    pub fn is_leased(&self) -> bool {
        self.leased
    }

    /// Takes the lease before the first order.
    pub fn take_lease(&mut self) {
        let stamp = self.stamp();
        self.queue_request(Subject::Other("command"), &Request::Keep(stamp));
    }

    /// Requests the end of the lease.
    pub fn release(&mut self) {
        let stamp = self.stamp();
        self.queue_request(Subject::Other("release"), &Request::Release(stamp));
        self.lease_renewed = None;
    }

    /// Stamp of the next order; the host holds the lease from then on.
    fn stamp(&mut self) -> Stamp {
        self.lease_renewed.get_or_insert(None);
        self.sequence.next(self.owner)
    }

    /// Produces frames that switch the motors off in any state; each is newer than all earlier orders.
    pub fn motors_off(&self) -> impl FnMut() -> SerialFrame + Send + 'static {
        let (owner, sequence) = (self.owner, self.sequence.shared());
        move || {
            let stamp = sequence.next(owner);
            let order = Order::Task(Task::Idle);
            // Number 0 belongs to no request of the link.
            protocol::encode(0, &Request::Order { stamp, order }).unwrap_or_default()
        }
    }

    fn queue_request(&mut self, what: Subject, request: &Request) {
        // Number 0 is reserved for reports.
        self.number = self.number % u8::MAX + 1;
        self.waiting.push_back(Pending {
            number: self.number,
            what,
            // Every request of this link fits into a frame.
            frame: protocol::encode(self.number, request).unwrap_or_default(),
            sent: None,
            since: None,
        });
    }

    /// True if every request has its reply, except renewals of the lease.
    pub fn is_settled(&self) -> bool {
        self.waiting
            .iter()
            .all(|pending| pending.what == Subject::Lease)
    }

    /// True if the latest output of the lead node is newer than all orders.
    pub fn is_fresh(&self) -> bool {
        self.latest.is_some() && self.outputs >= FRESH_OUTPUTS
    }

    /// Free room of the lead node, points; zero until a current output has arrived.
    pub fn room(&self) -> Room {
        match &self.latest {
            Some(latest) if self.is_settled() && self.outputs >= FRESH_OUTPUTS => Room {
                path: latest.path_room.into(),
                trajectory: latest.trajectory_room.into(),
            },
            _ => Room {
                path: 0,
                trajectory: 0,
            },
        }
    }

    /// Latest output of the lead node; `None` before the first.
    pub fn latest(&self) -> Option<&Telemetry> {
        self.latest.as_ref()
    }

    /// Bus frames received since the last call, in the order of the board.
    pub fn take_frames(&mut self) -> Vec<CanFrame> {
        std::mem::take(&mut self.frames)
    }

    /// Number of reports received. A restarted board replies and reports nothing.
    pub fn reports(&self) -> u64 {
        self.reports
    }

    /// Number of bus frames and events that the board dropped for lack of room.
    pub fn lost(&self) -> u16 {
        self.lost
    }

    /// Number of damaged frames received at the port.
    pub fn damaged(&self) -> u32 {
        self.decoder.counters().damaged
    }

    /// Build of the board's image; empty before the first reply.
    pub fn build(&self) -> &str {
        &self.build
    }

    /// Bytes to send at `now`; `None` while nothing is due. An error if the board has not replied for 5 s.
    pub fn to_send(&mut self, now: Micros) -> Result<Option<&[u8]>, Error> {
        if let Some(lease_renewed) = &mut self.lease_renewed {
            let due = now.saturating_sub(*lease_renewed.get_or_insert(now)) >= RENEW_INTERVAL_US;
            if !self.waiting.is_empty() {
                *lease_renewed = Some(now);
            } else if due {
                *lease_renewed = Some(now);
                let stamp = self.stamp();
                self.queue_request(Subject::Lease, &Request::Keep(stamp));
            }
        }
        let name = self.name();
        let Some(pending) = self.waiting.front_mut() else {
            return Ok(None);
        };
        if let Some(sent) = pending.sent
            && now.saturating_sub(sent) < REPEAT_AFTER_US
        {
            return Ok(None);
        }
        if now - *pending.since.get_or_insert(now) >= REPLY_TIMEOUT_US {
            return Err(Error::Failure(format!(
                "{name} board: {}: no answer at its serial port in {} s",
                pending.what.name(),
                REPLY_TIMEOUT_US / 1_000_000
            )));
        }
        pending.sent = Some(now);
        Ok(Some(pending.frame.repeated()))
    }

    /// Takes received bytes; true if an output of the lead node is complete.
    pub fn take(&mut self, bytes: &[u8]) -> Result<bool, Error> {
        let decoder = &mut self.decoder;
        let payload = |&byte: &u8| decoder.take_byte(byte).map(<[u8]>::to_vec);
        let payloads: Vec<Vec<u8>> = bytes.iter().filter_map(payload).collect();
        let mut complete = false;
        for payload in &payloads {
            match protocol::decode::<Reply>(payload) {
                Some((
                    _,
                    Reply::Report {
                        sequence,
                        lost,
                        entries,
                        offset,
                        telemetry,
                    },
                )) => {
                    self.reported((sequence, lost), entries);
                    complete |= self.take_output_part((usize::from(offset), telemetry));
                }
                Some((number, reply)) => self.replied(number, reply)?,
                None => {}
            }
        }
        Ok(complete)
    }

    /// Takes a part of the lead node's output; true if the output is complete.
    fn take_output_part(&mut self, part: (usize, &[u8])) -> bool {
        let complete = Self::join(&mut self.parts, part, &mut self.latest);
        self.outputs += u32::from(complete);
        if let (true, Some(record), Some(latest)) = (complete, &mut self.record, &self.latest) {
            record.lead(latest.tick, &latest.output);
        }
        complete
    }

    fn replied(&mut self, number: u8, reply: Reply) -> Result<(), Error> {
        let Some(Pending { what, .. }) = self.waiting.pop_front_if(|it| it.number == number) else {
            return Ok(());
        };
        if what != Subject::Lease {
            self.outputs = 0;
        }
        match reply {
            Reply::Done => {}
            Reply::Refused(Refusal::Armed) if what == Subject::Record => self.denied = true,
            Reply::Configuration { total, bytes } => self.configured(total, bytes)?,
            Reply::Hello {
                protocol,
                role,
                build,
                counters,
                session,
                ..
            } => {
                self.build = build.to_owned();
                check_hello(self.robot, protocol, (self.role, role), build)?;
                let name = self.name();
                if session {
                    return Err(Error::Failure(format!(
                        "{name} board: it is in a session of another program, which ends after 60 s of silence"
                    )));
                }
                // The board counts requests since its start, so a count below that of the answered requests shows a
                // restart.
                if counters.received < self.answered {
                    return Err(restarted(name));
                }
            }
            other => {
                self.leased |= matches!(other, Reply::Refused(Refusal::Leased));
                return Err(failure(self.name(), what.name(), other));
            }
        }
        self.answered = self.answered.saturating_add(1);
        Ok(())
    }

    /// Appends a part of an output; true if the output is complete. A part out of sequence is dropped, and with it the
    /// rest of its output.
    fn join(
        parts: &mut Vec<u8>,
        (offset, part): (usize, &[u8]),
        latest: &mut Option<Telemetry>,
    ) -> bool {
        if offset == 0 {
            parts.clear();
        }
        if part.is_empty() || offset != parts.len() {
            return false;
        }
        parts.extend_from_slice(part);
        let found = complete(parts);
        let done = found.is_some();
        *latest = found.or(*latest);
        done
    }
}

fn failure(board: &str, what: &str, reply: Reply) -> Error {
    match refused(board, what, reply) {
        Fault::Fatal(error) => error,
        Fault::Silent(why) => Error::Failure(format!("{board} board: {what}: {why}")),
        Fault::Restarted => restarted(board),
    }
}

fn restarted(board: &str) -> Error {
    Error::Failure(format!(
        "{board} board: it was restarted, so its posture and its task are lost: start the run again"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::link::protocol::{CrashRecord, StackUse};
    use core_algos::link::run_link::Station;
    use core_algos::link::{Demand, Identity, RunLink};
    use core_algos::math::Posture;
    use core_algos::node::robot::RobotConfig;
    use host_sim::world::random::{Stream, generator};
    use rand::RngExt;
    use std::sync::LazyLock;

    static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

    /// The line loses one frame in ten in each direction.
    #[test]
    fn orders_over_a_lossy_line_are_executed_once_in_order() {
        let mut random = generator(5, 0, Stream::Other(0));
        let (role, build) = (Role::LEAD, "test");
        let identity = Identity { build, role };
        let mut board = RunLink::new(identity, &CONFIG, StackUse::unknown, CrashRecord::default);
        let mut station = Station::default();
        let mut link = BoardLink::new(Topology::PAIR, role, 7);
        link.open();
        let goal = |k: u16| Task::regulate(Posture::new(k.into(), 0.0, 0.0));
        (0..500).for_each(|k| link.command(&HostCommand::Task(goal(k))));
        let mut executed = Vec::new();
        while !link.is_settled() {
            station.now += 1000;
            let sent = link.to_send(station.now).unwrap().map(<[u8]>::to_vec);
            let Some(sent) = sent.filter(|_| random.random_bool(0.9)) else {
                continue;
            };
            let mut answers = Vec::new();
            let mut answer = |bytes: &[u8]| answers.push(bytes.to_vec());
            if let Some(Demand::Order(_, order)) = board.receive(&sent, &mut station, &mut answer) {
                executed.push(order);
                board.done(Ok(()), &mut answer);
            }
            for answer in answers {
                if random.random_bool(0.9) {
                    link.take(&answer).unwrap();
                }
            }
        }
        let expected: Vec<_> = (0..500).map(|k| Order::Task(goal(k))).collect();
        assert_eq!(executed, expected);
        assert!(station.now > 20 * REPEAT_AFTER_US, "some were lost");
    }
    /// The board's reports arrive, but no request reaches the board, and speed commands are repeated.
    #[test]
    fn speed_commands_without_a_reply_end_with_an_error() {
        let mut link = BoardLink::new(Topology::PAIR, Role::LEAD, 7);
        let speed = HostCommand::Task(Task::Drive {
            speed_m_s: 0.1,
            curvature: 0.0,
        });
        let error = (0..7000).step_by(50).find_map(|ms| {
            link.command(&speed);
            link.to_send(1000 * ms).err().map(|error| (ms, error))
        });
        let (ms, error) = error.unwrap();
        assert_eq!(ms, 5000);
        assert!(error.to_string().contains("speed: no answer"), "{error}");
    }
}
