//! Faults of the bus and of clocks that differ.

use super::bench::Bench;
use super::entry::{Entry, at};
use core_algos::safety::Condition::{self, *};
use core_algos::topology::Role;
use virtual_board::wire::{Fault, Frame, Id, Level};

/// Codes of a bus that carries no messages. A board reports the code of the message that it missed
/// first.
const SILENCE: &[Condition] = &[BusOff, NeighbourLost, NeighbourFault, CommandTimeout];

/// A frame of eight bytes of an identifier.
fn frame(id: u16) -> Frame {
    Frame::new(Id::Standard(id), &[0x55; 8])
}

/// Sets the remaining functions of the transceiver of the affected board.
fn transceiver(bench: &mut Bench, sends: bool, hears: bool) {
    let role = bench.wheel().0;
    bench.transceiver(role, sends, hears);
}

pub fn entries() -> Vec<Entry> {
    [transceivers(), wires(), intruders(), clocks()].concat()
}

fn transceivers() -> Vec<Entry> {
    vec![
        Entry::drive("none", "", |_| {}).goes_on(),
        Entry::steps(
            "no acknowledgement",
            "front board's wire",
            &[
                at(0, |b| b.piece(Role::Front, 2)),
                at(1500, |b| b.piece(Role::Front, 0)),
            ],
        )
        .stops(SILENCE),
        Entry::steps(
            "transceiver sends no more",
            "transceiver",
            &[at(0, |b| transceiver(b, false, true))],
        )
        .stops(SILENCE),
        Entry::drive("transceiver hears no more", "transceiver", |b| {
            transceiver(b, true, false)
        })
        .stops(SILENCE),
        Entry::drive("transceiver dead", "transceiver", |b| {
            transceiver(b, false, false)
        })
        .stops(SILENCE),
        Entry::drive("transceiver of the beam dead", "transceiver", |b| {
            b.transceiver(Role::Beam, false, false);
        })
        .goes_on(),
    ]
}

fn wires() -> Vec<Entry> {
    vec![
        Entry::steps(
            "bus held dominant",
            "wire",
            &[
                at(0, |b| b.wire(Fault::Level(Some(Level::Dominant)))),
                at(1500, |b| b.wire(Fault::Level(None))),
            ],
        )
        .stops(SILENCE),
        Entry::steps(
            "bus shorted (recessive)",
            "wire",
            &[
                at(0, |b| b.wire(Fault::Level(Some(Level::Recessive)))),
                at(1500, |b| b.wire(Fault::Level(None))),
            ],
        )
        .stops(SILENCE),
        Entry::steps(
            "bus-off and recovery within 8 ms",
            "wire",
            &[
                at(0, |b| b.wire(Fault::Level(Some(Level::Recessive)))),
                at(8, |b| b.wire(Fault::Level(None))),
            ],
        )
        .goes_on()
        .stops(SILENCE),
        Entry::steps(
            "bus wrong in 1 bit of 100000",
            "wire",
            &[at(0, |b| b.wire(Fault::Noise(1e-5)))],
        )
        .goes_on(),
        Entry::steps(
            "bus wrong in 1 bit of 100",
            "wire",
            &[
                at(0, |b| b.wire(Fault::Noise(1e-2))),
                at(1500, |b| b.wire(Fault::Noise(0.0))),
            ],
        )
        .stops(SILENCE),
    ]
}

fn intruders() -> Vec<Entry> {
    vec![
        Entry::drive("babbling node, lowest priority", "wire", |b| {
            b.intruder(|node, _| node.babble(Some(frame(0x7ff))));
        })
        .goes_on(),
        Entry::steps(
            "babbling node, highest priority",
            "wire",
            &[
                at(0, |b| b.intruder(|node, _| node.babble(Some(frame(0))))),
                at(1500, |b| b.intruder(|node, _| node.babble(None))),
            ],
        )
        .stops(SILENCE),
        Entry::steps(
            "FIFO overrun: beam halted in a burst",
            "wire, debug port",
            &[
                at(0, |b| {
                    b.intruder(|node, now| {
                        for _ in 0..30 {
                            node.send(now, frame(0x7fe));
                        }
                    });
                    b.board(Role::Beam, |board| board.hold(true));
                }),
                at(2, |b| b.board(Role::Beam, |board| board.hold(false))),
            ],
        )
        .goes_on()
        .finds(&["CAN"]),
        Entry::drive("burst of 200 frames", "wire", |b| {
            b.intruder(|node, now| {
                for _ in 0..200 {
                    node.send(now, frame(0x7fe));
                }
            });
        })
        .goes_on(),
    ]
}

fn clocks() -> Vec<Entry> {
    vec![
        Entry::drive("front board 200 ppm fast", "crystal", |_| {})
            .fast(Role::Front, 200_000)
            .goes_on(),
        Entry::drive("rear board 200 ppm fast", "crystal", |_| {})
            .fast(Role::Rear, 200_000)
            .goes_on(),
        Entry::drive("beam board 200 ppm fast", "crystal", |_| {})
            .fast(Role::Beam, 200_000)
            .goes_on(),
        // Too much for its ticks, not for the bus: from edge to edge are ten bits at most.
        Entry::start("beam board 1.2 % fast", "crystal", &[])
            .fast(Role::Beam, 12_000_000)
            .unready(),
    ]
}
