//! Faults of drivers, motors and current sensing.

use super::bench::FaultBench;
use super::entry::{Entry, at, entries};
use core_algos::safety::Condition::{self, *};
use virtual_board::Time;
use virtual_board::device::{AmplifierFault, Half};

/// Permitted reasons of a stop after a fault of a motor, a transistor or the current sensing.
const MOTOR: &[Condition] = &[
    TrackingLost,
    WheelSlip,
    EncoderFault,
    MotorStall,
    MotorUnresponsive,
    EstimateInconsistent,
    WrenchHigh,
    FrameBent,
    OverCurrent,
    StopNotFollowed,
];
/// Permitted reason of a stop after a stuck transistor: the driver reports a fault. The wheel brakes through the
/// transistor until the wheel is at rest, so current flows until then.
const NOTICED: &[Condition] = &[DriverFault];
/// Limit of the time until a motor is off after a fault that cuts the motor, s: detection time of the condition, a few
/// ticks, and the millisecond in which the driver falls asleep.
const CUT_S: f64 = 0.02;

fn driver_fault(bench: &mut FaultBench, after_us: u64, span_us: u64) {
    bench.at_wheel(|axle, side, now| {
        let from = now + Time::from_micros(after_us);
        axle.force_fault(side, from, from + Time::from_micros(span_us));
    });
}

fn sense(bench: &mut FaultBench, fault: AmplifierFault) {
    bench.at_wheel(|axle, side, _| axle.amplifiers[side].set_fault(fault));
}

/// Half bridge of a motor by its part in the present direction of the wheel.
#[derive(Clone, Copy)]
enum Part {
    /// Pulse-width modulated.
    Drives,
    /// Low all the time.
    Returns,
}

/// Keeps a transistor of a half bridge of the wheel on. The lower one of the half that returns the current is on anyway.
fn stuck(bench: &mut FaultBench, part: Part, upper: bool) {
    bench.at_wheel(|axle, side, now| {
        let driver = &mut axle.drivers[side];
        let half = match (part, driver.is_forward()) {
            (Part::Drives, true) | (Part::Returns, false) => Half::One,
            (Part::Drives, false) | (Part::Returns, true) => Half::Two,
        };
        driver.set_stuck(half, Some(upper), now);
    });
}

/// Checks that the LED of the affected board blinks the code of the emergency stop, 0x80.
fn blinks_code(bench: &mut FaultBench) -> Option<String> {
    let from = bench.now();
    bench.run_for(10_000);
    let mut digits = Vec::new();
    bench.axle(bench.affected?, |axle, _| {
        let edges: Vec<f64> = axle.led.iter().map(|at| at.seconds()).collect();
        // The LED is lit from each even edge to the next.
        for lit in edges.chunks_exact(2).filter(|lit| lit[0] > from.seconds()) {
            let dark = digits
                .last()
                .map_or(f64::MAX, |&(_, end): &(u32, f64)| lit[0] - end);
            let long = lit[1] - lit[0] > 0.5;
            match digits.last_mut() {
                Some(last) if dark < 0.5 && !long => *last = (last.0 + 1, lit[1]),
                _ => digits.push((u32::from(!long), lit[1])),
            }
        }
    });
    let digits: Vec<u32> = digits.into_iter().map(|(digit, _)| digit).collect();
    let shows = digits
        .windows(3)
        .any(|three| matches!(three, [8, 0, _] | [_, 8, 0]));
    (!shows).then(|| format!("digits on the LED {digits:?}: must be 8, 0"))
}

pub fn entries() -> Vec<Entry> {
    [drivers(), motors()].concat()
}

fn drivers() -> Vec<Entry> {
    entries! {
        // The fault is repeated ten times, because the current loop detects about six of ten.
        "nFAULT low for 30 µs", "DRV8874", steps(&[0, 10, 20, 30, 40, 50, 60, 70, 80, 90].map(|ms| {
            at(ms, |b| {
                let after_us = b.draw(50);
                driver_fault(b, after_us, 30);
            })
        })).goes_on();
        "nFAULT low for 20 ms", "DRV8874", drive(|b| { driver_fault(b, 0, 20_000) })
            .stops(&[DriverFault]).own_within(CUT_S);
        "nFAULT low for good", "DRV8874", drive(|b| { driver_fault(b, 0, 60_000_000) })
            .stops(&[DriverFault]).own_within(CUT_S);
        "current sense stuck high", "INA240", drive(|b| { sense(b, AmplifierFault::Stuck(0.99)); })
            .stops(&[OverCurrent]).own_within(CUT_S);
        "current sense stuck low", "INA240", drive(|b| { sense(b, AmplifierFault::Stuck(0.0)); })
            .stops(&[OverCurrent]).own_within(CUT_S);
    }
}

fn motors() -> Vec<Entry> {
    entries! {
        "current sense shorted", "INA240", drive(|b| { sense(b, AmplifierFault::ShuntShort) })
            .goes_on().stops(MOTOR);
        "motor open", "motor's lead", drive(|b| {
            b.at_wheel(|axle, side, now| axle.drivers[side].set_motor_open(true, now));
        }).goes_on().stops(MOTOR);
        "motor stalled", "wheel", drive(|b| {
            let (role, side) = b.wheel();
            b.robot.blocked = Some((b.robot.topology.place(role), side));
        }).stops(MOTOR);
        "driving half bridge stays high", "DRV8874", drive(|b| { stuck(b, Part::Drives, true); })
            .stops(MOTOR).stops(NOTICED);
        "driving half bridge stays low", "DRV8874", drive(|b| { stuck(b, Part::Drives, false); })
            .stops(MOTOR).stops(NOTICED);
        "returning half bridge stays high", "DRV8874", drive(|b| { stuck(b, Part::Returns, true); })
            .stops(MOTOR).stops(NOTICED);
        "emergency stop", "contact", drive(|b| {
            let (role, _) = b.wheel();
            b.axle(role, |axle, now| axle.stop(true, now));
        }).stops(&[EmergencyStop]).own_within(CUT_S).check(blinks_code);
    }
}
