//! Faults of the program and external disturbances: debuggers, log readers, button and strap, wild stores.

use super::bench::FaultBench;
use super::entry::{Entry, at, entries};
use core_algos::safety::Condition::{self, *};
use core_algos::topology::Role;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::device::Drv8874;

/// Permitted reasons of a stop after a board has halted or restarted.
const HALTED: &[Condition] = &[
    NeighbourLost,
    NeighbourFault,
    CommandTimeout,
    TickOverrun,
    Restarted,
    TrackingLost,
    WrenchHigh,
];
/// Exception number of the current loop's handler.
const ADC: u16 = 16 + 18;
/// Exception number of the tick's executor.
const TICK: u16 = 16 + 52;
/// Start of the RAM. The code of a wild store is placed here, at the unused end of the stack.
const RAM: u32 = 0x2000_0000;
/// Address at which the chip has no memory.
const UNMAPPED: u32 = 0x3000_0000;
/// Findings of a processor fault: the fault itself, frames lost during the wait for the reset, the reset.
const CRASH: &[&str] = &["fault", "bus error", "unmapped", "overrun", "reset"];
/// Findings of a processor fault at the guard below the stack.
const GUARDED: &[&str] = &["fault", "overrun", "reset"];
/// Limit of the time from a processor fault to the last PWM pulse, s.
const AT_ONCE_S: f64 = 1e-3;

/// Limit of the time to the last PWM pulse of a board whose current loop hangs, s: the timeout of the window watchdog.
pub const WATCHDOG_S: f64 = 0.01;

fn hold(bench: &mut FaultBench, held: bool) {
    let role = bench.wheel().0;
    bench.board(role, |board| board.hold(held));
}

/// Checks, 1 ms after the core was halted, that the motors have been off for 0.9 ms.
fn without_pulses(bench: &mut FaultBench) {
    let role = bench.wheel().0;
    let mut pulses = false;
    bench.axle(role, |axle, now| {
        let recent = |driver: &Drv8874| now - driver.latest_edge().0 < Time::from_micros(900);
        pulses = axle.drivers.iter().any(|d| d.is_enabled() || recent(d));
    });
    if pulses {
        bench.violation = Some("pulses while the core was halted".to_owned());
    }
}

/// Checks that only software has reset the affected board, so that the fault is counted once.
pub fn by_the_program(bench: &mut FaultBench) -> Option<String> {
    let affected = bench.robot.topology.name(bench.affected?);
    let reports = bench.robot.reports();
    let report = reports.iter().find(|report| report.name == affected)?;
    let other = report.resets.iter().find(|(_, cause)| *cause != "software");
    other.map(|(time_s, cause)| format!("reset by {cause} at {time_s:.3} s"))
}

fn hold_beam(bench: &mut FaultBench, held: bool) {
    let beam = bench.frame();
    bench.board(beam, |board| board.hold(held));
}

/// Runs a board until it is in this exception. The board may then be a few µs ahead of the other boards.
fn run_into(board: &mut Board, exception: u16) {
    let (core, chip) = board.parts();
    for _ in 0..1_000_000 {
        if core.exception() == exception {
            return;
        }
        let until = core.cycles() + 1_000;
        core.step(chip, until);
    }
}

/// Makes the core run `str r0, [r1]` with this address in r1, then an endless loop.
fn store_to(board: &mut Board, address: u32) {
    const CODE: [u8; 4] = [0x08, 0x60, 0xfe, 0xe7];
    if let Some(place) = board.chip().sram().get_mut(..CODE.len()) {
        place.copy_from_slice(&CODE);
    }
    let core = board.core_mut();
    core.set_register(0, 0xdead_beef);
    core.set_register(1, address);
    core.set_register(15, RAM);
}

/// Makes an axle board store to `address`, inside the handler of `exception` if given.
fn wild_store(bench: &mut FaultBench, exception: Option<u16>, address: u32) {
    let role = bench.wheel().0;
    bench.board(role, |board| {
        if let Some(exception) = exception {
            run_into(board, exception);
        }
        store_to(board, address);
    });
}

pub fn entries() -> Vec<Entry> {
    [tools(), hands(), faults()].concat()
}

