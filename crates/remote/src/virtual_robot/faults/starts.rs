//! Orders in which the boards start, and faults present at power-on.

use super::bench::FaultBench;
use super::entry::{AXLES, BEAM, Entry, at, entries};
use super::power::{beam, crystal, wheel_board};
use core_algos::safety::Condition;
use core_algos::topology::Role;
use host_sim::run::robot::Robot;

/// Checks that the LED of the front board flashed 20 times a second.
fn blinks_fast(bench: &mut FaultBench) -> Option<String> {
    let mut halves = 0;
    let mut spans = Vec::new();
    bench.axle(Role::LEAD, |axle, _| {
        spans = axle
            .led
            .windows(2)
            .map(|edges| (edges[1] - edges[0]).micros())
            .collect();
        halves = spans
            .iter()
            .filter(|us| (24_500..25_500).contains(*us))
            .count();
    });
    (halves < 20)
        .then(|| format!("{halves} half periods of blinking at the LED: must be at least 20"))
}

/// Checks that a board has reported that another board has the same role.
fn names_the_role(bench: &mut FaultBench) -> Option<String> {
    let mut changes = bench.robot.monitor().changes().iter();
    let named = changes.any(|status| status.reason == Some(Condition::RoleTaken));
    (!named).then(|| "no node reports that its role is taken".to_owned())
}

pub fn entries() -> Vec<Entry> {
    [orders(), buses(), others()].concat()
}

fn orders() -> Vec<Entry> {
    entries! {
        "boards powered together", "power", start(&[]).goes_on();
        "front board a second later", "power", start(&[]).late(Role::LEAD, 1000).goes_on();
        "{axle} board a second later", "power", start(&[]).late(Role::axle(1), 1000).goes_on();
        "{frame} board a second later", "power", start(&[]).late(Role::beam(0), 1000).goes_on();
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
                for (piece, role) in (2..).zip(b.robot.topology.boards()) {
                    b.piece(role, piece);
                }
            }),
            at(500, |b| {
                b.robot.topology.boards().for_each(|role| b.piece(role, 0))
            }),
        ]).goes_on();
    }
}

fn buses() -> Vec<Entry> {
    entries! {
        "bus open", "wire", start(&[at(0, |b| b.piece(Role::axle(1), 2))]);
        "no acknowledgement from the start", "wire", start(&[at(0, |b| {
            for (piece, role) in (2..).zip(b.robot.topology.boards()) {
                b.piece(role, piece);
            }
        })]);
        "transceiver dead from the start", "transceiver", start(&[at(0, |b| {
            let role = b.wheel().0;
            b.transceiver(role, false, false);
        })]);
        "transceiver of the beam dead from the start", "transceiver", start(&[at(0, |b| { let beam = b.frame(); b.transceiver(beam, false, false) })])
            .unready();
        "bus held dominant from the start", "wire", start(&[at(0, |b| {
            use virtual_board::wire::{Fault, Level};
            b.wire(Fault::Level(Some(Level::Dominant)));
        })]);
    }
}

fn others() -> Vec<Entry> {
    entries! {
        "crystal dead for the first 4.5 s", "crystal", start(&[
            at(0, |b| crystal(b, FaultBench::any, false)),
            at(4500, |b| crystal(b, FaultBench::any, true)),
        ]).goes_on().must_reset().finds(&["reset"]);
        "crystal of an axle's board dead for good", "crystal", start(&[at(0, |b| crystal(b, wheel_board, false))])
            .resets(AXLES).finds(&["reset"]);
        "crystal of the beam's board dead for good", "crystal", start(&[at(0, |b| crystal(b, beam, false))])
            .unready().resets(BEAM).finds(&["reset"]);
        "crystal of the front board at 12 MHz", "crystal", start(&[])
            .vary(|role, chip| if role == Role::LEAD { chip.crystal_hz = 12_000_000 })
            .resets(AXLES).check(blinks_fast).finds(&["reset"]);
        "slow oscillators at 17 kHz", "LSI", start(&[]).vary(|_, chip| chip.slow_hz = 17_000).goes_on();
        "slow oscillators at 47 kHz", "LSI", start(&[]).vary(|_, chip| chip.slow_hz = 47_000).goes_on();
        "internal oscillators 4 % slow", "HSI", start(&[]).vary(|_, chip| chip.internal_hz = 15_360_000).goes_on();
        "strap of the {axle} board broken: two front boards", "PC13", start(&[at(0, |b| {
            b.axle(Role::axle(1), |axle, _| axle.strap(false));
        })]).check(names_the_role);
        "emergency stop open from the start", "contact", start(&[at(0, |b| {
            let role = b.wheel().0;
            b.axle(role, |axle, now| axle.stop(true, now));
        })]);
    }
}
