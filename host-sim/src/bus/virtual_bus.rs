//! Virtual CAN bus: messages pass as bytes, arrive late and may be lost.

use crate::base::table::table;
use core_algos::bus::{self, CanFrame, Message, layout};
use core_algos::node::lead;
use core_algos::time::Micros;
use core_algos::topology::{MAX_AXLES, MAX_BOARDS, Role, Topology};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::LazyLock;

table! {
    /// True if frames take time on the wire.
    pub enum Transmission, default Auto {
        /// On for more than two axles, whose reports fill an epoch.
        Auto = "auto",
        /// Frames take their bits at 1 Mbit/s, one frame after another in the order of their priorities.
        On = "on",
        /// Frames take no time, and `latency_ms` stands for the transfer.
        Off = "off",
    }
}

table! {
    /// Properties of the virtual bus.
    pub struct BusConfig {
        /// Time from sending to receiving. Arbitration and transfer of the thirteen messages at the
        /// beginning of an epoch take up to 1.7 ms at 1 Mbit/s. With `transmission`, the least time.
        pub latency_ms: u32 = 2, "ms": Range(0.0, 1000.0);
        /// Additional latency of each board's messages at the other boards: one entry for all boards, or one per board,
        /// axles first.
        pub late_ms: Vec<u32> = vec![0; 3], "ms": Range(0.0, 1000.0);
        /// Largest additional latency of a message at the other boards, drawn uniformly; messages may
        /// overtake each other.
        pub jitter_ms: u32 = 0, "ms": Range(0.0, 1000.0);
        /// Probability that a frame is lost on its way to another board, drawn for each board. The lead node
        /// and the front axle share a board and lose nothing between them.
        pub loss: f64 = 0.0, "": Range(0.0, 1.0);
        /// Probability that a frame arrives twice at the other boards.
        pub doubling: f64 = 0.0, "": Range(0.0, 1.0);
        /// Probability that one to three bits of a frame change on the way to the other boards, undetected
        /// by the checksum.
        pub corruption: f64 = 0.0, "": Range(0.0, 1.0);
        /// True if messages arrive as decoded from their bytes. False leaves out the quantisation, to
        /// measure its effect; no real bus can do that.
        pub quantise: bool = true;
        /// Time of the frames on the wire.
        pub transmission: Transmission = Transmission::Auto;
    }
}

impl BusConfig {
    /// True if the list of latencies fits the boards of `robot`.
    pub fn fits(&self, robot: Topology) -> bool {
        let late = &self.late_ms;
        // The default list has three zeros, for a robot of any number of axles.
        let none = !late.is_empty() && late.iter().all(|late| *late == 0);
        none || [1, robot.board_count()].contains(&late.len())
    }

    /// True if frames take time on the wire.
    fn has_wire(&self, robot: Topology) -> bool {
        match self.transmission {
            Transmission::Auto => robot.axle_count() > 2,
            Transmission::On => true,
            Transmission::Off => false,
        }
    }

    /// Additional latency of a board at an index of [`Topology::boards`], ms.
    fn late_ms_at(&self, place: usize) -> u32 {
        match self.late_ms.as_slice() {
            [all] => *all,
            boards => boards.get(place).copied().unwrap_or(0),
        }
    }
}

/// Numbers of messages on the bus since the start of the run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BusStatistics {
    /// Number of messages sent.
    pub sent: u64,
    /// Messages lost between boards, counted once for each receiving board; on a cut bus, once for each message.
    pub lost: u64,
    /// Messages that could not be encoded, and frames that could not be decoded.
    pub refused: u64,
    /// Reports of the boards that the transfer delays beyond the beginning of the lead node's work; 0 without
    /// transmission time.
    #[serde(skip_serializing_if = "is_none")]
    pub late: u64,
    /// Time for which the wire was busy, µs; 0 without transmission time.
    #[serde(skip_serializing_if = "is_none")]
    pub busy_us: u64,
}

fn is_none(count: &u64) -> bool {
    *count == 0
}

/// A frame that waits for the wire.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// Time at which the board sent the frame.
    since: Micros,
    origin: Option<Role>,
    transit: Transit,
}

