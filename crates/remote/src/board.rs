//! A board behind a link, as a target of the simulation.
//!
//! The host sends one request at a time and repeats the request until its reply arrives; see [`core_algos::link`].

use crate::link::Link;
use crate::unanswered::Unanswered;
use core_algos::bus::{CanFrame, Message};
use core_algos::link::Stamp;
use core_algos::link::framing::{self, Decoder, MAX_FRAME};
use core_algos::link::protocol::{
    self, CONFIG_CHUNK, CrashRecord, MAX_CONFIG, PROTOCOL, Packed, Placement, Refusal, Reply,
    Request, StackUse, Telemetry,
};
use core_algos::node::board::Samples;
use core_algos::node::lead::step_phase;
use core_algos::node::path_task::{PATH_POINTS, TRAJECTORY_POINTS};
use core_algos::node::robot::RobotConfig;
use core_algos::time::{EPOCH, Micros, TICK};
use core_algos::topology::{Role, Topology, Wheels};
use host_sim::base::error::Error;
use host_sim::targets::boards::fatal;
use host_sim::targets::{
    Fault, HostCommand, Latency, Outgoing, Output, Room, Target, TargetReport, Traffic,
};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Time after which a request is repeated; much longer than any reply takes.
const REPEAT_AFTER: Duration = Duration::from_millis(250);
/// Number of times that a request is sent before the board counts as lost.
const ATTEMPTS: u32 = 40;
/// Number of times that a request is sent where a user waits; the attempts take 1.5 s in total.
const INTERACTIVE_ATTEMPTS: u32 = 6;
/// Limit of the number of late replies to earlier requests that are skipped after a hello.
const MAX_STALE_REPLIES: u32 = 4;

/// A board at the other end of a link.
pub struct Remote {
    robot: Topology,
    role: Role,
    pub(super) name: &'static str,
    pub(super) channel: RequestChannel,
    bus: Packed,
    /// Bus frames of the next tick that its request does not hold.
    ahead: Vec<Packed>,
    build: String,
    room: Room,
    /// Parts of the lead node's output received so far.
    telemetry: Vec<u8>,
    tick: u32,
    tick_bytes: [u64; 2],
    latencies: Vec<u32>,
}

impl Remote {
    /// A board at the end of `link`; sends nothing yet.
    pub fn new(robot: Topology, role: Role, link: Box<dyn Link>) -> Self {
        Self {
            robot,
            role,
            name: robot.name(role),
            channel: RequestChannel::new(link),
            bus: Packed::new(),
            ahead: Vec::new(),
            build: String::new(),
            room: EMPTY,
            telemetry: Vec::new(),
            tick: 0,
            tick_bytes: [0; 2],
            latencies: Vec::new(),
        }
    }

    /// Shortens the wait for replies where a user waits; a running board replies within milliseconds.
    pub fn shorten_wait(&mut self) {
        self.channel.attempts = INTERACTIVE_ATTEMPTS;
    }

    /// Starts a session; a driving board resets first. Checks the board's role and protocol.
    pub(super) fn open_session(&mut self) -> Result<(), Fault> {
        self.change_session("a session", true, &Request::Rig)
    }

    /// Ends a session that an earlier host has left open, because a board in a session does not relay.
    pub(super) fn close_earlier_session(&mut self) -> Result<(), Fault> {
        self.change_session("the end of its session", false, &Request::EndSession)
    }

    /// Repeats the request until the board is in a session (`open`) or in none; an error after four attempts.
    fn change_session(&mut self, what: &str, open: bool, request: &Request) -> Result<(), Fault> {
        for _ in 0..MAX_STALE_REPLIES {
            if self.exchange_hello()? == open {
                return Ok(());
            }
            self.channel.send_request(request)?;
            match self.channel.receive_reply()? {
                // If the reply was lost, the board has already reset.
                Reply::Done | Reply::Refused(Refusal::NoSession) => {}
                other => return Err(refused(self.name, what, other)),
            }
        }
        Err(unexpected(self.name, what))
    }

    /// Ends a session that an earlier host has left open; parameters changed in the session but not saved are lost.
    pub fn end_earlier_session(&mut self) -> Result<(), Error> {
        let name = self.name;
        self.close_earlier_session()
            .map_err(|fault| fatal(name, fault))
    }

