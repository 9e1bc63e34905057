//! Registers of a peripheral: names, places, bits.

/// A register.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Register {
    /// Place from the peripheral's base, bytes.
    pub offset: u32,
    /// The manual's name, without the peripheral's.
    pub name: &'static str,
    /// Bits that there are; all others are reserved.
    pub bits: u32,
    /// Whether it may be accessed by halves and bytes.
    pub narrow: bool,
}

/// A register that is accessed by words.
pub(crate) const fn word(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        narrow: false,
    }
}

/// A register that may be accessed by halves and bytes too.
pub(crate) const fn narrow(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        narrow: true,
    }
}

/// A value of which only the bits in `mask` are written.
pub(crate) const fn merge(old: u32, value: u32, mask: u32) -> u32 {
    (old & !mask) | (value & mask)
}
