//! Faults of converter, strain bridges, inertial sensor and encoders.

use super::bench::FaultBench;
use super::entry::{AXLES, Entry, at, entries};
use super::program::WATCHDOG_S;
use core_algos::safety::Condition::{
    self, CommandTimeout, ConversionsLost, DegradedTooLong, EstimateInconsistent, FrameBent,
    InertialLost, MotorStall, MotorUnresponsive, NeighbourFault, NeighbourLost, Restarted,
    TrackingLost, WheelSlip, WrenchHigh,
};
use core_algos::topology::{Node, Role};
use virtual_board::Time;
use virtual_board::chip::InjectedFaults;
use virtual_board::device::{BridgeFault, EncoderFault, InertialFault, Line};

/// Findings if the converter's DMA requests are not served.
const OVERRUN: &[&str] = &["overrun"];
/// Permitted reasons of a stop after a fault of a strain bridge.
const STRAINS: &[Condition] = &[EstimateInconsistent, WrenchHigh, FrameBent, DegradedTooLong];
/// Permitted reasons of a stop after a fault of an encoder, a motor, a wheel's contact or a gyro.
pub(super) const WHEELS: &[Condition] = &[
    TrackingLost,
    WheelSlip,
    Condition::EncoderFault,
    MotorStall,
    MotorUnresponsive,
    EstimateInconsistent,
    WrenchHigh,
    FrameBent,
];

fn injected_faults(bench: &mut FaultBench, role: Role, change: fn(&mut InjectedFaults)) {
    bench.board(role, |board| change(board.chip().injected_faults()));
}

fn bridge(bench: &mut FaultBench, fault: BridgeFault) {
    let place = bench.draw(5) as usize;
    bench.beam(|beam, now| {
        if let Some(bridge) = beam.bridge(place) {
            bridge.set_fault(now, fault);
        }
    });
}

fn inertial(bench: &mut FaultBench, change: fn(&mut InertialFault)) {
    let mut fault = InertialFault::default();
    change(&mut fault);
    bench.at_wheel(|axle, _, now| {
        if let Some(inertial) = &mut axle.inertial {
            inertial.set_fault(now, fault);
        }
    });
}

/// Checks that the lead node has no notice at the end; otherwise gives the worst notice.
fn degraded(bench: &mut FaultBench) -> Option<String> {
    let notices = bench.robot.monitor.latest(Node::Lead)?.notices;
    let worst = notices.worst()?.entry().name;
    Some(format!("notice at the end: {worst}"))
}

/// Difference between the encoder's counter and the edges of the encoder's disc, in words; `None` if the difference is
/// small enough.
fn miscounted(bench: &mut FaultBench) -> Option<String> {
    /// Limit of the difference, counts: counter and disc start within one encoder line (four counts), and the filter
    /// may hold one line back.
    const APART: u16 = 8;
    /// Addresses of the counters (CNT) of TIM3 and TIM4.
    const COUNTERS: [u32; 2] = [0x4000_0424, 0x4000_0824];
    let (role, side) = bench.wheel();
    let counted = bench.register(role, COUNTERS[side]) as u16;
    let mut passed = 0;
    bench.axle(role, |axle, _| passed = axle.encoders[side].count() as u16);
    let off = counted.wrapping_sub(passed) as i16;
    (off.unsigned_abs() > APART).then(|| format!("counter off by {off}"))
}

fn encoder(bench: &mut FaultBench, change: fn(&mut EncoderFault)) {
    let mut fault = EncoderFault::default();
    change(&mut fault);
    bench.at_wheel(|axle, side, _| axle.encoders[side].set_fault(fault));
}

pub fn entries() -> Vec<Entry> {
    [analogue(), inertials(), encoders()].concat()
}

