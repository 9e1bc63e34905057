//! Faults put in at the seams of a simulated robot: sensors, motors, frame, bus, boards.
//!
//! [`CATALOGUE`] says what each fault does and how a run with it may end; [`Injector`] does it.

mod inject;
mod run;

pub use crate::virtual_bus::Disturbance;
pub use inject::{Drift, Injector, Readings};
pub use run::{Bounds, Case, End, Outcome, TOLERANCE, run, run_on};

use core_algos::node::board::Role;
use core_algos::safety::Condition;
use core_algos::safety::Condition as C;

/// A wheel: axle (0 front, 1 rear) and side (0 left, 1 right).
pub type Wheel = (usize, usize);

/// What goes wrong.
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

/// How a fault's runs may end.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name in tables.
    pub name: &'static str,
    /// The fault.
    pub fault: Fault,
    /// Whether the robot may finish its task, within the tolerance of an undisturbed run.
    pub finish: bool,
    /// Whether it may stop, and the codes that may be the first reason.
    pub codes: &'static [Condition],
    /// Longest time from the fault to rest with motors off, s.
    pub stop_within_s: f64,
}

const fn entry(
    name: &'static str,
    fault: Fault,
    finish: bool,
    codes: &'static [Condition],
    stop_within_s: f64,
) -> Entry {
    Entry {
        name,
        fault,
        finish,
        codes,
        stop_within_s,
    }
}

/// What a lost or late message leads to.
const SILENCE: &[Condition] = &[C::CommandTimeout, C::NeighbourLost, C::NeighbourFault];
/// What messages with wrong contents, or of wrong times, lead to.
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
/// What wheels that do not do as they should lead to.
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
/// What gauges that lie lead to.
const GAUGES: &[Condition] = &[
    C::EstimateInconsistent,
    C::WrenchHigh,
    C::FrameBent,
    C::DegradedTooLong,
];

