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

/// Declares faults by what the robot may do: `harmless`: it must finish; `survives`: it may finish, or stop
/// with one of these codes within this time, s; `stops`: it must stop so.
macro_rules! catalogue {
    ($($name:literal: $fault:expr => $kind:ident $(($codes:expr) within $time:literal)?;)*) => {
        &[$(catalogue!(@$kind $name, $fault $(, $codes, $time)?),)*]
    };
    (@harmless $name:literal, $fault:expr) => {
        catalogue!(@survives $name, $fault, &[], 0.0)
    };
    (@survives $name:literal, $fault:expr, $codes:expr, $time:literal) => {
        Entry { name: $name, fault: $fault, finish: true, codes: $codes, stop_within_s: $time }
    };
    (@stops $name:literal, $fault:expr, $codes:expr, $time:literal) => {
        Entry { name: $name, fault: $fault, finish: false, codes: $codes, stop_within_s: $time }
    };
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
pub const CATALOGUE: &[Entry] = catalogue! {
    "none": Fault::None => harmless;
    "bus loses 1 %": Bus(Disturbance::loss(0.01)) => harmless;
    "bus loses 10 %": Bus(Disturbance::loss(0.1)) => survives (SILENCE) within 60.0;
    "bus loses 50 %": Bus(Disturbance::loss(0.5)) => survives (SILENCE) within 20.0;
    "bus late by 20 ms": Bus(Disturbance::late(20)) => survives (SILENCE) within 2.0;
    "bus reorders within 8 ms": Bus(Disturbance::jitter(8)) => survives (SILENCE) within 2.0;
    "bus doubles 30 %": Bus(Disturbance::doubling(0.3)) => harmless;
    "bus corrupts 5 %": Bus(Disturbance::corruption(0.05)) => survives (CORRUPTION) within 20.0;
    "babbling node": Bus(Disturbance::BABBLE) => survives (SILENCE) within 20.0;
    "rear board cut off the bus": Partition(Role::Rear) => stops (SILENCE) within 1.5;
    "beam board cut off the bus": Partition(Role::Beam) => survives (NO_BEAM) within 22.0;
    "front board resets": Reset(Role::Front, 200) => stops (SILENCE) within 1.5;
    "rear board resets": Reset(Role::Rear, 200) => stops (SILENCE) within 1.5;
    "beam board resets": Reset(Role::Beam, 200) => harmless;
    "front board lost": Loss(Role::Front) => stops (SILENCE) within 1.5;
    "rear board lost": Loss(Role::Rear) => stops (SILENCE) within 1.5;
    "beam board lost": Loss(Role::Beam) => survives (NO_BEAM) within 22.0;
    "front board freezes 0.3 s": Freeze(Role::Front, 300) => stops (SILENCE) within 1.8;
    "rear board freezes 0.3 s": Freeze(Role::Rear, 300) => stops (SILENCE) within 1.8;
    "rear clock slow by 0.02 %, no common time": SlowClock(Role::Rear, 5000) => survives (CORRUPTION) within 20.0;
    "rear clock slow by 0.2 %, no common time": SlowClock(Role::Rear, 500) => survives (CORRUPTION) within 20.0;
    "gauge dead": GaugeRail(1, false) => harmless;
    "gauge saturated": GaugeRail(1, true) => harmless;
    "all gauges dead": GaugeRail(5, false) => survives (NO_BEAM) within 22.0;
    "gauge stuck": GaugeStuck(2) => survives (GAUGES) within 22.0;
    "gauge drifts": GaugeDrift(2, 40.0) => survives (GAUGES) within 22.0;
    "encoder stuck": EncoderStuck((1, 0)) => stops (WHEELS) within 2.0;
    "encoder jumps": EncoderJumps((0, 0), 500) => survives (WHEELS) within 2.0;
    "encoders swapped": EncodersSwapped(1) => survives (WHEELS) within 20.0;
    "encoder missing": EncoderMissing((0, 1)) => stops (WHEELS) within 1.5;
    "gyro not a number": GyroNotANumber(0) => survives (&[C::NotANumber]) within 1.5;
    "gyro off by 0.3 rad/s": GyroBias(1, 0.3) => survives (WHEELS) within 10.0;
    "accelerometer missing": AccelerometerMissing(0) => harmless;
    "motor open": MotorWeak((0, 0), 0.0) => survives (WHEELS) within 20.0;
    "motor weak": MotorWeak((1, 1), 0.3) => survives (WHEELS) within 20.0;
    "motor stuck on": MotorStuckOn((0, 1), 1.5) => stops (WHEELS) within 3.5;
    "wheel lifted": WheelLifted((1, 0)) => survives (WHEELS) within 20.0;
    "frame snapped": FrameSnapped => stops (&[C::EstimateInconsistent, C::FrameBent, C::WrenchHigh, C::TrackingLost]) within 3.0;
    "supply dips": Reported(1, C::SupplyLow, 150, 0.2) => stops (&[C::SupplyLow, C::NeighbourFault]) within 1.5;
    "driver too hot": Reported(0, C::OverTemperature, 0, 1.0) => stops (&[C::OverTemperature, C::NeighbourFault]) within 1.8;
    "over current": Reported(1, C::OverCurrent, 20, 1.0) => stops (&[C::OverCurrent, C::NeighbourFault]) within 1.5;
    "emergency stop": Reported(0, C::EmergencyStop, 0, 1.0) => stops (&[C::EmergencyStop, C::NeighbourFault]) within 1.5;
};
