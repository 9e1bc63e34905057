//! The bus between the boards: a simulated CAN bus and the description of its messages.
//!
//! Imports [`base`](crate::base). Start with [`virtual_bus`].

pub mod dbc;
pub mod virtual_bus;
