//! Registers of a peripheral: names, places, bits.

#[derive(Clone, Copy, Debug)]
pub(crate) struct Register {
    /// Place from the peripheral's base, bytes.
    pub offset: u32,
    /// The manual's name, without the peripheral's.
    pub name: &'static str,
    /// Bits that there are; all others are reserved and keep their value of after a reset.
    pub bits: u32,
    /// Reserved bits whose value after a reset is one.
    pub ones: u32,
    /// Whether it may be accessed by halves and bytes.
    pub narrow: bool,
}

impl Register {
    /// The same with reserved bits that are ones.
    pub const fn keeping(self, ones: u32) -> Self {
        Self { ones, ..self }
    }

    /// Reserved bits that a write of the bits in `mask` changes.
    pub const fn changed_reserved(&self, value: u32, mask: u32) -> u32 {
        (value ^ self.ones) & mask & !self.bits
    }
}

/// A register that is accessed by words.
pub(crate) const fn word(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        ones: 0,
        narrow: false,
    }
}

/// A register that may be accessed by halves and bytes too.
pub(crate) const fn narrow(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        ones: 0,
        narrow: true,
    }
}

/// A value of which only the bits in `mask` are written.
pub(crate) const fn merge(old: u32, value: u32, mask: u32) -> u32 {
    (old & !mask) | (value & mask)
}

/// The register at a place; `registers` are in the order of their places.
pub(crate) fn find(registers: &'static [Register], place: u32) -> Option<&'static Register> {
    // Most tables have no gaps.
    let near = registers.get(place as usize / 4);
    if let Some(register) = near.filter(|register| register.offset == place) {
        return Some(register);
    }
    let found = registers.binary_search_by_key(&place, |register| register.offset);
    registers.get(found.ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_bits_keep_their_value_of_after_a_reset() {
        let register = word(0, "FMR", 0x3f01).keeping(0x2a1c_0000);
        assert_eq!(register.changed_reserved(0x2a1c_0e01, !0), 0);
        assert_eq!(register.changed_reserved(0x0000_0e01, !0), 0x2a1c_0000);
        assert_eq!(register.changed_reserved(0x2a1c_0003, !0), 2);
        // By bytes only what is written counts.
        assert_eq!(register.changed_reserved(0x01, 0xff), 0);
    }
}