    /// Ends the session and waits for the reply.
    pub fn end_session(mut self) -> Result<(), Error> {
        let name = self.name;
        let left = self.execute("the end of the session", &Request::EndSession);
        self.build.clear();
        match left {
            // If the reply was lost, the board has already reset.
            Ok(()) | Err(Fault::Restarted) => Ok(()),
            Err(fault) => Err(fatal(name, fault)),
        }
    }

    /// Crash record of a board that drives.
    pub fn crash_record(&mut self) -> Result<CrashRecord, Error> {
        let name = self.name;
        self.request_crash_record()
            .map_err(|fault| fatal(name, fault))
    }

    fn request_crash_record(&mut self) -> Result<CrashRecord, Fault> {
        self.close_earlier_session()?;
        self.channel.send_request(&Request::Crash)?;
        match self.channel.receive_reply()? {
            Reply::Crash { counts, message } => Ok(CrashRecord {
                counts,
                message: message.try_into().unwrap_or_default(),
            }),
            other => Err(refused(self.name, "its crash record", other)),
        }
    }

    /// Link to the board.
    pub(super) fn link(&mut self) -> &mut dyn Link {
        self.channel.link.as_mut()
    }

    /// Sends a hello; true if the board is in a session.
    fn exchange_hello(&mut self) -> Result<bool, Fault> {
        static NONCE: AtomicU32 = AtomicU32::new(1);
        let sent = NONCE.fetch_add(1, Relaxed);
        let request = Request::Hello {
            protocol: PROTOCOL,
            nonce: sent,
        };
        // A reply to an earlier request may still arrive.
        for _ in 0..MAX_STALE_REPLIES {
            self.channel.send_request(&request)?;
            let Reply::Hello {
                protocol,
                nonce,
                role,
                build,
                session,
                ..
            } = self.channel.receive_reply()?
            else {
                continue;
            };
            if nonce != sent {
                continue;
            }
            check_hello(self.robot, protocol, (self.role, role), build).map_err(Fault::Fatal)?;
            self.build = build.to_owned();
            return Ok(session);
        }
        Err(unexpected(self.name, "hello"))
    }

    /// Sends the parameters; returns their checksum as the board computed it.
    fn configure(&mut self, config: &RobotConfig) -> Result<u32, Fault> {
        let mut buffer = [0; MAX_CONFIG];
        let bytes = postcard::to_slice(config, &mut buffer)
            .map_err(|error| Error::Failure(format!("parameters: {error}")))?;
        let mut found = 0;
        for (k, part) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            self.channel.send_request(&Request::Configure {
                total: bytes.len() as u16,
                offset: (k * CONFIG_CHUNK) as u16,
                bytes: part,
            })?;
            match self.channel.receive_reply()? {
                Reply::Configured { hash } => found = hash,
                other => return Err(refused(self.name, "parameters", other)),
            }
        }
        let hash = framing::crc32c(bytes);
        if found != hash {
            return Err(Fault::Fatal(Error::Failure(format!(
                "{} board: checksum of the parameters is {found:08x} on the board, {hash:08x} in this program",
                self.name
            ))));
        }
        Ok(hash)
    }

    pub(super) fn execute(&mut self, what: &str, request: &Request) -> Result<(), Fault> {
        self.channel.send_request(request)?;
        match self.channel.receive_reply()? {
            Reply::Done => Ok(()),
            other => Err(refused(self.name, what, other)),
        }
    }
}

const EMPTY: Room = Room {
    path: PATH_POINTS,
    trajectory: TRAJECTORY_POINTS,
};

/// Rejects a board with another protocol or another role.
pub(super) fn check_hello(
    robot: Topology,
    protocol: u16,
    (wanted, role): (Role, Role),
    build: &str,
) -> Result<(), Error> {
    let name = robot.name(wanted);
    if protocol != PROTOCOL {
        return Err(Error::input(format!(
            "{name} board: its image ({build}) has protocol version {protocol}, this program version {PROTOCOL}: \
             flash the image of this version"
        )));
    }
    if role != wanted {
        return Err(Error::input(format!(
            "--on serial:{name}: the {name} board's port leads to the {} board: check ports, strap and board.place",
            robot.name(role)
        )));
    }
    Ok(())
}

