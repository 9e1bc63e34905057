//! Nets of the bare board: what its maker has connected to the chip's pins.

use super::pin::Pin;

/// Permitted use of a net of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usable {
    /// Nothing: the board has its own use for the pin.
    No,
    /// Read it.
    Input,
    /// Drive it.
    Output,
}

/// A net of the bare board at a pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Net {
    /// The pin.
    pub pin: Pin,
    /// The net's name in the board's schematic.
    pub name: &'static str,
    /// What the board has there.
    pub part: &'static str,
    /// Permitted use.
    pub usable: Usable,
}