/// The wire: one frame at a time, the lowest identifier of the waiting frames first.
#[derive(Clone, Debug, Default)]
struct Wire {
    waiting: Vec<Waiting>,
    /// Time at which the wire becomes free.
    free: Micros,
}

impl Wire {
    /// The next frame that begins before `now`, with the end of its transfer.
    fn next(&mut self, now: Micros) -> Option<(Waiting, Micros)> {
        let earliest = self.waiting.iter().map(|frame| frame.since).min()?;
        let begin = self.free.max(earliest);
        if begin >= now {
            return None;
        }
        let ready = self.waiting.iter().enumerate();
        let ready = ready.filter(|(_, frame)| frame.since <= begin);
        let (first, _) = ready.min_by_key(|(_, frame)| (frame.transit.frame.id, frame.since))?;
        let frame = self.waiting.remove(first);
        self.free = begin + transfer_us(&frame.transit.frame);
        Some((frame, self.free))
    }
}

/// Bits of a frame on the wire with identifier, data, checksum, stuff bits and the space to the next frame.
fn wire_bits(frame: &CanFrame) -> u32 {
    let length = frame.length.min(8);
    // Start bit, identifier, three zero control bits and the length; the checksum covers these and the data.
    let head = u32::from(frame.id & 0x7ff) << 7 | u32::from(length);
    let mut bits: Vec<bool> = (0..19).rev().map(|k| head >> k & 1 == 1).collect();
    for byte in frame.data.iter().take(length.into()) {
        bits.extend((0..8).rev().map(|k| byte >> k & 1 == 1));
    }
    let checksum = bits.iter().fold(0_u16, |sum, bit| {
        let next = *bit != (sum >> 14 & 1 == 1);
        let shifted = sum << 1 & 0x7fff;
        if next { shifted ^ 0x4599 } else { shifted }
    });
    bits.extend((0..15).rev().map(|k| checksum >> k & 1 == 1));
    let (mut stuffed, mut run, mut last) = (0, 0, None);
    for bit in bits.iter().copied() {
        run = if last == Some(bit) { run + 1 } else { 1 };
        last = Some(bit);
        if run == 5 {
            // The stuff bit has the other level and begins a run.
            (stuffed, run, last) = (stuffed + 1, 1, Some(!bit));
        }
    }
    // Two delimiters, acknowledgement, seven bits of end and three of space.
    bits.len() as u32 + stuffed + 13
}

/// Time of a frame on the wire, µs.
fn transfer_us(frame: &CanFrame) -> Micros {
    const PER_SECOND: u64 = 1_000_000;
    (u64::from(wire_bits(frame)) * PER_SECOND).div_ceil(layout::BIT_RATE.into())
}

#[derive(Clone, Copy, Debug)]
struct Transit {
    due: Micros,
    frame: CanFrame,
    message: Message,
    /// For each board, true if the frame reaches the board.
    received: [bool; MAX_BOARDS],
}

/// The bus between the boards.
#[derive(Clone, Debug)]
pub struct VirtualBus {
    topology: Topology,
    config: BusConfig,
    rng: Pcg64,
    transit: VecDeque<Transit>,
    /// Frames on the wire and before it; `None` without transmission time.
    wire: Option<Wire>,
    statistics: BusStatistics,
    severed: bool,
}

impl VirtualBus {
    /// Bus whose random draws are seeded by `seed`.
    pub fn new(topology: Topology, config: &BusConfig, seed: u64) -> Self {
        Self {
            topology,
            config: config.clone(),
            rng: Pcg64::seed_from_u64(seed),
            transit: VecDeque::with_capacity(64),
            wire: config.has_wire(topology).then(Wire::default),
            statistics: BusStatistics::default(),
            severed: false,
        }
    }

    /// Sends a message at `now`, encoded and decoded as between real boards. Gives the frame on the bus; `None` if
    /// the message is refused or the bus is cut.
    pub fn send(&mut self, now: Micros, message: &Message) -> Option<CanFrame> {
        match bus::encode(message) {
            Ok(frame) if self.config.quantise => self.send_frame(now, &frame),
            Ok(frame) => self.transmit(now, &frame, *message),
            Err(_) => {
                self.statistics.sent += 1;
                self.statistics.refused += 1;
                None
            }
        }
    }

