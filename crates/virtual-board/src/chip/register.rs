//! Registers of a peripheral: names, offsets, bits.

#[derive(Clone, Copy, Debug)]
pub(crate) struct Register {
    /// Offset from the peripheral's base, bytes.
    pub offset: u32,
    /// Name in the manual, without the peripheral's name.
    pub name: &'static str,
    /// Existing bits; all others are reserved and must keep their reset value.
    pub bits: u32,
    /// Reserved bits whose reset value is one.
    pub ones: u32,
    /// True if halfword and byte accesses are allowed.
    pub narrow: bool,
}

impl Register {
    /// The register with `ones` as reserved bits whose reset value is one.
    pub const fn keeping(self, ones: u32) -> Self {
        Self { ones, ..self }
    }

    /// Reserved bits that a write of the bits in `mask` would change.
    pub const fn changed_reserved(&self, value: u32, mask: u32) -> u32 {
        (value ^ self.ones) & mask & !self.bits
    }
}

/// Register with word access only.
pub(crate) const fn word(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        ones: 0,
        narrow: false,
    }
}

/// Register that also allows halfword and byte access.
pub(crate) const fn narrow(offset: u32, name: &'static str, bits: u32) -> Register {
    Register {
        offset,
        name,
        bits,
        ones: 0,
        narrow: true,
    }
}

/// Value after a write to the bits in `mask`.
pub(crate) const fn merge(old: u32, value: u32, mask: u32) -> u32 {
    (old & !mask) | (value & mask)
}

/// Register at an offset, `None` if there is no register; `registers` are sorted by offset.
pub(crate) fn find(registers: &'static [Register], place: u32) -> Option<&'static Register> {
    // Most tables of registers have no gaps: the place in the table is then the offset / 4.
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
    fn write_that_keeps_reserved_bits_at_reset_value_changes_none() {
        let register = word(0, "FMR", 0x3f01).keeping(0x2a1c_0000);
        assert_eq!(register.changed_reserved(0x2a1c_0e01, !0), 0);
        assert_eq!(register.changed_reserved(0x0000_0e01, !0), 0x2a1c_0000);
        assert_eq!(register.changed_reserved(0x2a1c_0003, !0), 2);
        // In a byte access only the written bits count.
        assert_eq!(register.changed_reserved(0x01, 0xff), 0);
    }
}
