//! The wire with virtual nodes.

use super::*;
use crate::noise::Noise;
use crate::time::Time;

/// Simulation step of the boards.
const QUANTUM: Time = Time::from_micros(20);
/// Length of a bit at 1 Mbit/s, ps.
const BIT: u64 = 1_000_000;

/// A wire with virtual nodes.
struct WireBench {
    wire: Wire,
    quantum: Time,
    nodes: Vec<VirtualNode>,
    /// Events of each node.
    delivered: Vec<Vec<Event>>,
    now: Time,
}

/// A node with a record of its events.
struct Watched<'a>(&'a mut VirtualNode, &'a mut Vec<Event>);

impl Node for Watched<'_> {
    fn take_action(&mut self) -> Option<(Time, Action)> {
        self.0.take_action()
    }

    fn event(&mut self, event: Event) {
        self.0.event(event);
        self.1.push(event);
    }
}

impl WireBench {
    fn new(settings: &[Settings]) -> Self {
        let mut wire = Wire::new(settings.len(), QUANTUM, 1);
        wire.record();
        Self {
            wire,
            quantum: QUANTUM,
            nodes: settings.iter().map(|&s| VirtualNode::new(s)).collect(),
            delivered: vec![Vec::new(); settings.len()],
            now: Time(0),
        }
    }

    fn equal(count: usize) -> Self {
        Self::new(&vec![Settings::new(BitTiming::megabit()); count])
    }

    fn run(&mut self, until: Time) {
        while self.now < until {
            self.now = self.now + self.quantum;
            let nodes = self.nodes.iter_mut().zip(&mut self.delivered);
            let mut nodes: Vec<_> = nodes.map(|(node, to)| Watched(node, to)).collect();
            let mut nodes: Vec<_> = nodes.iter_mut().map(|node| node as &mut dyn Node).collect();
            self.wire.advance(self.now, &mut nodes);
        }
    }

    fn events(&self, node: usize, of: impl Fn(&EventKind) -> bool) -> Vec<Event> {
        let events = self.delivered[node].iter();
        events.filter(|event| of(&event.kind)).copied().collect()
    }

    /// Frames that a node received, with the times of their ends.
    fn received(&self, node: usize) -> Vec<(Time, Frame)> {
        let events = self.delivered[node].iter();
        let frames = events.filter_map(|event| match event.kind {
            EventKind::Received { frame, .. } => Some((event.at, frame)),
            _ => None,
        });
        frames.collect()
    }

    /// Forces the bus dominant for `span` from `from` on.
    fn disturb(&mut self, from: Time, span: Time) {
        let dominant = Fault::Level(Some(Level::Dominant));
        self.wire.inject(from, dominant);
        self.wire.inject(from + span, Fault::Level(None));
    }
}

/// Bits for which a frame occupies the bus, including the intermission.
fn bus_bits(frame: &Frame) -> u64 {
    frame.bits().length() as u64 + 3
}

/// Largest relative clock deviation at which two nodes with this timing can communicate. CAN specification 2.0, section
/// 9: ten bits between edges, thirteen bits to the sample after an error flag.
fn tolerance(timing: &BitTiming) -> f64 {
    let (bit, jump) = (f64::from(timing.quanta()), f64::from(timing.jump));
    let phase = f64::from(timing.segment1.min(timing.segment2));
    (jump / (20.0 * bit)).min(phase / (2.0 * (13.0 * bit - f64::from(timing.segment2))))
}

fn micros(n: u64) -> Time {
    Time::from_micros(n)
}

fn standard(id: u16, data: &[u8]) -> Frame {
    Frame::new(Id::Standard(id), data)
}