    /// Sends a frame that a board has encoded. Gives the frame on the bus; `None` if the frame is refused or the bus is
    /// cut.
    pub fn send_frame(&mut self, now: Micros, frame: &CanFrame) -> Option<CanFrame> {
        match bus::decode(frame) {
            Ok(message) => self.transmit(now, frame, message),
            Err(_) => {
                self.statistics.sent += 1;
                self.statistics.refused += 1;
                None
            }
        }
    }

    fn transmit(&mut self, now: Micros, frame: &CanFrame, message: Message) -> Option<CanFrame> {
        self.statistics.sent += 1;
        if self.severed {
            self.statistics.lost += 1;
            return None;
        }
        let origin = sender(self.topology, frame);
        let mut received = [false; MAX_BOARDS];
        for (received, board) in received.iter_mut().zip(self.topology.boards()) {
            let lost = Some(board) != origin && self.happens(self.config.loss);
            self.statistics.lost += u64::from(lost);
            *received = !lost;
        }
        let transit = Transit {
            due: now + Micros::from(self.config.latency_ms) * 1_000,
            frame: *frame,
            message,
            received,
        };
        if self.wire.is_some() {
            let others = self.within_board(transit, origin);
            if let Some(wire) = &mut self.wire {
                wire.waiting.push(Waiting {
                    since: now,
                    origin,
                    transit: others,
                });
            }
            return Some(*frame);
        }
        self.pass(transit, origin);
        Some(*frame)
    }

    /// Queues a frame of a board, disturbed as configured.
    fn pass(&mut self, transit: Transit, origin: Option<Role>) {
        let config = &self.config;
        let uneven = config.jitter_ms > 0 || config.late_ms.iter().any(|&late| late > 0);
        match uneven || config.doubling > 0.0 || config.corruption > 0.0 {
            true => self.queue_disturbed(transit, origin),
            false => self.queue(transit),
        }
    }

    /// Transfers the frames whose turn on the wire comes before `now`.
    fn transfer(&mut self, now: Micros) {
        while let Some((frame, end)) = self.wire.as_mut().and_then(|wire| wire.next(now)) {
            let Waiting {
                since,
                origin,
                mut transit,
            } = frame;
            self.statistics.busy_us += transfer_us(&transit.frame);
            let begin = lead::begin_phase(self.topology);
            let is_report = matches!(
                transit.message,
                Message::AxlePosture { .. }
                    | Message::AxleMotion { .. }
                    | Message::AxleUncertainty { .. }
                    | Message::BeamPosture { .. }
                    | Message::BeamUncertainty { .. }
            );
            let is_far = is_report && origin != Some(Role::LEAD);
            self.statistics.late += u64::from(is_far && end > since + begin);
            transit.due = transit.due.max(end);
            self.pass(transit, origin);
        }
    }

