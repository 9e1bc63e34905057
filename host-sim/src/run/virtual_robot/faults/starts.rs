//! Boot orders, and faults that are there when the power comes on.

use super::bench::Bench;
use super::entry::{Entry, at};
use super::power::{beam, crystal, struck};
use core_algos::topology::Role;

pub fn entries() -> Vec<Entry> {
    [orders(), buses(), others()].concat()
}

fn orders() -> Vec<Entry> {
    vec![
        Entry::start("boards powered together", "power", &[]).goes_on(),
        Entry::start("front board a second later", "power", &[])
            .powered([1000, 0, 0])
            .goes_on(),
        Entry::start("rear board a second later", "power", &[])
            .powered([0, 1000, 0])
            .goes_on(),
        Entry::start("beam board a second later", "power", &[])
            .powered([0, 0, 1000])
            .goes_on(),
        Entry::start(
            "a board powered twice",
            "power",
            &[
                at(120, |b| {
                    let role = b.any();
                    b.board(role, |board| board.power(false));
                }),
                at(140, |b| {
                    let role = b.any();
                    b.board(role, |board| board.power(true));
                }),
            ],
        )
        .goes_on(),
        Entry::start(
            "bus open at the start, closed after 0.5 s",
            "wire",
            &[
                at(0, |b| {
                    for (piece, role) in (2..).zip(Role::ALL) {
                        b.piece(role, piece);
                    }
                }),
                at(500, |b| {
                    Role::ALL.into_iter().for_each(|role| b.piece(role, 0))
                }),
            ],
        )
        .goes_on(),
    ]
}

fn buses() -> Vec<Entry> {
    vec![
        Entry::start("bus open", "wire", &[at(0, |b| b.piece(Role::Rear, 2))]),
        Entry::start(
            "no acknowledgement from the start",
            "wire",
            &[at(0, |b| {
                for (piece, role) in (2..).zip(Role::ALL) {
                    b.piece(role, piece);
                }
            })],
        ),
        Entry::start(
            "transceiver dead from the start",
            "transceiver",
            &[at(0, |b| {
                let role = b.wheel().0;
                b.transceiver(role, false, false);
            })],
        ),
        Entry::start(
            "transceiver of the beam dead from the start",
            "transceiver",
            &[at(0, |b| b.transceiver(Role::Beam, false, false))],
        )
        .unready(),
        Entry::start(
            "bus held dominant from the start",
            "wire",
            &[at(0, |b| {
                use virtual_board::wire::{Fault, Level};
                b.wire(Fault::Level(Some(Level::Dominant)));
            })],
        ),
    ]
}

fn others() -> Vec<Entry> {
    vec![
        Entry::start(
            "crystal dead for the first 2.5 s",
            "crystal",
            &[
                at(0, |b| crystal(b, Bench::any, false)),
                at(2500, |b| crystal(b, Bench::any, true)),
            ],
        )
        .goes_on()
        .must_reset()
        .finds(&["reset"]),
        Entry::start(
            "crystal of an axle's board dead for good",
            "crystal",
            &[at(0, |b| crystal(b, struck, false))],
        )
        .resets(&[Role::Front, Role::Rear])
        .finds(&["reset"]),
        Entry::start(
            "crystal of the beam's board dead for good",
            "crystal",
            &[at(0, |b| crystal(b, beam, false))],
        )
        .unready()
        .resets(&[Role::Beam])
        .finds(&["reset"]),
        Entry::start(
            "emergency stop open from the start",
            "contact",
            &[at(0, |b| {
                let role = b.wheel().0;
                b.axle(role, |axle, now| axle.stop(true, now));
            })],
        ),
    ]
}
