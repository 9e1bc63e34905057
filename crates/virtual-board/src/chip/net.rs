//! Nets of the bare board: connections of the chip's pins made by the board's manufacturer.

use super::pin::Pin;

/// Permitted use of a net of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usable {
    /// None: the board itself uses the pin.
    No,
    /// The program may read the pin.
    Input,
    /// The program may drive the pin.
    Output,
}

/// A net of the bare board at a pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Net {
    /// Pin of the chip on this net.
    pub pin: Pin,
    /// The net's name in the board's schematic.
    pub name: &'static str,
    /// Component of the board on this net.
    pub part: &'static str,
    /// Permitted use of the net.
    pub usable: Usable,
}