    /// True with the probability `share`.
    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && self.rng.random::<f64>() < share
    }

    /// Queues the part of a frame that stays within the sending board, undisturbed; gives the part for the other boards.
    fn within_board(&mut self, mut transit: Transit, origin: Option<Role>) -> Transit {
        let mut own = transit;
        for (place, board) in self.topology.boards().enumerate() {
            own.received[place] &= Some(board) == origin;
            transit.received[place] &= Some(board) != origin;
        }
        self.queue(own);
        transit
    }

    /// Queues a frame with additional latency, jitter, corruption or doubling as configured.
    fn queue_disturbed(&mut self, transit: Transit, origin: Option<Role>) {
        let mut transit = self.within_board(transit, origin);
        let place = origin.map(|board| self.topology.place(board));
        let mut late = place.map_or(0, |place| self.config.late_ms_at(place));
        if self.config.jitter_ms > 0 {
            late += self.rng.random_range(0..=self.config.jitter_ms);
        }
        transit.due += Micros::from(late) * 1_000;
        if self.happens(self.config.corruption) {
            let bits = 8 * usize::from(transit.frame.length.max(1));
            for _ in 0..self.rng.random_range(1..=3) {
                let bit = self.rng.random_range(0..bits);
                transit.frame.data[bit / 8] ^= 1 << (bit % 8);
            }
            let Ok(message) = bus::decode(&transit.frame) else {
                self.statistics.refused += 1;
                return;
            };
            transit.message = message;
        }
        if self.happens(self.config.doubling) {
            self.queue(transit);
        }
        self.queue(transit);
    }

    /// Queues a frame in order of arrival; frames of equal arrival time keep their order of sending.
    fn queue(&mut self, transit: Transit) {
        let place = self
            .transit
            .partition_point(|other| other.due <= transit.due);
        self.transit.insert(place, transit);
    }

    /// Replaces the properties of the bus.
    pub fn set_config(&mut self, config: &BusConfig) {
        self.config.clone_from(config);
        if !config.has_wire(self.topology) {
            self.transfer(Micros::MAX);
            self.wire = None;
        } else if self.wire.is_none() {
            self.wire = Some(Wire::default());
        }
    }

    /// Hands every message that has arrived by `now` to `receive`, once for each board it reaches.
    pub fn deliver(&mut self, now: Micros, mut receive: impl FnMut(Role, &CanFrame, &Message)) {
        self.transfer(now);
        while self.transit.front().is_some_and(|first| first.due <= now) {
            if let Some(transit) = self.transit.pop_front() {
                let boards = self.topology.boards().zip(transit.received);
                for (board, _) in boards.filter(|(_, reached)| *reached) {
                    receive(board, &transit.frame, &transit.message);
                }
            }
        }
    }

    /// Cuts the bus: all messages are lost, also messages under way and messages within a board.
    pub fn cut(&mut self) {
        self.severed = true;
        self.transit.clear();
        if let Some(wire) = &mut self.wire {
            wire.waiting.clear();
        }
    }

    /// Numbers of messages on the bus since the start of the run.
    pub fn statistics(&self) -> BusStatistics {
        self.statistics
    }
}

/// Board that sends a frame; `None` for a service tool and for a board that the robot does not have.
pub fn sender(topology: Topology, frame: &CanFrame) -> Option<Role> {
    let board = layout::sender(frame.id)?.board()?;
    topology.has(board).then_some(board)
}

/// Name of the message with this identifier in the bus description; `None` for an unknown identifier.
pub fn name_of(topology: Topology, id: u16) -> Option<&'static str> {
    /// Identifiers and names of the messages; the index is the number of axles.
    static NAMES: LazyLock<Vec<Vec<(u16, String)>>> = LazyLock::new(|| {
        let robots = (0..=MAX_AXLES).map(Topology::new);
        let names = |robot| layout::messages(robot).map(|of| (of.id, of.to_string()));
        let names = robots.map(|robot| robot.into_iter().flat_map(names).collect());
        names.collect()
    });
    let names = &NAMES[topology.axle_count()];
    let place = names.binary_search_by_key(&id, |(of, _)| *of).ok()?;
    Some(&names[place].1)
}

