//! Simulated CAN bus between the boards. Start with [`virtual_bus`].

pub mod virtual_bus;