fn analogue() -> Vec<Entry> {
    entries! {
        "converter overrun: the DMA stalls for 1 ms", "DMA2 of the beam", steps(&[
            at(0, |b| {
                b.advance_randomly();
                let beam = b.frame();
                injected_faults(b, beam, |d| d.dma_waits = true);
            }),
            at(1, |b| { let beam = b.frame(); injected_faults(b, beam, |d| d.dma_waits = false) }),
        ]).goes_on().notices(ConversionsLost).check(degraded).finds(OVERRUN);
        "DMA bus error", "DMA2 of the beam", drive(|b| {
            b.advance_randomly();
            let beam = b.frame();
            injected_faults(b, beam, |d| d.dma_error = true);
        }).goes_on().notices(ConversionsLost).check(degraded).finds(&["overrun", "bus error"]);
        "excitation lost", "strip", drive(|b| { b.beam(|beam, now| beam.excite(now, 0.0)); }).goes_on();
        "a bridge open, up", "strip", drive(|b| { bridge(b, BridgeFault::Open { up: true }) })
            .goes_on().stops(STRAINS);
        "a bridge open, down", "strip", drive(|b| { bridge(b, BridgeFault::Open { up: false }) })
            .goes_on().stops(STRAINS);
        "an amplifier saturated, up", "strip", drive(|b| { bridge(b, BridgeFault::Saturated { up: true }); })
            .goes_on().stops(STRAINS);
        "an amplifier saturated, down", "strip", drive(|b| { bridge(b, BridgeFault::Saturated { up: false }); })
            .goes_on().stops(STRAINS);
        "one injected conversion missing", "ADC1 of an axle", drive(|b| {
            let role = b.wheel().0;
            injected_faults(b, role, |d| d.triggers_lost = 1);
        }).goes_on();
        "injected conversions missing for good", "ADC1 of an axle", drive(|b| {
            let role = b.wheel().0;
            injected_faults(b, role, |d| d.triggers_lost = u32::MAX);
        })
            .stops(&[NeighbourLost, NeighbourFault, CommandTimeout, Restarted]).own_within(WATCHDOG_S).resets(AXLES).finds(&["reset"]);
        "thermistor of the drivers open", "PC3", drive(|b| {
            b.at_wheel(|axle, _, _| axle.thermistor.open = true);
        }).goes_on();
    }
}

fn inertials() -> Vec<Entry> {
    entries! {
        "inertial sensor's output stuck low", "SPI1", drive(|b| {
            inertial(b, |f| f.stuck_output = Some(false));
        }).goes_on().notices(InertialLost);
        "inertial sensor's output stuck high", "SPI1", drive(|b| {
            inertial(b, |f| f.stuck_output = Some(true));
        }).goes_on().notices(InertialLost);
        "inertial sensor resets itself", "ICM-42688-P", drive(|b| {
            b.at_wheel(|axle, _, now| {
                if let Some(inertial) = &mut axle.inertial {
                    inertial.reset(now);
                }
            });
        }).goes_on().notices(InertialLost);
        "inertial sensor's samples stand still (no DRDY line: it is polled)", "ICM-42688-P", drive(|b| {
            inertial(b, |f| f.frozen = true);
        }).goes_on().stops(WHEELS);
        "inertial sensor signals no data (DRDY)", "ICM-42688-P", drive(|b| {
            inertial(b, |f| f.no_data_ready = true);
        }).goes_on();
    }
}

fn encoders() -> Vec<Entry> {
    entries! {
        "encoder line A stuck", "encoder", drive(|b| { encoder(b, |f| f.stuck_a = Some(true)); }).stops(WHEELS);
        "encoder line B stuck", "encoder", drive(|b| { encoder(b, |f| f.stuck_b = Some(false)); })
            .stops(WHEELS);
        "encoder unplugged", "encoder", drive(|b| {
            encoder(b, |f| (f.stuck_a, f.stuck_b) = (Some(true), Some(true)));
        }).stops(WHEELS);
        "encoder lines swapped", "encoder", drive(|b| { encoder(b, |f| f.swapped = true); }).stops(WHEELS);
        "2000 glitches of 200 ns on encoder lines", "encoder", drive(|b| {
            let mut from = b.now();
            for _ in 0..2000 {
                from = from + Time::from_nanos(50_000 + b.draw(400_000));
                // Without the filter, a glitch on one channel counts up and down again; overlapping glitches on both
                // channels count four edges up.
                b.at_wheel(|axle, side, _| {
                    for (line, after) in [(Line::A, 0), (Line::B, 100)] {
                        let from = from + Time::from_nanos(after);
                        axle.encoders[side].glitch(line, from, Time::from_nanos(200));
                    }
                });
            }
        }).goes_on().check(miscounted);
    }
}