fn unexpected(board: &str, what: &str) -> Fault {
    Fault::Fatal(Error::Failure(format!(
        "{board} board: {what}: unexpected answer"
    )))
}

pub(super) fn refused(board: &str, what: &str, reply: Reply) -> Fault {
    let reason = match reply {
        Reply::Refused(Refusal::NoSession | Refusal::NotStarted) => return Fault::Restarted,
        Reply::Refused(Refusal::Point(error)) => {
            return Fault::Fatal(Error::input(format!("{what}: {error}")));
        }
        Reply::Refused(Refusal::Parameter { text }) => text.to_owned(),
        Reply::Refused(Refusal::Armed) => {
            return Fault::Fatal(Error::input(format!(
                "{board} board refuses {what}: its motors may be on; stop the robot first"
            )));
        }
        Reply::Refused(Refusal::Leased) => {
            "another program commands the robot, or did so a second ago".to_owned()
        }
        Reply::Refused(Refusal::NotSaved) => "writing its flash failed".to_owned(),
        Reply::Refused(Refusal::Hash { found }) => {
            format!("the board received parameters with checksum {found:08x}")
        }
        Reply::Refused(reason) => format!("{reason:?}"),
        _ => return unexpected(board, what),
    };
    Fault::Fatal(Error::Failure(format!(
        "{board} board refuses {what}: {reason}"
    )))
}

impl Drop for Remote {
    /// Ends the session without waiting for the reply. If the request is lost, the board ends the session after its
    /// timeout.
    fn drop(&mut self) {
        if !self.build.is_empty() {
            let _ = self.channel.send_request(&Request::EndSession);
        }
    }
}