#[test]
fn frame_takes_its_bits_and_arrives_at_all_nodes() {
    for data in [&[][..], &[0; 8], &[0xff; 8], &[0x55, 0xaa]] {
        let mut bench = WireBench::equal(3);
        let frame = standard(0x123, data);
        bench.nodes[0].send(micros(100), frame);
        bench.run(micros(400));
        let sent = bench.events(0, |w| matches!(w, EventKind::Sent { .. }));
        let [sent] = sent[..] else {
            panic!("{sent:?}");
        };
        let EventKind::Sent { start, .. } = sent.kind else {
            panic!();
        };
        let bits = frame.bits().length() as u64;
        // From the first sample point to the last are all bits but one. The acknowledgement is late by twice the delay,
        // so the sender synchronizes by its jump width, a seventh of a bit.
        let span = (sent.at - start).0.abs_diff((bits - 1) * BIT + BIT / 7);
        assert!(span < 10, "{span}");
        // The frame starts within a bit after the request; `start` is the sample point, at 6/7 of the bit.
        assert!(start > micros(100) && start < micros(102), "{start}");
        for node in [1, 2] {
            let received = bench.received(node);
            assert_eq!(received.len(), 1);
            assert_eq!(received[0].1, frame);
            // A receiver accepts the frame one bit before the sender's last bit, except for delay and quanta.
            let before = sent.at.0 as i64 - received[0].0.0 as i64;
            assert!((before - BIT as i64).abs() < 300_000, "{before}");
        }
        assert_eq!(bench.wire.statistics(0).sent, 1);
        assert_eq!(bench.wire.statistics(0).error_frames, 0);
    }
}

#[test]
fn lowest_identifier_wins_and_the_others_follow() {
    let mut bench = WireBench::equal(4);
    let frames = [
        standard(0x200, &[1]),
        standard(0x1ff, &[2]),
        Frame::new(Id::Extended(0x1ff << 18), &[3]),
        Frame::remote(Id::Standard(0x1ff), 1),
    ];
    for (node, &frame) in bench.nodes.iter_mut().zip(&frames) {
        node.send(micros(50), frame);
    }
    bench.run(micros(1000));
    let records = bench.wire.take_records();
    let order: Vec<_> = records.iter().map(|r| (r.node, r.error)).collect();
    assert_eq!(order, [(1, None), (3, None), (2, None), (0, None)]);
    // Frames follow each other after three bits of intermission.
    for pair in records.windows(2) {
        let bits = bus_bits(&pair[0].frame);
        let span = (pair[1].start - pair[0].start).0;
        assert!(span.abs_diff(bits * BIT) < 300_000, "{span}");
    }
    assert_eq!(bench.wire.statistics(0).arbitrations_lost, 3);
    assert_eq!(bench.wire.statistics(1).arbitrations_lost, 0);
}

fn random_frame(random: &mut Noise, id: u16) -> Frame {
    let length = random.bits() % 9;
    let data: Vec<u8> = (0..length).map(|_| random.bits() as u8).collect();
    standard(id, &data)
}

#[test]
fn events_are_independent_of_the_quantum_and_delivered_ahead() {
    let mut outcomes = Vec::new();
    for quantum in [1, 7, 20, 40].map(micros) {
        let mut bench = WireBench::equal(3);
        bench.wire = Wire::new(3, quantum, 1);
        bench.wire.record();
        bench.quantum = quantum;
        let mut random = Noise::new(1);
        for i in 0..300u64 {
            let at = Time(micros(100).0 + i * 70_000_000 + random.bits() % 60_000_000);
            let id = (random.bits() % 64) as u16 * 8 + (i % 3) as u16;
            let frame = random_frame(&mut random, id);
            bench.nodes[(i % 3) as usize].send(at, frame);
        }
        while bench.now < micros(50_000) {
            bench.run(bench.now + quantum);
            let now = bench.now;
            let delivered = bench.delivered.iter_mut();
            for event in delivered.flat_map(|events| events.drain(..)) {
                if matches!(
                    event.kind,
                    EventKind::Sent { .. } | EventKind::Received { .. }
                ) {
                    assert!(event.at >= now, "{event:?} delivered at {now}");
                }
            }
        }
        let records = bench.wire.take_records();
        assert_eq!(records.len(), 300);
        outcomes.push(records);
    }
    for outcome in &outcomes[1..] {
        assert_eq!(outcome, &outcomes[0]);
    }
}

