//! Faults injected at the interfaces of a simulated robot: sensors, motors, frame, bus, boards.
//!
//! [`Injector`] applies a fault; `virtual_robot::faults` in the crate `remote` lists the allowed ends of a run with
//! each fault.

mod inject;

pub use inject::{ClockLag, Injector, Readings};

use crate::bus::virtual_bus::BusConfig;
use core_algos::safety::Condition;
use core_algos::topology::{Role, Side};

/// Wheel of the robot, by axle and side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wheel {
    /// Number of the axle, 0 at the front.
    pub axle: usize,
    /// Side of the axle.
    pub side: Side,
}

/// End of a converter's range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rail {
    /// Count 0.
    Zero,
    /// Full scale.
    FullScale,
}

/// Fault. Axles are numbered from 0 at the front. Gauges are numbered from 0 at the root; they belong to the first
/// frame, except in [`Fault::OfFrame`].
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// No fault: control of the campaign.
    None,
    /// The bus gets the given properties.
    Bus(BusConfig),
    /// A board loses its supply and restarts.
    Reset {
        /// Board that loses its supply.
        board: Role,
        /// Time without supply, ms.
        off_ms: u32,
    },
    /// A board loses its supply for good.
    Loss(Role),
    /// A board stops running with its outputs held, then continues.
    Freeze {
        /// Board that stops running.
        board: Role,
        /// Duration of the stop, ms.
        ms: u32,
    },
    /// A board's clock is slow.
    SlowClock {
        /// Board with the slow clock.
        board: Role,
        /// Period in which one tick is missing, ticks.
        period: u32,
    },
    /// Bridges read an end of the converter's range.
    GaugeRail {
        /// Number of bridges at the end of the range, counted from the root.
        count: usize,
        /// End of the range that the bridges read.
        rail: Rail,
    },
    /// A bridge repeats its last reading.
    GaugeStuck(usize),
    /// Bridge readings are shifted by the given counts.
    GaugesShifted([i32; 5]),
    /// A bridge's reading drifts.
    GaugeDrift {
        /// Gauge whose reading drifts.
        gauge: usize,
        /// Rate of the drift, counts a second.
        counts_per_s: f64,
    },
    /// An encoder repeats its last reading.
    EncoderStuck(Wheel),
    /// An encoder's count jumps every 50 ms.
    EncoderJumps {
        /// Wheel whose encoder jumps.
        wheel: Wheel,
        /// Size of each jump, counts.
        counts: i32,
    },
    /// The encoders of an axle are swapped.
    EncodersSwapped(usize),
    /// An encoder gives no reading.
    EncoderMissing(Wheel),
    /// The gyro of an axle reads NaN.
    GyroNotANumber(usize),
    /// The gyro of an axle has a bias.
    GyroBias {
        /// Axle with the biased gyro.
        axle: usize,
        /// Bias of the gyro, rad/s.
        bias_rad_s: f32,
    },
    /// The accelerometer of an axle gives no reading.
    AccelerometerMissing(usize),
    /// A motor gives a fixed share of the commanded torque.
    MotorWeak {
        /// Wheel with the weak motor.
        wheel: Wheel,
        /// Share of the commanded torque, 0 to 1.
        share: f64,
    },
    /// A motor gives a constant torque while its motor bridge is on.
    MotorStuckOn {
        /// Wheel whose motor is stuck on.
        wheel: Wheel,
        /// Torque of the motor at the wheel, N m.
        torque_n_m: f64,
    },
    /// A wheel does not touch the ground.
    WheelLifted(Wheel),
    /// The first frame is broken in two.
    FrameSnapped,
    /// A fault of gauges or of the frame, at another frame than the first.
    OfFrame {
        /// Number of the frame, 0 at the front.
        frame: usize,
        /// Fault as of the first frame.
        fault: Box<Self>,
    },
    /// The drivers of an axle report a condition.
    Reported {
        /// Axle whose drivers report the condition.
        axle: usize,
        /// Reported condition.
        condition: Condition,
        /// Duration of the report, ms; 0 means permanent.
        ms: u32,
    },
}
