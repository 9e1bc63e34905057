//! Faults put in at the seams of a simulated robot: sensors, motors, frame, bus, boards.
//!
//! [`Injector`] puts them in; the catalogue (`virtual_robot::faults` in the crate `remote`) says how a run with each may end.

mod inject;

pub use inject::{Drift, Injector, Readings};

use crate::bus::virtual_bus::BusConfig;
use core_algos::safety::Condition;
use core_algos::topology::Role;

/// A wheel: axle (0 front, 1 rear) and side (0 left, 1 right).
pub type Wheel = (usize, usize);

/// Fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Nothing: the campaign's own check.
    None,
    /// The bus is as this one.
    Bus(BusConfig),
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
    /// Bridges, from the first, read so many counts more.
    GaugesShifted([i32; 5]),
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
    /// The drivers of an axle report a condition for so many ms (0: for good).
    Reported(usize, Condition, u32),
}