impl Target for Remote {
    fn start(
        &mut self,
        config: &RobotConfig,
        tick: u32,
        place: Option<&Placement>,
    ) -> Result<(), Fault> {
        self.open_session()?;
        let hash = self.configure(config)?;
        let start = Request::Start {
            hash,
            tick,
            place: place.copied(),
        };
        self.execute("start", &start)?;
        self.room = EMPTY;
        self.telemetry.clear();
        self.bus = Packed::new();
        self.ahead.clear();
        Ok(())
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Fault> {
        for order in command.orders() {
            // A session has one host, so orders need no stamp.
            let stamp = Stamp::default();
            self.execute(command.subject(), &Request::Order { stamp, order })?;
        }
        match command {
            HostCommand::Path { points, .. } => {
                self.room.path = self.room.path.saturating_sub(points.len());
            }
            HostCommand::Trajectory { points, .. } => {
                self.room.trajectory = self.room.trajectory.saturating_sub(points.len());
            }
            HostCommand::Task(_) | HostCommand::SetPose(_) | HostCommand::Lost => {}
        }
        Ok(())
    }

    fn room(&mut self) -> Room {
        self.room
    }

    fn receive(&mut self, _now: Micros, frame: &CanFrame, _message: &Message) {
        // A beam board takes no bus frames.
        if !self.role.is_beam() && !self.bus.push(frame) {
            let full = std::mem::take(&mut self.bus);
            self.ahead.push(full);
            self.bus.push(frame);
        }
    }

    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault> {
        let bus = std::mem::take(&mut self.bus);
        for frames in std::mem::take(&mut self.ahead) {
            let bus = frames.bytes();
            self.execute("bus frames", &Request::Frames { tick, bus })?;
        }
        self.tick = tick;
        let request = match *samples {
            Samples::Axle(samples) => Request::Axle {
                tick,
                samples,
                bus: bus.bytes(),
            },
            Samples::Beam(samples) => Request::Beam { tick, samples },
        };
        self.tick_bytes[0] += self.channel.send_request(&request)? as u64;
        Ok(())
    }

    fn finish(&mut self, send: &mut dyn FnMut(Outgoing)) -> Result<Output, Fault> {
        let reply = self.channel.receive_reply()?;
        let (torque_nm, bus, telemetry) = match reply {
            Reply::Axle {
                torque_nm,
                bus,
                telemetry,
                ..
            } => (torque_nm, bus, telemetry),
            Reply::Beam { bus, .. } => (Wheels::default(), bus, [].as_slice()),
            other => return Err(refused(self.name, "tick", other)),
        };
        for frame in protocol::unpack(bus) {
            send(Outgoing::Frame(&frame));
        }
        if Micros::from(self.tick) * TICK % EPOCH == step_phase(self.robot) {
            self.telemetry.clear();
        }
        self.telemetry.extend_from_slice(telemetry);
        let lead = match complete(&self.telemetry) {
            Some(latest) if !telemetry.is_empty() => {
                self.room = Room {
                    path: latest.path_room.into(),
                    trajectory: latest.trajectory_room.into(),
                };
                Some(latest.output)
            }
            _ => None,
        };
        self.latencies.push(self.channel.latency_us);
        self.tick_bytes[1] += self.channel.reply_bytes;
        Ok(Output { torque_nm, lead })
    }

    fn resume(&mut self, tick: u32) -> Result<(), Fault> {
        self.execute("its next tick", &Request::Resume { tick })
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        self.channel.link.halt(halted)
    }

    fn crash(&mut self) -> Result<(), Error> {
        self.channel.link.crash()
    }

    fn stack(&mut self) -> Option<StackUse> {
        self.channel.send_request(&Request::Stack).ok()?;
        match self.channel.receive_reply().ok()? {
            Reply::Stack(stack) if stack.size_bytes > 0 => Some(stack),
            _ => None,
        }
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.channel.link.switch_off()
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        self.channel.link.switch_on()
    }

    fn traffic(&self) -> Option<Traffic> {
        let counters = self.channel.decoder.counters();
        Some(Traffic {
            frames: counters.received.into(),
            lost: self.channel.repeated,
            damaged: counters.damaged.into(),
        })
    }

    fn report(&self) -> TargetReport {
        let traffic = self.traffic().unwrap_or_default();
        let ticks = self.latencies.len().max(1) as f64;
        TargetReport {
            role: self.name,
            target: self.channel.link.name(),
            build: self.build.clone(),
            frames: traffic.frames,
            lost: traffic.lost,
            damaged: traffic.damaged,
            sent_per_tick: self.tick_bytes[0] as f64 / ticks,
            received_per_tick: self.tick_bytes[1] as f64 / ticks,
            latency: Latency::of(&self.latencies),
            stack: None,
        }
    }
}

/// Output of the lead node; `None` while parts of the output are missing.
pub(super) fn complete(telemetry: &[u8]) -> Option<Telemetry> {
    let (length, bytes) = telemetry.split_first_chunk()?;
    let all = usize::from(u16::from_le_bytes(*length)) == bytes.len();
    all.then(|| postcard::from_bytes(bytes).ok()).flatten()
}

/// Requests and replies over a link.
pub(super) struct RequestChannel {
    link: Box<dyn Link>,
    decoder: Decoder,
    number: u8,
    sent_frame: framing::SerialFrame,
    sent_at: Instant,
    payload: Vec<u8>,
    repeated: u64,
    latency_us: u32,
    reply_bytes: u64,
    /// Bytes received since the latest request.
    unmatched: Unanswered,
    /// Number of times that a request is sent before the board counts as lost.
    attempts: u32,
    /// True if the latest request is a hello.
    is_hello: bool,
}

impl RequestChannel {
    fn new(link: Box<dyn Link>) -> Self {
        Self {
            link,
            decoder: Decoder::new(),
            number: 0,
            sent_frame: framing::SerialFrame::default(),
            sent_at: Instant::now(),
            payload: Vec::new(),
            repeated: 0,
            latency_us: 0,
            reply_bytes: 0,
            unmatched: Unanswered::default(),
            attempts: ATTEMPTS,
            is_hello: false,
        }
    }

    /// Sends a request with the next request number; returns the number of bytes sent.
    pub(super) fn send_request(&mut self, request: &Request) -> Result<usize, Fault> {
        self.number = self.number.wrapping_add(1);
        self.sent_frame = protocol::encode(self.number, request)
            .ok_or_else(|| Error::Failure(format!("request too long: {request:?}")))?;
        // A hello starts with frame delimiters, so that an unfinished earlier frame does not spoil the hello.
        self.is_hello = matches!(request, Request::Hello { .. });
        let bytes = match self.is_hello {
            true => self.sent_frame.repeated(),
            false => self.sent_frame.bytes(),
        };
        self.sent_at = Instant::now();
        self.link.send(bytes).map_err(link_fault)?;
        Ok(bytes.len())
    }