#[test]
fn corrupted_frame_is_retransmitted_within_the_recovery_time() {
    let mut bench = WireBench::equal(3);
    bench.nodes[0].send(micros(100), standard(0x123, &[0xff; 8]));
    // A recessive bit of the data becomes dominant for all nodes.
    bench.disturb(micros(150), micros(1));
    bench.run(micros(600));
    let records = bench.wire.take_records();
    let [bad, good] = records[..] else {
        panic!("{records:?}");
    };
    assert_eq!(bad.error, Some(ErrorKind::BitRecessive));
    assert_eq!(good.error, None);
    // Flags, delimiter and intermission are 17 to 23 bits, between the bit with the error and the next start of frame.
    let bits = (good.start - bad.end).0 as f64 / BIT as f64;
    assert!((17.0..=24.5).contains(&bits), "{bits}");
    let counters: Vec<_> = (0..3)
        .map(|k| {
            let error = bench.events(k, |w| matches!(w, EventKind::Error(_)));
            (error.len(), error[0].tec, error[0].rec)
        })
        .collect();
    // The sender's error counts 8. The receivers detect only its flag, which counts 1.
    assert_eq!(counters, [(1, 8, 0), (1, 0, 1), (1, 0, 1)]);
    for node in [1, 2] {
        assert_eq!(bench.received(node).len(), 1);
        let statistics = bench.wire.statistics(node);
        assert_eq!(statistics.errors_of(ErrorKind::Stuff), 1);
        assert_eq!(statistics.error_frames, 1);
    }
}

#[test]
fn receiver_that_alone_detects_an_error_counts_nine() {
    let mut bench = WireBench::equal(3);
    // Node 2 misses some bits in the middle of a frame.
    let set_receiver = |receive_enabled| Fault::Transceiver {
        node: 2,
        transmit_enabled: true,
        receive_enabled,
    };
    bench.nodes[0].send(micros(100), standard(0x555, &[0x55; 8]));
    bench.wire.inject(micros(131), set_receiver(false));
    bench.wire.inject(micros(137), set_receiver(true));
    bench.run(micros(600));
    let errors = bench.events(2, |w| matches!(w, EventKind::Error(_) | EventKind::Counted));
    let counts: Vec<_> = errors.iter().map(|e| (e.kind, e.rec)).collect();
    // The detected error counts 1. The dominant bit after the node's own flag, from the other nodes' flags, counts 8.
    let own = (EventKind::Error(ErrorKind::Stuff), 1);
    assert_eq!(counts, [own, (EventKind::Counted, 9)]);
    assert_eq!(bench.wire.statistics(0).sent, 1);
    assert_eq!(bench.wire.statistics(0).error_frames, 1);
}

#[test]
fn equal_identifiers_with_different_data_are_an_error() {
    let mut bench = WireBench::equal(3);
    bench.nodes[0].send(micros(100), standard(0x123, &[0x00]));
    bench.nodes[1].send(micros(100), standard(0x123, &[0x01]));
    bench.run(micros(180));
    let errors = bench.events(1, |w| matches!(w, EventKind::Error(_)));
    assert_eq!(errors[0].kind, EventKind::Error(ErrorKind::BitRecessive));
    let errors = bench.events(0, |w| matches!(w, EventKind::Error(_)));
    assert!(!errors.is_empty());
    // With equal data, both nodes complete the transmission.
    let mut bench = WireBench::equal(3);
    for node in [0, 1] {
        bench.nodes[node].send(micros(100), standard(0x123, &[0x01]));
    }
    bench.run(micros(1000));
    for node in [0, 1] {
        let statistics = bench.wire.statistics(node);
        assert_eq!((statistics.sent, statistics.error_frames), (1, 0));
    }
    assert_eq!(bench.received(2).len(), 1);
}

#[test]
fn sender_without_receivers_becomes_passive_and_waits_longer() {
    let mut bench = WireBench::equal(1);
    let frame = standard(0x123, &[1]);
    bench.nodes[0].send(micros(100), frame);
    bench.run(micros(10_000));
    let records = bench.wire.take_records();
    // After the acknowledgement slot follow the flag (6 bits), the error delimiter (8) and the intermission (3). A
    // passive sender waits 8 more bits.
    let slot = frame.bits().acknowledgement() as u64;
    for (k, pair) in records.windows(2).enumerate() {
        let bits = (pair[1].start - pair[0].start).0.div_ceil(1000) / (BIT / 1000);
        let waited = if k < 15 { 0 } else { 8 };
        assert_eq!(bits, slot + 1 + 6 + 8 + 3 + waited, "{k}");
    }
    let last = bench.events(0, |w| matches!(w, EventKind::Error(_))).pop();
    assert_eq!(last.map(|e| e.tec), Some(128));
    assert_eq!(bench.wire.statistics(0).bus_offs, 0);
}

