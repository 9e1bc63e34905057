//! Parts of the robot's boards.

mod bridge;
mod drv8874;
mod filter;
mod icm42688;
mod ina240;
mod motor;
mod thermistor;

pub use bridge::{Bridge, BridgeConfig, BridgeFault};
pub use drv8874::{DriverConfig, Drv8874, Half};
pub use icm42688::{Icm42688, InertialConfig, InertialFault, Motion};
pub use ina240::{Amplifier, AmplifierConfig, AmplifierFault};
pub use motor::{Motor, MotorConfig, Work};
pub use thermistor::Thermistor;
