//! Bus between the boards.

#[path = "../../../host-sim/src/bus/virtual_bus.rs"]
pub mod virtual_bus;
