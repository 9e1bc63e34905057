//! Boot orders, and faults that are there when the power comes on.

use super::bench::Bench;
use super::entry::{Entry, at, entries};
use super::power::{beam, crystal, struck};
use core_algos::topology::Role;

pub fn entries() -> Vec<Entry> {
    [orders(), buses(), others()].concat()
}

fn orders() -> Vec<Entry> {
    entries! {
        "boards powered together", "power", start(&[]).goes_on();
        "front board a second later", "power", start(&[]).powered([1000, 0, 0]).goes_on();
        "rear board a second later", "power", start(&[]).powered([0, 1000, 0]).goes_on();
        "beam board a second later", "power", start(&[]).powered([0, 0, 1000]).goes_on();
        "a board powered twice", "power", start(&[
            at(120, |b| {
                let role = b.any();
                b.board(role, |board| board.power(false));
            }),
            at(140, |b| {
                let role = b.any();
                b.board(role, |board| board.power(true));
            }),
        ]).goes_on();
        "bus open at the start, closed after 0.5 s", "wire", start(&[
            at(0, |b| {
                for (piece, role) in (2..).zip(Role::ALL) {
                    b.piece(role, piece);
                }
            }),
            at(500, |b| {
                Role::ALL.into_iter().for_each(|role| b.piece(role, 0))
            }),
        ]).goes_on();
    }
}

fn buses() -> Vec<Entry> {
    entries! {
        "bus open", "wire", start(&[at(0, |b| b.piece(Role::Rear, 2))]);
        "no acknowledgement from the start", "wire", start(&[at(0, |b| {
            for (piece, role) in (2..).zip(Role::ALL) {
                b.piece(role, piece);
            }
        })]);
        "transceiver dead from the start", "transceiver", start(&[at(0, |b| {
            let role = b.wheel().0;
            b.transceiver(role, false, false);
        })]);
        "transceiver of the beam dead from the start", "transceiver", start(&[at(0, |b| b.transceiver(Role::Beam, false, false))])
            .unready();
        "bus held dominant from the start", "wire", start(&[at(0, |b| {
            use virtual_board::wire::{Fault, Level};
            b.wire(Fault::Level(Some(Level::Dominant)));
        })]);
    }
}

fn others() -> Vec<Entry> {
    entries! {
        "crystal dead for the first 2.5 s", "crystal", start(&[
            at(0, |b| crystal(b, Bench::any, false)),
            at(2500, |b| crystal(b, Bench::any, true)),
        ]).goes_on().must_reset().finds(&["reset"]);
        "crystal of an axle's board dead for good", "crystal", start(&[at(0, |b| crystal(b, struck, false))])
            .resets(&[Role::Front, Role::Rear]).finds(&["reset"]);
        "crystal of the beam's board dead for good", "crystal", start(&[at(0, |b| crystal(b, beam, false))])
            .unready().resets(&[Role::Beam]).finds(&["reset"]);
        "emergency stop open from the start", "contact", start(&[at(0, |b| {
            let role = b.wheel().0;
            b.axle(role, |axle, now| axle.stop(true, now));
        })]);
    }
}
