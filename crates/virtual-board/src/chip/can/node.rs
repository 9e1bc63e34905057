//! The chip as a node of the wire.

use super::super::{Chip, Signal};
use crate::finding::Kind;
use crate::time::Time;
use crate::wire::{Action, Event, Node};

impl Chip {
    /// Messages that its controller lost because a FIFO was full.
    pub fn can_overruns(&self) -> u64 {
        self.units.can1.lost()
    }

    /// Whether a signal of the controller is on a pin; a finding, if not.
    fn is_routed(&mut self, signal: Signal, name: &str) -> bool {
        let found = self.units.gpio.pin_of(signal).is_some();
        if !found {
            let text = format!("CAN1 takes part without a pin for {name}");
            self.shared.note(Kind::Pin, text);
        }
        found
    }
}

impl Node for Chip {
    fn take_action(&mut self) -> Option<(Time, Action)> {
        let (at, mut action) = self.units.can1.actions.pop_front()?;
        if let Action::Set(settings) = &mut action
            && settings.on
        {
            settings.sends = self.is_routed(Signal::Can1Tx, "CAN1_TX");
            settings.hears = self.is_routed(Signal::Can1Rx, "CAN1_RX");
        }
        Some((at, action))
    }

    fn event(&mut self, event: Event) {
        self.units.can1.post(event, &mut self.shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Bare;
    use crate::core::{System, Transfer};
    use crate::time::Cycles;
    use crate::wire::{BitTiming, Frame, Id, Settings, VirtualNode, Wire};

    const CAN1: u32 = 0x4000_6400;
    const PORT_B: u32 = 0x4002_0400;
    /// Core cycles in a microsecond, with the internal oscillator.
    const MICRO: u64 = 16;

    fn write(chip: &mut Chip, address: u32, value: u32, cycle: &mut Cycles) {
        let done = chip.write(Transfer::word(address, 0), value, cycle);
        assert!(done.is_ok());
    }

    fn read(chip: &mut Chip, address: u32, cycle: &mut Cycles) -> u32 {
        chip.read(Transfer::word(address, 0), cycle)
            .expect("a register")
    }

    /// A chip that has asked for one frame to be sent, with or without its pins.
    fn chip(pins: bool, cycle: &mut Cycles) -> Chip {
        let mut chip = Chip::new(Box::new(Bare), 0);
        let mut set = |address, value| write(&mut chip, address, value, cycle);
        set(0x4002_3830, 1 << 1);
        set(0x4002_3840, 1 << 25);
        if pins {
            // PB8 and PB9: alternate function 9.
            set(PORT_B + 0x24, 0x99);
            set(PORT_B, 0x280 | 0xa << 16);
        }
        // Initialisation; 16 MHz / 2, eight quanta; normal.
        set(CAN1, 1);
        set(CAN1 + 0x1c, 5 << 16 | 1);
        set(CAN1, 0);
        set(CAN1 + 0x184, 1);
        set(CAN1 + 0x188, 0x42);
        set(CAN1 + 0x180, 0x123 << 21 | 1);
        chip
    }

    /// Frames that another node received from the chip.
    fn run(chip: &mut Chip, cycle: &mut Cycles, micros: u64) -> Vec<Frame> {
        let mut other = VirtualNode::new(Settings::new(BitTiming::megabit()));
        let mut wire = Wire::new(2, Time::from_micros(20), 1);
        wire.record();
        for quantum in 1..=micros / 20 {
            *cycle = (*cycle).max(quantum * 20 * MICRO);
            chip.advance(*cycle, *cycle);
            let until = Time::from_micros(20 * quantum);
            wire.advance(until, &mut [chip, &mut other]);
        }
        let records = wire.take_records().into_iter();
        let sent = records.filter(|record| record.error.is_none());
        let frames: Vec<_> = sent.map(|record| record.frame).collect();
        assert_eq!(wire.statistics(1).received, frames.len() as u64);
        frames
    }

    #[test]
    fn a_chip_sends_a_frame() {
        let mut cycle = 0;
        let mut chip = chip(true, &mut cycle);
        let received = run(&mut chip, &mut cycle, 200);
        assert_eq!(received, [Frame::new(Id::Standard(0x123), &[0x42])]);
        assert_eq!(read(&mut chip, CAN1 + 8, &mut cycle), 0x1c00_0003);
        assert!(chip.findings().list().is_empty());
    }

    #[test]
    fn without_pins_it_sends_nothing_and_that_is_found() {
        let mut cycle = 0;
        let mut chip = chip(false, &mut cycle);
        assert_eq!(run(&mut chip, &mut cycle, 400), []);
        let pins = chip.findings().list().iter();
        assert_eq!(pins.filter(|f| f.kind == Kind::Pin).count(), 2);
        assert_eq!(read(&mut chip, CAN1 + 8, &mut cycle) & 3, 0);
    }

    #[test]
    fn a_reset_of_the_chip_takes_it_off_the_wire() {
        let mut cycle = 0;
        let mut chip = chip(true, &mut cycle);
        chip.restart(crate::chip::Cause::Software, 0);
        assert_eq!(run(&mut chip, &mut cycle, 200), []);
    }
}
