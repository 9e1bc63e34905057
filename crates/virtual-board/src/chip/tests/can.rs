//! The chip as a node on the bus, clocked by its internal oscillator.

use super::*;
use crate::wire::{BitTiming, Frame, Id, Settings, VirtualNode, Wire};

const CAN1: u32 = 0x4000_6400;
/// Cycles in 1 µs.
const MICRO: u64 = 16;

/// A chip that has requested one transmission; its pins are routed if `pins`.
fn sender(pins: bool) -> ChipBench {
    let mut bench = ChipBench::new(&[]);
    bench.set(RCC + 0x30, 1 << 1);
    bench.set(RCC + 0x40, 1 << 25);
    if pins {
        // PB8 and PB9 get alternate function 9, CAN1.
        bench.write(GPIOB + 0x24, 0x99);
        bench.write(GPIOB, 0x280 | 0xa << 16);
    }
    // The bit rate is set in initialisation mode: 1 Mbit/s from 16 MHz / 2 and eight time quanta.
    bench.write(CAN1, 1);
    bench.write(CAN1 + 0x1c, 5 << 16 | 1);
    bench.write(CAN1, 0);
    bench.write(CAN1 + 0x184, 1);
    bench.write(CAN1 + 0x188, 0x42);
    bench.write(CAN1 + 0x180, 0x123 << 21 | 1);
    bench
}

/// Frames of the chip that another node received.
fn run(bench: &mut ChipBench, micros: u64) -> Vec<Frame> {
    let mut other = VirtualNode::new(Settings::new(BitTiming::megabit()));
    let mut wire = Wire::new(2, Time::from_micros(20), 1);
    wire.record();
    for quantum in 1..=micros / 20 {
        bench.run_to(bench.cycle.max(quantum * 20 * MICRO));
        let until = Time::from_micros(20 * quantum);
        wire.advance(until, &mut [&mut bench.chip, &mut other]);
    }
    let records = wire.take_records().into_iter();
    let sent = records.filter(|record| record.error.is_none());
    let frames: Vec<_> = sent.map(|record| record.frame).collect();
    assert_eq!(wire.statistics(1).received, frames.len() as u64);
    frames
}

#[test]
fn chip_with_routed_pins_sends_a_frame() {
    let mut bench = sender(true);
    let expected = Frame::new(Id::Standard(0x123), &[0x42]);
    assert_eq!(run(&mut bench, 200), [expected]);
    assert_eq!(bench.read(CAN1 + 8), 0x1c00_0003);
    assert_eq!(bench.findings(), []);
}

#[test]
fn chip_without_routed_pins_sends_nothing_and_is_a_finding() {
    let mut bench = sender(false);
    assert_eq!(run(&mut bench, 400), []);
    let kinds: Vec<_> = bench.findings().iter().map(|(kind, _)| *kind).collect();
    assert_eq!(kinds, [FindingKind::Pin; 2]);
    assert_eq!(bench.read(CAN1 + 8) & 3, 0);
}

#[test]
fn reset_of_the_chip_cancels_its_transmission() {
    let mut bench = sender(true);
    bench.chip.restart(Cause::Software, 0);
    assert_eq!(run(&mut bench, 200), []);
}