/// Every fault of the campaign.
pub const CATALOGUE: &[Entry] = &[
    entry("none", Fault::None, true, &[], 0.0),
    entry(
        "bus loses 1 %",
        Fault::Bus(Disturbance::loss(0.01)),
        true,
        &[],
        0.0,
    ),
    entry(
        "bus loses 10 %",
        Fault::Bus(Disturbance::loss(0.1)),
        true,
        SILENCE,
        60.0,
    ),
    entry(
        "bus loses 50 %",
        Fault::Bus(Disturbance::loss(0.5)),
        true,
        SILENCE,
        20.0,
    ),
    entry(
        "bus late by 20 ms",
        Fault::Bus(Disturbance::late(20)),
        true,
        SILENCE,
        2.0,
    ),
    entry(
        "bus reorders within 8 ms",
        Fault::Bus(Disturbance::jitter(8)),
        true,
        SILENCE,
        2.0,
    ),
    entry(
        "bus doubles 30 %",
        Fault::Bus(Disturbance::doubling(0.3)),
        true,
        &[],
        0.0,
    ),
    entry(
        "bus corrupts 5 %",
        Fault::Bus(Disturbance::corruption(0.05)),
        true,
        CORRUPTION,
        20.0,
    ),
    entry(
        "babbling node",
        Fault::Bus(Disturbance::BABBLE),
        true,
        SILENCE,
        20.0,
    ),
    entry(
        "rear board cut off the bus",
        Fault::Partition(Role::Rear),
        false,
        SILENCE,
        1.5,
    ),
    entry(
        "beam board cut off the bus",
        Fault::Partition(Role::Beam),
        true,
        &[C::DegradedTooLong],
        22.0,
    ),
    entry(
        "front board resets",
        Fault::Reset(Role::Front, 200),
        false,
        SILENCE,
        1.5,
    ),
    entry(
        "rear board resets",
        Fault::Reset(Role::Rear, 200),
        false,
        SILENCE,
        1.5,
    ),
    entry(
        "beam board resets",
        Fault::Reset(Role::Beam, 200),
        true,
        &[],
        0.0,
    ),
    entry(
        "front board lost",
        Fault::Loss(Role::Front),
        false,
        SILENCE,
        1.5,
    ),
    entry(
        "rear board lost",
        Fault::Loss(Role::Rear),
        false,
        SILENCE,
        1.5,
    ),
    entry(
        "beam board lost",
        Fault::Loss(Role::Beam),
        true,
        &[C::DegradedTooLong],
        22.0,
    ),
    entry(
        "front board freezes 0.3 s",
        Fault::Freeze(Role::Front, 300),
        false,
        SILENCE,
        1.8,
    ),
    entry(
        "rear board freezes 0.3 s",
        Fault::Freeze(Role::Rear, 300),
        false,
        SILENCE,
        1.8,
    ),
    entry(
        "rear clock slow by 0.02 %, no common time",
        Fault::SlowClock(Role::Rear, 5000),
        true,
        CORRUPTION,
        20.0,
    ),
    entry(
        "rear clock slow by 0.2 %, no common time",
        Fault::SlowClock(Role::Rear, 500),
        true,
        CORRUPTION,
        20.0,
    ),
    entry("gauge dead", Fault::GaugeRail(1, false), true, &[], 0.0),
    entry("gauge saturated", Fault::GaugeRail(1, true), true, &[], 0.0),
    entry(
        "all gauges dead",
        Fault::GaugeRail(5, false),
        true,
        &[C::DegradedTooLong],
        22.0,
    ),
    entry("gauge stuck", Fault::GaugeStuck(2), true, GAUGES, 22.0),
    entry(
        "gauge drifts",
        Fault::GaugeDrift(2, 40.0),
        true,
        GAUGES,
        22.0,
    ),
    entry(
        "encoder stuck",
        Fault::EncoderStuck((1, 0)),
        false,
        WHEELS,
        2.0,
    ),
    entry(
        "encoder jumps",
        Fault::EncoderJumps((0, 0), 500),
        true,
        WHEELS,
        2.0,
    ),
    entry(
        "encoders swapped",
        Fault::EncodersSwapped(1),
        true,
        WHEELS,
        20.0,
    ),
    entry(
        "encoder missing",
        Fault::EncoderMissing((0, 1)),
        false,
        WHEELS,
        1.5,
    ),
    entry(
        "gyro not a number",
        Fault::GyroNotANumber(0),
        true,
        &[C::NotANumber],
        1.5,
    ),
    entry(
        "gyro off by 0.3 rad/s",
        Fault::GyroBias(1, 0.3),
        true,
        WHEELS,
        10.0,
    ),
    entry(
        "accelerometer missing",
        Fault::AccelerometerMissing(0),
        true,
        &[],
        0.0,
    ),
    entry(
        "motor open",
        Fault::MotorWeak((0, 0), 0.0),
        true,
        WHEELS,
        20.0,
    ),
    entry(
        "motor weak",
        Fault::MotorWeak((1, 1), 0.3),
        true,
        WHEELS,
        20.0,
    ),
    entry(
        "motor stuck on",
        Fault::MotorStuckOn((0, 1), 1.5),
        false,
        WHEELS,
        3.5,
    ),
    entry(
        "wheel lifted",
        Fault::WheelLifted((1, 0)),
        true,
        WHEELS,
        20.0,
    ),
    entry(
        "frame snapped",
        Fault::FrameSnapped,
        false,
        &[
            C::EstimateInconsistent,
            C::FrameBent,
            C::WrenchHigh,
            C::TrackingLost,
        ],
        3.0,
    ),
    entry(
        "supply dips",
        Fault::Reported(1, C::SupplyLow, 150, 0.2),
        false,
        &[C::SupplyLow, C::NeighbourFault],
        1.5,
    ),
    entry(
        "driver too hot",
        Fault::Reported(0, C::OverTemperature, 0, 1.0),
        false,
        &[C::OverTemperature, C::NeighbourFault],
        1.8,
    ),
    entry(
        "over current",
        Fault::Reported(1, C::OverCurrent, 20, 1.0),
        false,
        &[C::OverCurrent, C::NeighbourFault],
        1.5,
    ),
    entry(
        "emergency stop",
        Fault::Reported(0, C::EmergencyStop, 0, 1.0),
        false,
        &[C::EmergencyStop, C::NeighbourFault],
        1.5,
    ),
];
