//! The wire with virtual nodes.

use super::*;
use crate::time::Time;

/// Quantum of the boards.
const QUANTUM: Time = Time::from_micros(20);
/// A bit at 1 Mbit/s.
const BIT: u64 = 1_000_000;

/// A wire with nodes at it.
struct Bench {
    wire: Wire,
    nodes: Vec<VirtualNode>,
    now: Time,
}

impl Bench {
    fn new(settings: &[Settings]) -> Self {
        let mut wire = Wire::new(settings.len(), QUANTUM, 1);
        wire.record();
        let mut nodes: Vec<_> = settings.iter().map(|&s| VirtualNode::new(s)).collect();
        nodes.iter_mut().for_each(VirtualNode::keep_events);
        Self {
            wire,
            nodes,
            now: Time(0),
        }
    }

    fn equal(count: usize) -> Self {
        Self::new(&vec![Settings::new(BitTiming::megabit()); count])
    }

    fn run(&mut self, until: Time) {
        while self.now < until {
            self.now = self.now + QUANTUM;
            let mut nodes: Vec<&mut dyn Node> = Vec::new();
            for node in &mut self.nodes {
                nodes.push(node);
            }
            self.wire.advance(self.now, &mut nodes);
        }
    }

    fn events(&mut self, node: usize, of: impl Fn(&What) -> bool) -> Vec<Event> {
        let events = self.nodes[node].take_events();
        events.into_iter().filter(|e| of(&e.what)).collect()
    }
}

fn micros(n: u64) -> Time {
    Time::from_micros(n)
}

fn standard(id: u16, data: &[u8]) -> Frame {
    Frame::new(Id::Standard(id), data)
}

#[test]
fn a_frame_takes_its_bits_and_arrives_at_all() {
    for data in [&[][..], &[0; 8], &[0xff; 8], &[0x55, 0xaa]] {
        let mut bench = Bench::equal(3);
        let frame = standard(0x123, data);
        bench.nodes[0].send(micros(100), frame);
        bench.run(micros(400));
        let sent = bench.events(0, |w| matches!(w, What::Sent { .. }));
        let [sent] = sent[..] else {
            panic!("{sent:?}");
        };
        let What::Sent { start, .. } = sent.what else {
            panic!();
        };
        // From the sample point of the first bit to that of the last.
        let bits = frame.bits().length() as u64;
        // The acknowledgement comes late by twice the delay, which the sender follows by its jump
        // width, a seventh of a bit.
        let span = (sent.at - start).0.abs_diff((bits - 1) * BIT + BIT / 7);
        assert!(span < 10, "{span}");
        // The start of frame: a bit after the request at most, sampled at 6/7 of it.
        assert!(start > micros(100) && start < micros(102), "{start}");
        for node in [1, 2] {
            let received = bench.nodes[node].take_received();
            assert_eq!(received.len(), 1);
            assert_eq!(received[0].1, frame);
            // A bit before the sender's last, but for delay and quanta.
            let before = sent.at.0 as i64 - received[0].0.0 as i64;
            assert!((before - BIT as i64).abs() < 300_000, "{before}");
        }
        assert_eq!(bench.wire.statistics(0).sent, 1);
        assert_eq!(bench.wire.statistics(0).error_frames(), 0);
    }
}

#[test]
fn the_lowest_identifier_wins_and_the_others_follow() {
    let mut bench = Bench::equal(4);
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
    // Back to back: a frame, three bits of intermission, the next.
    for pair in records.windows(2) {
        let bits = pair[0].frame.bus_bits() as u64;
        let span = (pair[1].start - pair[0].start).0;
        assert!(span.abs_diff(bits * BIT) < 300_000, "{span}");
    }
    assert_eq!(bench.wire.statistics(0).lost, 3);
    assert_eq!(bench.wire.statistics(1).lost, 0);
}
