//! Faults of supplies and crystals.

use super::bench::FaultBench;
use super::entry::{ALL, AXLES, BEAM, Entry, STOP_S, at, entries};
use super::program::by_the_program;
use core_algos::safety::Condition::{self, *};
use core_algos::topology::Role;
use virtual_board::Time;
use virtual_board::device::Profile;

/// Permitted reasons of a stop after a board without supply for 0.2 s, or after its reset pin was pulled.
const GONE: &[Condition] = &[NeighbourLost, NeighbourFault, CommandTimeout, BusOff];
/// Permitted reasons of a stop after a failed crystal or a supply dip has reset boards.
const FAILED: &[Condition] = &[
    NeighbourLost,
    NeighbourFault,
    CommandTimeout,
    BusOff,
    Restarted,
    TickOverrun,
];

/// Board of the axle with the affected wheel.
pub fn wheel_board(bench: &mut FaultBench) -> Role {
    bench.wheel().0
}

/// Role of the board of the affected frame.
pub fn beam(bench: &mut FaultBench) -> Role {
    bench.frame()
}

/// Sets the battery's open-circuit voltage from now on.
fn battery(bench: &mut FaultBench, volts: f64) {
    let robot = bench.robot.topology;
    for role in robot.axles().map(Role::Axle) {
        bench.axle(role, |axle, _| {
            axle.power.battery.open_v = Profile::constant(volts);
        });
    }
}

/// Lowers the 3.3 V rail of a board to `volts` for `span_us`.
fn dip(bench: &mut FaultBench, which: fn(&mut FaultBench) -> Role, volts: f64, span_us: u64) {
    let role = which(bench);
    let span = Time::from_micros(span_us);
    match role {
        Role::Beam(_) => bench.beam(|beam, now| beam.power.dip(now, now + span, volts)),
        _ => bench.axle(role, |axle, now| axle.power.dip(now, now + span, volts)),
    }
}

/// Starts or stops the crystal of a board.
pub fn crystal(bench: &mut FaultBench, which: fn(&mut FaultBench) -> Role, works: bool) {
    match which(bench) {
        Role::Beam(_) => bench.beam(|beam, now| beam.power.crystal(now, works)),
        role => bench.axle(role, |axle, now| axle.power.crystal(now, works)),
    }
}

fn power(bench: &mut FaultBench, which: fn(&mut FaultBench) -> Role, on: bool) {
    let role = which(bench);
    bench.board(role, |board| board.power(on));
}

pub fn entries() -> Vec<Entry> {
    [crystals(), batteries(), rails()].concat()
}

fn crystals() -> Vec<Entry> {
    entries! {
        "crystal of an axle's board fails", "crystal", steps(&[
            at(0, |b| crystal(b, wheel_board, false)),
            at(300, |b| crystal(b, wheel_board, true)),
        ]).stops(FAILED).own_within(0.003).restarts().finds(&["reset", "overrun"]);
        "crystal of an axle's board fails for good", "crystal", drive(|b| crystal(b, wheel_board, false))
            .stops(FAILED).own_within(0.003).resets(ALL).finds(&["reset", "overrun"]);
        "crystal of the beam's board fails", "crystal", drive(|b| { crystal(b, beam, false) })
            .goes_on().resets(BEAM).finds(&["reset", "overrun"]);
    }
}

fn batteries() -> Vec<Entry> {
    entries! {
        "battery sags to 10.3 V for 0.5 s", "battery", steps(&[at(0, |b| battery(b, 10.3)), at(500, |b| battery(b, 12.0))])
            .notices(SupplyWarning).goes_on();
        "battery sags to 8 V for 0.1 s", "battery", steps(&[at(0, |b| battery(b, 8.0)), at(100, |b| battery(b, 12.0))])
            .stops(&[SupplyLow]).within(STOP_S);
        "battery at 18 V", "battery", drive(|b| battery(b, 18.0)).stops(&[SupplyHigh]).within(STOP_S);
    }
}

fn rails() -> Vec<Entry> {
    entries! {
        "rail of an axle's board at 2.4 V for 0.5 ms", "3.3 V", drive(|b| { dip(b, wheel_board, 2.4, 500) })
            .stops(FAILED).own_within(0.001).restarts().check(by_the_program).finds(&["reset"]);
        "rail of an axle's board at 2.4 V for 0.5 ms, brown-out level 3", "3.3 V, option bytes", drive(|b| { dip(b, wheel_board, 2.4, 500) })
            .vary(|_, chip| chip.brown_out = 0).stops(FAILED).own_within(0.001).resets(AXLES);
        "rail of the beam's board at 2.4 V for 0.5 ms", "3.3 V", drive(|b| { dip(b, beam, 2.4, 500) })
            .goes_on().restarts().check(by_the_program).finds(&["reset"]);
        "rail at 2.95 V for 5 ms", "3.3 V", drive(|b| { dip(b, wheel_board, 2.95, 5000) }).goes_on();
        "an axle's board without power for 0.2 s", "board's supply", steps(&[
            at(0, |b| power(b, wheel_board, false)),
            at(200, |b| power(b, wheel_board, true)),
        ]).stops(GONE).own_within(0.001);
        "the beam's board without power for 0.2 s", "board's supply", steps(&[
            at(0, |b| power(b, beam, false)),
            at(200, |b| power(b, beam, true)),
        ]).goes_on();
        "reset pin of an axle's board", "reset pin", drive(|b| {
            let role = b.wheel().0;
            b.board(role, |board| board.reset());
        }).stops(GONE).own_within(0.001).resets(AXLES);
    }
}