/// True for a frame of a node; false for frames of drivers and clock, and frames that cannot be decoded.
pub fn is_of_nodes(frame: &CanFrame) -> bool {
    !matches!(
        bus::decode(frame),
        Err(_)
            | Ok(Message::TimeSync { .. }
                | Message::BoardHealth { .. }
                | Message::BoardIdentity { .. }
                | Message::BeamCalibrated { .. })
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::bus::LeadMode;
    use core_algos::math::Posture;
    use core_algos::time::LEAD_PHASE;
    use core_algos::topology::AxleId;

    fn status(sequence: u8) -> Message {
        Message::LeadStatus {
            sequence,
            mode: LeadMode::Active,
            steering_rad: 0.0,
            velocity_m_s: 0.0,
        }
    }

    #[test]
    fn late_board_delays_other_boards_and_not_itself() {
        let config = BusConfig {
            latency_ms: 1,
            late_ms: vec![4, 0, 0],
            ..BusConfig::default()
        };
        let mut bus = VirtualBus::new(Topology::PAIR, &config, 0);
        let status = |velocity_m_s| Message::LeadStatus {
            sequence: 0,
            mode: LeadMode::Active,
            steering_rad: 0.0,
            velocity_m_s,
        };
        bus.send(0, &status(0.5));
        let mut arrivals = Vec::new();
        for now in (0..10).map(|ms| ms * 1_000) {
            bus.deliver(now, |board, _, _| arrivals.push((now, board)));
        }
        let late = [Role::axle(1), Role::beam(0)].map(|board| (5_000, board));
        assert_eq!(arrivals, [(1_000, Role::LEAD), late[0], late[1]]);
    }

    #[test]
    fn frames_of_three_axles_reach_five_boards_with_latency_of_sender() {
        let config = BusConfig {
            latency_ms: 1,
            late_ms: vec![0, 4, 0, 0, 0],
            transmission: Transmission::Off,
            ..BusConfig::default()
        };
        let robot = Topology::new(3).unwrap();
        let mut bus = VirtualBus::new(robot, &config, 0);
        for axle in robot.axles() {
            let posture = Message::AxlePosture {
                axle,
                sequence: 0,
                posture: Posture::ORIGIN,
            };
            bus.send(0, &posture);
        }
        let mut at = |time| {
            let mut delivered = Vec::new();
            bus.deliver(time, |board, frame, _| {
                delivered.push((sender(robot, frame).unwrap(), board));
            });
            delivered
        };
        // A board receives its own frames first.
        let others = |from: Role| robot.boards().filter(move |board| *board != from);
        let to = |from: Role| others(from).map(move |board| (from, board));
        let [front, inner, rear] = [0, 1, 2].map(Role::axle);
        let mut on_time = vec![(front, front)];
        on_time.extend(to(front));
        on_time.extend([(inner, inner), (rear, rear)]);
        on_time.extend(to(rear));
        assert_eq!(at(1_000), on_time);
        assert_eq!(at(5_000), to(inner).collect::<Vec<_>>());
    }

    /// Lengths of frames whose stuff bits are counted by hand: zeros have one in five.
    #[test]
    fn frame_has_its_bits_and_its_stuff_bits() {
        let frame = |id, data: &[u8]| {
            let mut frame = CanFrame {
                id,
                length: data.len() as u8,
                data: [0; 8],
            };
            frame.data[..data.len()].copy_from_slice(data);
            frame
        };
        // Identifier 0 without data: 34 zero bits, since the checksum of zeros is zero; a stuff bit after each five.
        assert_eq!(wire_bits(&frame(0, &[])), 47 + 34 / 5);
        for length in 0..=8_u8 {
            for pattern in [0x00, 0x55, 0xff, 0x1f] {
                let bits = wire_bits(&frame(0x2aa, &vec![pattern; length.into()]));
                let least = 47 + 8 * u32::from(length);
                assert!(
                    (least..=layout::frame_bits(length)).contains(&bits),
                    "{bits}"
                );
            }
        }
    }

    /// Three frames sent together leave in the order of their identifiers, one after the other.
    #[test]
    fn frames_take_their_turns_on_the_wire_by_priority() {
        let config = BusConfig {
            latency_ms: 0,
            transmission: Transmission::On,
            ..BusConfig::default()
        };
        let robot = Topology::PAIR;
        let mut bus = VirtualBus::new(robot, &config, 0);
        let posture = |axle| Message::AxlePosture {
            axle: AxleId(axle),
            sequence: 0,
            posture: Posture::new(0.3, -0.2, 1.0),
        };
        let frames = 30;
        let mut expected_us = 0;
        for _ in 0..frames / 2 {
            for axle in [1, 0] {
                let frame = bus.send(0, &posture(axle)).unwrap();
                expected_us += transfer_us(&frame);
            }
        }
        let mut arrivals = Vec::new();
        for now in (0..10).map(|ms| ms * 1_000) {
            bus.deliver(now, |board, frame, _| {
                if board == Role::beam(0) {
                    arrivals.push((now, frame.id));
                }
            });
        }
        assert_eq!(arrivals.len(), frames);
        assert!(arrivals.is_sorted_by_key(|(_, id)| *id), "{arrivals:?}");
        let last = arrivals.last().unwrap().0;
        assert_eq!(last, expected_us.div_ceil(1_000) * 1_000);
        let statistics = bus.statistics();
        assert_eq!(statistics.busy_us, expected_us);
        // Frames that end more than 3 ms after the beginning of the epoch are late for the lead node.
        let late = statistics.late as f64 / frames as f64;
        let share = 1.0 - LEAD_PHASE as f64 / expected_us as f64;
        assert!((late - share).abs() < 0.05, "{late} {share}");
    }

    #[test]
    fn auto_transmission_is_on_for_more_than_two_axles() {
        for axles in 2..=5 {
            let robot = Topology::new(axles).unwrap();
            assert_eq!(BusConfig::default().has_wire(robot), axles > 2);
        }
    }

    #[test]
    fn jitter_adds_to_latency_up_to_its_limit() {
        let config = BusConfig {
            latency_ms: 1,
            jitter_ms: 3,
            ..BusConfig::default()
        };
        let mut bus = VirtualBus::new(Topology::PAIR, &config, 0);
        let identity = bus::encode(&Message::LeadStatus {
            sequence: 0,
            mode: LeadMode::Active,
            steering_rad: 0.0,
            velocity_m_s: 0.0,
        });
        let mut delivered = [0; 6];
        for number in 0..400 {
            let sent = number * 10_000;
            bus.send_frame(sent, identity.as_ref().unwrap());
            for ms in 0..6 {
                bus.deliver(sent + ms * 1_000, |board, _, _| {
                    delivered[ms as usize] += u32::from(board == Role::axle(1));
                });
            }
        }
        assert_eq!((delivered[0], delivered[5]), (0, 0));
        assert!(
            delivered[1..5].iter().all(|&count| count > 70),
            "{delivered:?}"
        );
    }

    #[test]
    fn messages_arrive_in_order_after_the_latency() {
        let config = BusConfig {
            latency_ms: 3,
            ..BusConfig::default()
        };
        let mut bus = VirtualBus::new(Topology::PAIR, &config, 1);
        bus.send(0, &status(1));
        bus.send(0, &status(2));
        let mut delivered = Vec::new();
        bus.deliver(2_000, |_, _, _| unreachable!("too early"));
        bus.deliver(3_000, |board, frame, message| {
            assert_eq!(bus::decode(frame), Ok(*message));
            delivered.push((board, *message));
        });
        assert_eq!(delivered.len(), 6);
        assert_eq!(delivered[0], (Role::LEAD, status(1)));
        assert_eq!(delivered[5], (Role::beam(0), status(2)));
    }

    #[test]
    fn loss_has_its_rate_and_spares_the_sending_board() {
        let config = BusConfig {
            latency_ms: 0,
            loss: 0.3,
            ..BusConfig::default()
        };
        let mut bus = VirtualBus::new(Topology::PAIR, &config, 7);
        let mut count = [0; 3];
        for i in 0..10_000u64 {
            bus.send(
                i,
                &Message::AxlePosture {
                    axle: AxleId(1),
                    sequence: 0,
                    posture: Posture::ORIGIN,
                },
            );
            bus.deliver(i, |board, _, _| count[Topology::PAIR.place(board)] += 1);
        }
        assert_eq!(count[Topology::PAIR.place(Role::axle(1))], 10_000);
        for board in [Role::LEAD, Role::beam(0)] {
            // Five standard deviations of a binomial count.
            assert!((count[Topology::PAIR.place(board)] - 7_000i32).abs() < 230);
        }
    }

    #[test]
    fn quantisation_can_be_left_out() {
        let sent = Posture::new(0.123_456_7, 0.0, 0.0);
        let through = |quantise| {
            let config = BusConfig {
                quantise,
                ..BusConfig::default()
            };
            let mut bus = VirtualBus::new(Topology::PAIR, &config, 1);
            bus.send(
                0,
                &Message::AxlePosture {
                    axle: AxleId(0),
                    sequence: 0,
                    posture: sent,
                },
            );
            let mut received = None;
            bus.deliver(2_000, |_, _, message| received = Some(*message));
            match received {
                Some(Message::AxlePosture { posture, .. }) => posture.x,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(through(false), sent.x);
        let error = (through(true) - sent.x).abs();
        assert!(error > 1e-6 && error < 5.1e-6, "{error}");
    }

    #[test]
    fn message_that_cannot_be_encoded_is_counted() {
        let mut bus = VirtualBus::new(Topology::PAIR, &BusConfig::default(), 1);
        bus.send(
            0,
            &Message::LeadStatus {
                sequence: 0,
                mode: LeadMode::Idle,
                steering_rad: f32::NAN,
                velocity_m_s: 0.0,
            },
        );
        assert_eq!(bus.statistics().refused, 1);
    }
}
