//! Faults put in at the seams of a simulated robot: sensors, motors, frame, bus, boards.
//!
//! [`CATALOGUE`] says what each fault does and how a run with it may end; [`Injector`] does it.

mod inject;

pub use crate::bus::virtual_bus::Disturbance;
pub use inject::{Drift, Injector, Readings};

use self::Fault::*;
use core_algos::safety::{Condition, Condition as C};
use core_algos::topology::Role;

/// A wheel: axle (0 front, 1 rear) and side (0 left, 1 right).
pub type Wheel = (usize, usize);

/// Fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Nothing: the campaign's own check.
    None,
    /// The bus is disturbed.
    Bus(Disturbance),
    /// All frames from and to this board are lost.
    Partition(Role),
    /// A board loses its supply and starts again so many ms later.
    Reset(Role, u32),
    /// A board loses its supply for good.
    Loss(Role),
    /// A board stands still for so many ms, its outputs as they were, and goes on.
    Freeze(Role, u32),
    /// A board's clock runs slow: one tick in so many is missing.
    SlowClock(Role, u32),
    /// Bridges (from the first, so many) read a rail: 0 or full scale.
    GaugeRail(usize, bool),
    /// A bridge repeats its last reading.
    GaugeStuck(usize),
    /// A bridge's reading moves so many counts a second.
    GaugeDrift(usize, f64),
    /// An encoder repeats its last reading.
    EncoderStuck(Wheel),
    /// An encoder's count jumps by so much every 50 ms.
    EncoderJumps(Wheel, i32),
    /// The encoders of an axle are exchanged.
    EncodersSwapped(usize),
    /// An encoder gives nothing.
    EncoderMissing(Wheel),
    /// The gyro of an axle gives what is not a number.
    GyroNotANumber(usize),
    /// The gyro of an axle is off by so much, rad/s.
    GyroBias(usize, f32),
    /// The accelerometer of an axle gives nothing.
    AccelerometerMissing(usize),
    /// A motor gives this share of its torque.
    MotorWeak(Wheel, f64),
    /// A motor gives this torque (N m) whenever its bridge is on.
    MotorStuckOn(Wheel, f64),
    /// A wheel does not touch the ground.
    WheelLifted(Wheel),
    /// The frame is in two pieces.
    FrameSnapped,
    /// The drivers of an axle report a condition for so many ms (0: for good) while their motors
    /// give the share of the torque.
    Reported(usize, Condition, u32, f64),
}

/// Fault with the allowed outcomes of its runs.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name in tables.
    pub name: &'static str,
    /// The fault.
    pub fault: Fault,
    /// True if the robot may finish its task, within the tolerance of an undisturbed run.
    pub finish: bool,
    /// Codes that may be the first reason of a stop; empty if the robot must not stop.
    pub codes: &'static [Condition],
    /// Longest time from the fault to rest with motors off, s.
    pub stop_within_s: f64,
}

/// A fault after which the robot may finish, or stop with one of `codes` within `stop_within_s`.
const fn survives(
    name: &'static str,
    fault: Fault,
    codes: &'static [Condition],
    stop_within_s: f64,
) -> Entry {
    Entry {
        name,
        fault,
        finish: true,
        codes,
        stop_within_s,
    }
}

/// A fault after which the robot must finish.
const fn harmless(name: &'static str, fault: Fault) -> Entry {
    survives(name, fault, &[], 0.0)
}

/// A fault after which the robot must stop.
const fn stops(
    name: &'static str,
    fault: Fault,
    codes: &'static [Condition],
    stop_within_s: f64,
) -> Entry {
    Entry {
        finish: false,
        ..survives(name, fault, codes, stop_within_s)
    }
}

/// Codes of a lost or late message.
const SILENCE: &[Condition] = &[C::CommandTimeout, C::NeighbourLost, C::NeighbourFault];
/// Codes of messages with wrong contents or times.
const CORRUPTION: &[Condition] = &[
    C::CommandTimeout,
    C::NeighbourLost,
    C::NeighbourFault,
    C::EstimateInconsistent,
    C::TrackingLost,
    C::WrenchHigh,
    C::FrameBent,
    C::WheelSlip,
    // A stop begins from the last reference, which may be a wrong one: then the motors are cut.
    C::StopNotFollowed,
];
/// Codes of faulty wheels.
const WHEELS: &[Condition] = &[
    C::TrackingLost,
    C::WheelSlip,
    C::EncoderFault,
    C::MotorStall,
    C::MotorUnresponsive,
    C::EstimateInconsistent,
    C::WrenchHigh,
    C::FrameBent,
];
/// Codes of wrong gauges.
const GAUGES: &[Condition] = &[
    C::EstimateInconsistent,
    C::WrenchHigh,
    C::FrameBent,
    C::DegradedTooLong,
];