    /// Waits for the reply to the latest request and repeats the request as needed. An error if no reply arrives or if
    /// the link echoes the hello.
    pub(super) fn receive_reply(&mut self) -> Result<Reply<'_>, Fault> {
        self.reply_bytes = 0;
        self.unmatched = Unanswered::to(self.sent_frame.bytes());
        for attempt in 0..self.attempts {
            if attempt > 0 {
                self.repeated += 1;
                self.link
                    .send(self.sent_frame.repeated())
                    .map_err(link_fault)?;
            }
            let deadline = Instant::now() + REPEAT_AFTER;
            if self.await_reply(deadline)? {
                // Only a hello is checked for an echo, because a correct reply to another request may equal that
                // request.
                if self.is_hello && self.unmatched.is_echo() {
                    return Err(Fault::Silent(self.unmatched.to_string()));
                }
                self.latency_us = self.sent_at.elapsed().as_micros() as u32;
                let (_, reply) = protocol::decode(&self.payload).ok_or_else(|| {
                    Error::Failure(
                        "a board sent an answer that does not decode in this version".to_owned(),
                    )
                })?;
                return Ok(reply);
            }
        }
        let timeout = REPEAT_AFTER * self.attempts;
        let arrived = &self.unmatched;
        Err(Fault::Silent(format!(
            "no answer in {timeout:?}: {arrived}"
        )))
    }

    /// Waits for the reply until `deadline`; false if no reply arrives.
    fn await_reply(&mut self, deadline: Instant) -> Result<bool, Fault> {
        let mut buffer = [0; 2 * MAX_FRAME];
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let count = self.link.receive(&mut buffer, left).map_err(link_fault)?;
            self.unmatched.add(buffer.get(..count).unwrap_or_default());
            let mut found = false;
            for &byte in buffer.get(..count).unwrap_or_default() {
                if let Some(payload) = self.decoder.take_byte(byte)
                    && payload.first() == Some(&self.number)
                {
                    self.payload.clear();
                    self.payload.extend_from_slice(payload);
                    found = true;
                }
            }
            self.reply_bytes += count as u64;
            if found || count == 0 {
                return Ok(found);
            }
        }
    }
}

fn link_fault(error: std::io::Error) -> Fault {
    use std::io::ErrorKind::{BrokenPipe, Other, UnexpectedEof};
    match error.kind() {
        UnexpectedEof | BrokenPipe => Fault::Silent("the board closed the link".to_owned()),
        // A virtual board reports a finding of its program or a failure of the simulation as `Other`.
        Other => Fault::Fatal(Error::Failure(error.to_string())),
        _ => Fault::Silent(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::io;

    /// A device that sends these bytes and then nothing.
    struct Device(VecDeque<u8>);

    impl Link for Device {
        fn name(&self) -> &'static str {
            "device"
        }

        fn send(&mut self, _bytes: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
            let bytes = self.0.pop_front().into_iter();
            Ok(buffer
                .iter_mut()
                .zip(bytes)
                .map(|(to, from)| *to = from)
                .count())
        }
    }

    /// A port whose TX is connected to its RX.
    struct Loop(VecDeque<u8>);

    impl Link for Loop {
        fn name(&self) -> &'static str {
            "loop"
        }

        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.0.extend(bytes);
            Ok(())
        }

        fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
            io::Read::read(&mut self.0, buffer)
        }
    }

    #[test]
    fn echoing_port_is_reported() {
        let mut remote = Remote::new(Topology::PAIR, Role::LEAD, Box::new(Loop(VecDeque::new())));
        let Err(error) = remote.crash_record() else {
            panic!("an echo answers");
        };
        assert!(
            error.to_string().contains("TX is connected to its RX"),
            "{error}"
        );
    }

    #[test]
    fn silence_and_foreign_bytes_are_reported_differently() {
        for (received, expected) in [
            (&b""[..], "nothing arrived"),
            (
                &b"AT OK"[..],
                "5 bytes arrived that are not an answer, the first is 0x41",
            ),
        ] {
            let device = Device(received.iter().copied().collect());
            let mut channel = RequestChannel::new(Box::new(device));
            for _ in 0..=received.len() {
                assert!(!channel.await_reply(Instant::now()).unwrap());
            }
            assert!(channel.unmatched.to_string().starts_with(expected));
        }
    }
}