#[test]
fn stuck_dominant_bus_causes_bus_off_and_recovery() {
    let mut bench = WireBench::equal(2);
    bench.nodes[0].send(micros(100), standard(0x123, &[1]));
    bench.disturb(micros(120), micros(2000));
    bench.run(micros(2000));
    let off = bench.events(0, |w| *w == EventKind::Off);
    // The transmit counter rises by 8 for the error, then by 8 for every 8 dominant bits after the flag of 6 bits. It
    // reaches 256 at the 32nd step.
    let bits = off[0].at.micros() - 120;
    assert!((6 + 31 * 8 - 3..6 + 31 * 8 + 12).contains(&bits), "{bits}");
    let receiver = bench.events(1, |_| true).pop().map(|e| (e.tec, e.rec));
    assert_eq!(receiver, Some((0, 255)));
    assert_eq!(bench.wire.statistics(1).bus_offs, 0);
    bench.run(micros(6000));
    assert_eq!(bench.wire.statistics(0).sent, 1);
    let back = bench.events(0, |w| *w == EventKind::Recovered);
    let bits = back[0].at.micros() - 2120;
    assert!((1407..1440).contains(&bits), "{bits}");
}

#[test]
fn pieces_of_a_cut_wire_are_separate_buses() {
    let mut bench = WireBench::equal(4);
    let cut = |node, piece| Fault::Piece { node, piece };
    for node in [2, 3] {
        bench.wire.inject(micros(50), cut(node, 1));
    }
    bench.nodes[0].send(micros(100), standard(1, &[1]));
    bench.nodes[2].send(micros(100), standard(2, &[2]));
    bench.run(micros(400));
    for node in 0..4 {
        let received = bench.received(node);
        let expected = usize::from(node % 2 == 1);
        assert_eq!(received.len(), expected, "{node}");
        let sender = node / 2 + 1;
        assert!(received.iter().all(|(_, f)| f.data() == [sender as u8]));
    }
    // A node alone on its piece is not acknowledged.
    bench.wire.inject(micros(400), cut(3, 2));
    bench.nodes[3].send(micros(500), standard(3, &[]));
    bench.run(micros(1000));
    let alone = bench.wire.statistics(3);
    assert!(alone.errors_of(ErrorKind::Acknowledgement) > 1);
}

#[test]
fn babbling_node_starves_only_lower_priorities() {
    for (id, passes) in [(0x000, false), (0x7ff, true)] {
        let mut bench = WireBench::equal(3);
        bench.run(micros(100));
        bench.nodes[2].babble(Some(standard(id, &[0xaa; 8])));
        bench.nodes[0].send(micros(1000), standard(0x123, &[1]));
        bench.run(micros(10_100));
        let records = bench.wire.take_records();
        let load = records.iter().map(|r| bus_bits(&r.frame)).sum::<u64>() as f64 / 10_000.0;
        assert!((0.97..1.003).contains(&load), "{load}");
        assert_eq!(bench.wire.statistics(0).sent, u64::from(passes));
        assert!(bench.wire.statistics(2).sent > 70);
    }
}

#[test]
fn node_with_a_wrong_bit_rate_causes_errors_until_passive() {
    let normal = Settings::new(BitTiming::megabit());
    let slow = Settings::new(BitTiming::new(500_000, (5, 1), 1, 0));
    let mut bench = WireBench::new(&[normal, normal, slow]);
    for i in 0..50 {
        let frame = standard(i * 3, &[i as u8; 8]);
        bench.nodes[0].send(micros(100), frame);
    }
    bench.run(micros(40_000));
    let [sender, _, other] = [0, 1, 2].map(|k| bench.wire.statistics(k));
    assert!(sender.error_frames > 3, "{sender:?}");
    assert!(other.errors.iter().sum::<u64>() > 10, "{other:?}");
    assert_eq!(other.received, 0);
}