/// Codes that the loss of the beam may raise.
const NO_BEAM: &[Condition] = &[C::DegradedTooLong];

/// Every fault of the campaign.
pub const CATALOGUE: &[Entry] = &[
    harmless("none", Fault::None),
    harmless("bus loses 1 %", Bus(Disturbance::loss(0.01))),
    survives("bus loses 10 %", Bus(Disturbance::loss(0.1)), SILENCE, 60.0),
    survives("bus loses 50 %", Bus(Disturbance::loss(0.5)), SILENCE, 20.0),
    survives(
        "bus late by 20 ms",
        Bus(Disturbance::late(20)),
        SILENCE,
        2.0,
    ),
    survives(
        "bus reorders within 8 ms",
        Bus(Disturbance::jitter(8)),
        SILENCE,
        2.0,
    ),
    harmless("bus doubles 30 %", Bus(Disturbance::doubling(0.3))),
    survives(
        "bus corrupts 5 %",
        Bus(Disturbance::corruption(0.05)),
        CORRUPTION,
        20.0,
    ),
    survives("babbling node", Bus(Disturbance::BABBLE), SILENCE, 20.0),
    stops(
        "rear board cut off the bus",
        Partition(Role::Rear),
        SILENCE,
        1.5,
    ),
    survives(
        "beam board cut off the bus",
        Partition(Role::Beam),
        NO_BEAM,
        22.0,
    ),
    stops("front board resets", Reset(Role::Front, 200), SILENCE, 1.5),
    stops("rear board resets", Reset(Role::Rear, 200), SILENCE, 1.5),
    harmless("beam board resets", Reset(Role::Beam, 200)),
    stops("front board lost", Loss(Role::Front), SILENCE, 1.5),
    stops("rear board lost", Loss(Role::Rear), SILENCE, 1.5),
    survives("beam board lost", Loss(Role::Beam), NO_BEAM, 22.0),
    stops(
        "front board freezes 0.3 s",
        Freeze(Role::Front, 300),
        SILENCE,
        1.8,
    ),
    stops(
        "rear board freezes 0.3 s",
        Freeze(Role::Rear, 300),
        SILENCE,
        1.8,
    ),
    survives(
        "rear clock slow by 0.02 %, no common time",
        SlowClock(Role::Rear, 5000),
        CORRUPTION,
        20.0,
    ),
    survives(
        "rear clock slow by 0.2 %, no common time",
        SlowClock(Role::Rear, 500),
        CORRUPTION,
        20.0,
    ),
    harmless("gauge dead", GaugeRail(1, false)),
    harmless("gauge saturated", GaugeRail(1, true)),
    survives("all gauges dead", GaugeRail(5, false), NO_BEAM, 22.0),
    survives("gauge stuck", GaugeStuck(2), GAUGES, 22.0),
    survives("gauge drifts", GaugeDrift(2, 40.0), GAUGES, 22.0),
    stops("encoder stuck", EncoderStuck((1, 0)), WHEELS, 2.0),
    survives("encoder jumps", EncoderJumps((0, 0), 500), WHEELS, 2.0),
    survives("encoders swapped", EncodersSwapped(1), WHEELS, 20.0),
    stops("encoder missing", EncoderMissing((0, 1)), WHEELS, 1.5),
    survives(
        "gyro not a number",
        GyroNotANumber(0),
        &[C::NotANumber],
        1.5,
    ),
    survives("gyro off by 0.3 rad/s", GyroBias(1, 0.3), WHEELS, 10.0),
    harmless("accelerometer missing", AccelerometerMissing(0)),
    survives("motor open", MotorWeak((0, 0), 0.0), WHEELS, 20.0),
    survives("motor weak", MotorWeak((1, 1), 0.3), WHEELS, 20.0),
    stops("motor stuck on", MotorStuckOn((0, 1), 1.5), WHEELS, 3.5),
    survives("wheel lifted", WheelLifted((1, 0)), WHEELS, 20.0),
    stops(
        "frame snapped",
        FrameSnapped,
        &[
            C::EstimateInconsistent,
            C::FrameBent,
            C::WrenchHigh,
            C::TrackingLost,
        ],
        3.0,
    ),
    stops(
        "supply dips",
        Reported(1, C::SupplyLow, 150, 0.2),
        &[C::SupplyLow, C::NeighbourFault],
        1.5,
    ),
    stops(
        "driver too hot",
        Reported(0, C::OverTemperature, 0, 1.0),
        &[C::OverTemperature, C::NeighbourFault],
        1.8,
    ),
    stops(
        "over current",
        Reported(1, C::OverCurrent, 20, 1.0),
        &[C::OverCurrent, C::NeighbourFault],
        1.5,
    ),
    stops(
        "emergency stop",
        Reported(0, C::EmergencyStop, 0, 1.0),
        &[C::EmergencyStop, C::NeighbourFault],
        1.5,
    ),
];
