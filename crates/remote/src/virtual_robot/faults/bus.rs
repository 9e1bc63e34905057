//! Faults of the bus, and clocks with frequency errors.

use super::bench::FaultBench;
use super::entry::{Entry, at, entries};
use core_algos::safety::Condition::{self, *};
use core_algos::topology::Role;
use virtual_board::wire::{Fault, Frame, Id, Level};

/// Permitted reasons of a stop after the bus has lost messages. A board reports the code of the message that it misses
/// first.
pub const SILENCE: &[Condition] = &[BusOff, NeighbourLost, NeighbourFault, CommandTimeout];

/// Frame of eight bytes with this identifier.
fn frame(id: u16) -> Frame {
    Frame::new(Id::Standard(id), &[0x55; 8])
}

/// Sets whether the transceiver of the affected board sends and receives.
fn transceiver(bench: &mut FaultBench, sends: bool, hears: bool) {
    let role = bench.wheel().0;
    bench.transceiver(role, sends, hears);
}

pub fn entries() -> Vec<Entry> {
    [transceivers(), wires(), intruders(), clocks()].concat()
}

fn transceivers() -> Vec<Entry> {
    entries! {
        "none", "", drive(|_| {}).goes_on();
        "no acknowledgement", "front board's wire", steps(&[
            at(0, |b| b.piece(Role::LEAD, 2)),
            at(1500, |b| b.piece(Role::LEAD, 0)),
        ]).stops(SILENCE);
        "transceiver sends nothing", "transceiver", steps(&[at(0, |b| transceiver(b, false, true))])
            .stops(SILENCE);
        "transceiver receives nothing", "transceiver", drive(|b| { transceiver(b, true, false) }).stops(SILENCE);
        "transceiver dead", "transceiver", drive(|b| { transceiver(b, false, false) }).stops(SILENCE);
        "transceiver of the beam dead", "transceiver", drive(|b| { let beam = b.frame(); b.transceiver(beam, false, false); })
            .goes_on();
    }
}

fn wires() -> Vec<Entry> {
    entries! {
        "bus held dominant", "wire", steps(&[
            at(0, |b| b.wire(Fault::Level(Some(Level::Dominant)))),
            at(1500, |b| b.wire(Fault::Level(None))),
        ]).stops(SILENCE);
        "bus shorted (recessive)", "wire", steps(&[
            at(0, |b| b.wire(Fault::Level(Some(Level::Recessive)))),
            at(1500, |b| b.wire(Fault::Level(None))),
        ]).stops(SILENCE);
        "bus-off and recovery within 8 ms", "wire", steps(&[
            at(0, |b| b.wire(Fault::Level(Some(Level::Recessive)))),
            at(8, |b| b.wire(Fault::Level(None))),
        ]).goes_on().stops(SILENCE);
        "bus wrong in 1 bit of 100000", "wire", steps(&[at(0, |b| b.wire(Fault::Noise(1e-5)))]).goes_on();
        "bus wrong in 1 bit of 100", "wire", steps(&[
            at(0, |b| b.wire(Fault::Noise(1e-2))),
            at(1500, |b| b.wire(Fault::Noise(0.0))),
        ]).stops(SILENCE);
    }
}

fn intruders() -> Vec<Entry> {
    entries! {
        "babbling node, lowest priority", "wire", drive(|b| {
            b.intruder(|node, _| node.babble(Some(frame(0x7ff))));
        }).goes_on();
        "babbling node, highest priority", "wire", steps(&[
            at(0, |b| b.intruder(|node, _| node.babble(Some(frame(0))))),
            at(1500, |b| b.intruder(|node, _| node.babble(None))),
        ]).stops(SILENCE);
        "FIFO overrun: beam halted in a burst", "wire, debug port", steps(&[
            at(0, |b| {
                b.intruder(|node, now| {
                    for _ in 0..30 {
                        node.send(now, frame(0x7fe));
                    }
                });
                let beam = b.frame();
                b.board(beam, |board| board.hold(true));
            }),
            at(2, |b| { let beam = b.frame(); b.board(beam, |board| board.hold(false)) }),
        ]).goes_on().finds(&["CAN"]);
        "burst of 200 frames", "wire", drive(|b| {
            b.intruder(|node, now| {
                for _ in 0..200 {
                    node.send(now, frame(0x7fe));
                }
            });
        }).goes_on();
    }
}

fn clocks() -> Vec<Entry> {
    entries! {
        "front board 200 ppm fast", "crystal", drive(|_| {}).fast(Role::LEAD, 200_000).goes_on();
        "{axle} board 200 ppm fast", "crystal", drive(|_| {}).fast(Role::axle(1), 200_000).goes_on();
        "{frame} board 200 ppm fast", "crystal", drive(|_| {}).fast(Role::beam(0), 200_000).goes_on();
        // A frequency error of 1.2 % is too large for the board's ticks. The bus works: edges are at most ten bits
        // apart.
        "{frame} board 1.2 % fast", "crystal", start(&[]).fast(Role::beam(0), 12_000_000).unready();
    }
}
