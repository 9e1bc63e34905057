//! Faults that a visitor injects.

use core_algos::topology::{Role, Side};
use host_sim::bus::virtual_bus::BusConfig;
use host_sim::world::faults::{Fault, Rail, Wheel};

/// Fault with its name and its effect in words.
pub struct Entry {
    /// Name on the button.
    pub name: &'static str,
    /// Effect of the fault.
    pub text: &'static str,
    /// Makes the fault.
    pub make: fn() -> Fault,
}

const FRONT_LEFT: Wheel = Wheel {
    axle: 0,
    side: Side::Left,
};
const REAR_RIGHT: Wheel = Wheel {
    axle: 1,
    side: Side::Right,
};

/// Faults, in the order of their numbers.
pub const FAULTS: &[Entry] = &[
    Entry {
        name: "gauge wire breaks",
        text: "The first gauge from the rear reads full scale.",
        make: || Fault::GaugeRail {
            count: 1,
            rail: Rail::FullScale,
        },
    },
    Entry {
        name: "gauge stuck",
        text: "The third gauge repeats its last reading.",
        make: || Fault::GaugeStuck(2),
    },
    Entry {
        name: "gauge drifts",
        text: "The zero of the second gauge drifts by 20 counts per second.",
        make: || Fault::GaugeDrift {
            gauge: 1,
            counts_per_s: 20.0,
        },
    },
    Entry {
        name: "encoder stuck",
        text: "The encoder of the front left wheel repeats its last count.",
        make: || Fault::EncoderStuck(FRONT_LEFT),
    },
    Entry {
        name: "encoder missing",
        text: "The encoder of the rear right wheel gives no count.",
        make: || Fault::EncoderMissing(REAR_RIGHT),
    },
    Entry {
        name: "gyro biased",
        text: "The front gyro reads 0.02 rad/s too much; without an IMU nothing happens.",
        make: || Fault::GyroBias {
            axle: 0,
            bias_rad_s: 0.02,
        },
    },
    Entry {
        name: "motor weak",
        text: "The front left motor gives a fifth of the commanded torque.",
        make: || Fault::MotorWeak {
            wheel: FRONT_LEFT,
            share: 0.2,
        },
    },
    Entry {
        name: "motor stuck on",
        text: "The rear right motor gives 1 N m whenever the motors are on.",
        make: || Fault::MotorStuckOn {
            wheel: REAR_RIGHT,
            torque_n_m: 1.0,
        },
    },
    Entry {
        name: "wheel lifted",
        text: "The front left wheel does not touch the ground.",
        make: || Fault::WheelLifted(FRONT_LEFT),
    },
    Entry {
        name: "strip breaks",
        text: "The frame breaks in two.",
        make: || Fault::FrameSnapped,
    },
    Entry {
        name: "bus loses frames",
        text: "Every second frame on the CAN bus is lost.",
        make: || {
            Fault::Bus(BusConfig {
                loss: 0.5,
                ..BusConfig::default()
            })
        },
    },
    Entry {
        name: "beam board off",
        text: "The board of the gauges loses its supply.",
        make: || Fault::Loss(Role::beam(0)),
    },
    Entry {
        name: "rear board off",
        text: "The board of the rear axle loses its supply.",
        make: || Fault::Loss(Role::axle(1)),
    },
    Entry {
        name: "rear board restarts",
        text: "The board of the rear axle loses its supply for 0.2 s.",
        make: || Fault::Reset {
            board: Role::axle(1),
            off_ms: 200,
        },
    },
];