fn tools() -> Vec<Entry> {
    entries! {
        "log host stops reading, buffer in blocking mode", "RTT", drive(|b| {
            let role = b.wheel().0;
            b.robot.hang_reader(role);
        }).goes_on();
        "debugger halts an axle's board for 1 ms", "debug port", steps(&[at(0, |b| hold(b, true)), at(1, |b| {
            without_pulses(b);
            hold(b, false);
        })])
            .goes_on().stops(HALTED).finds(&["overrun"]);
        "debugger halts an axle's board for 10 ms", "debug port", steps(&[at(0, |b| hold(b, true)), at(10, |b| hold(b, false))])
            .goes_on().stops(HALTED).finds(&["overrun"]);
        "debugger halts an axle's board for 100 ms", "debug port", steps(&[at(0, |b| hold(b, true)), at(100, |b| hold(b, false))])
            .stops(HALTED).finds(&["overrun"]);
        "debugger halts an axle's board for 1000 ms", "debug port", steps(&[at(0, |b| hold(b, true)), at(1000, |b| hold(b, false))])
            .stops(HALTED).finds(&["overrun"]);
        "debugger halts the beam's board for 100 ms", "debug port", steps(&[at(0, |b| hold_beam(b, true)), at(100, |b| hold_beam(b, false))])
            .goes_on().finds(&["overrun"]);
        "debugger halts the beam's board for 1000 ms", "debug port", steps(&[at(0, |b| hold_beam(b, true)), at(1000, |b| hold_beam(b, false))])
            .goes_on().finds(&["overrun"]);
    }
}

/// Presses the button from `from_us` for `span_us`, with contact bounce.
fn press(bench: &mut FaultBench, from_us: u64, span_us: u64) {
    bench.axle(Role::LEAD, |axle, now| {
        axle.press(true, now + Time::from_micros(from_us));
        axle.press(false, now + Time::from_micros(from_us + span_us));
    });
}

fn hands() -> Vec<Entry> {
    entries! {
        "button touched for 20 ms", "button", drive(|b| { press(b, 0, 20_000) }).goes_on();
        "button bounces for 60 ms", "button", drive(|b| {
            for k in 0..8 {
                press(b, 8_000 * k, 4_000 + 200 * k);
            }
        }).goes_on();
        "strap of an axle's board changed", "PC13", drive(|b| {
            let role = b.wheel().0;
            b.axle(role, |axle, _| axle.strap(role == Role::LEAD));
        }).goes_on();
    }
}

fn faults() -> Vec<Entry> {
    [crashes(), hangs()].concat()
}

fn crashes() -> Vec<Entry> {
    entries! {
        "wild store to nowhere", "program", drive(|b| { wild_store(b, None, UNMAPPED); })
            .stops(HALTED).own_within(AT_ONCE_S).restarts().check(by_the_program).finds(CRASH);
        "wild store below the stack", "program", drive(|b| {
            let role = b.wheel().0;
            let end = b.end_of_stack(role).unwrap_or(RAM);
            wild_store(b, Some(TICK), end - 64);
        }).stops(HALTED).own_within(AT_ONCE_S).restarts().check(by_the_program).finds(GUARDED);
        "wild store into the flash", "program", drive(|b| { wild_store(b, Some(TICK), 0x0800_4000); })
            .stops(HALTED).restarts().finds(&["reset", "flash", "overrun"]);
        "stack overflow", "program", drive(|b| {
            let role = b.wheel().0;
            let end = b.end_of_stack(role).unwrap_or(RAM);
            b.board(role, |board| {
                run_into(board, TICK);
                board.core_mut().set_register(13, end + 8);
            });
        }).stops(HALTED).own_within(AT_ONCE_S).restarts().check(by_the_program).finds(CRASH);
        "HardFault in the current loop", "program", drive(|b| {
            let role = b.wheel().0;
            b.board(role, |board| {
                run_into(board, ADC);
                board.core_mut().set_register(15, UNMAPPED);
            });
        }).stops(HALTED).own_within(AT_ONCE_S).restarts().check(by_the_program).finds(CRASH);
        "HardFault of the beam's board", "program", drive(|b| {
            let beam = b.frame();
            b.board(beam, |board| {
                run_into(board, TICK);
                board.core_mut().set_register(15, UNMAPPED);
            });
        }).goes_on().restarts().check(by_the_program).finds(CRASH);
    }
}

fn hangs() -> Vec<Entry> {
    entries! {
        "the tick of an axle's board hangs", "program", drive(|b| { wild_store(b, Some(TICK), RAM + 16); })
            // If the tick hangs in a critical section, the handlers of the bus are blocked too, so received frames are
            // lost (overrun).
            .stops(HALTED).own_within(0.01).restarts().finds(&["reset", "overrun"]);
        "the current loop of an axle's board hangs", "program", drive(|b| {
            wild_store(b, Some(ADC), RAM + 16);
        }).stops(HALTED).own_within(WATCHDOG_S).restarts().finds(&["reset", "overrun"]);
        "emergency stop while the current loop hangs", "program, contact", steps(&[
            at(0, |b| {
                wild_store(b, Some(ADC), RAM + 16);
                let role = b.wheel().0;
                b.axle(role, |axle, now| axle.stop(true, now));
            }),
            at(300, |b| {
                let role = b.wheel().0;
                b.axle(role, |axle, now| axle.stop(false, now));
            }),
        ]).stops(HALTED).own_within(WATCHDOG_S).restarts().finds(&["reset", "overrun"]);
    }
}