#[test]
fn clocks_may_differ_within_the_tolerance_of_the_specification() {
    let spoiled = |timing: (u32, u32, u32), part: f64| {
        let (one, two, jump) = timing;
        let tolerance = tolerance(&BitTiming::new(500_000, (one, two), jump, 0));
        let ppb = (tolerance * part * 1e9) as i64;
        let node = |sign: i64| Settings::new(BitTiming::new(500_000, (one, two), jump, sign * ppb));
        let mut bench = WireBench::new(&[node(1), node(-1), node(1)]);
        bench.wire.delay = Time(0);
        let mut random = Noise::new(7);
        for i in 0..200 {
            let sender = (i % 2) as usize;
            let frame = random_frame(&mut random, i);
            bench.nodes[sender].send(micros(100 + 600 * u64::from(i)), frame);
        }
        bench.run(micros(125_000));
        (0..3)
            .map(|k| bench.wire.statistics(k).error_frames)
            .sum::<u64>()
    };
    // At 0.7 of the tolerance the phase error is at least a quantum less than the second segment. This margin is
    // needed, because edges are detected with a resolution of a quantum.
    for timing in [(13, 2, 1), (11, 4, 3), (11, 4, 4), (10, 5, 1)] {
        assert_eq!(spoiled(timing, 0.7), 0, "{timing:?}");
        assert!(spoiled(timing, 2.5) > 0, "{timing:?}");
    }
}

#[test]
fn noise_delays_frames_and_never_corrupts_them() {
    let mut bench = WireBench::equal(3);
    bench.wire.inject(micros(50), Fault::Noise(2e-4));
    let mut random = Noise::new(3);
    let frames: Vec<_> = (0..100).map(|i| random_frame(&mut random, i)).collect();
    for (i, &frame) in frames.iter().enumerate() {
        bench.nodes[0].send(micros(100 + 400 * i as u64), frame);
    }
    bench.run(micros(60_000));
    assert_eq!(bench.wire.statistics(0).sent, 100);
    let errors: u64 = (0..3).map(|k| bench.wire.statistics(k).error_frames).sum();
    // 60 000 bits at three nodes, with 36 read errors, some on the idle bus. Each error affects at most three nodes.
    assert!((18..160).contains(&errors), "{errors}");
    for node in [1, 2] {
        let received = bench.received(node);
        assert!(received.iter().all(|(_, frame)| frames.contains(frame)));
        assert!(received.len() >= 99);
    }
}

#[test]
fn dominant_bit_in_the_intermission_is_an_overload_and_no_error() {
    let two = || {
        let mut bench = WireBench::equal(2);
        for id in [0x123, 0x124] {
            bench.nodes[0].send(micros(100), standard(id, &[1]));
        }
        bench
    };
    let mut bench = two();
    bench.run(micros(600));
    let end = bench.events(0, |w| matches!(w, EventKind::Sent { .. }))[0].at;
    let mut bench = two();
    let within = end + Time::from_nanos(300);
    bench.disturb(within, micros(1));
    bench.run(micros(600));
    for node in [0, 1] {
        let statistics = bench.wire.statistics(node);
        assert_eq!(statistics.overloads, 1);
        assert_eq!(statistics.error_frames, 0);
    }
    let records = bench.wire.take_records();
    let bits = (records[1].start - records[0].end).0 / BIT;
    // The next frame starts after one bit of intermission, flag (6 bits), delimiter (8) and intermission (3).
    assert!((18..=20).contains(&bits), "{bits}");
}

#[test]
fn fast_path_and_single_steps_give_the_same_result() {
    let outcome = |fast: bool| {
        let node = |ppb| Settings::new(BitTiming::new(1_000_000, (5, 1), 1, ppb));
        let mut bench = WireBench::new(&[node(0), node(120_000), node(-90_000), node(700)]);
        if !fast {
            // Noise with a negligible rate prevents idling and the fast path.
            bench.wire.inject(Time(0), Fault::Noise(1e-300));
        }
        let mut random = Noise::new(11);
        for i in 0..400u16 {
            let at = micros(100 + 97 * u64::from(i));
            let frame = random_frame(&mut random, i % 7 * 16 + i % 4);
            bench.nodes[usize::from(i % 4)].send(at, frame);
        }
        // Some frames are corrupted.
        for i in 0..40 {
            let at = micros(500 + 1003 * i);
            bench.disturb(at, micros(1));
        }
        bench.run(micros(60_000));
        let events: Vec<_> = (0..4).map(|k| bench.events(k, |_| true)).collect();
        (bench.wire.take_records(), events)
    };
    let (fast, steps) = (outcome(true), outcome(false));
    assert!(fast.0.len() > 420);
    let differs = fast.0.iter().zip(&steps.0).find(|(a, b)| a != b);
    assert_eq!(differs, None);
    assert_eq!(fast.0.len(), steps.0.len());
    assert_eq!(fast.1, steps.1);
}
