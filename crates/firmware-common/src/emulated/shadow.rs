//! Shadow of the clock, power and flash registers: what the chip would answer, without its clocks.

/// A block of registers: its first address and its size, a power of two that divides the address.
pub struct Block {
    /// First address.
    pub base: u32,
    /// Bytes.
    pub size: u32,
}

/// Power control.
pub const PWR: Block = Block {
    base: 0x4000_7000,
    size: 0x400,
};
/// Reset and clock control; the flash interface follows within the same two pages.
pub const RCC_FLASH: Block = Block {
    base: 0x4002_3800,
    size: 0x800,
};

// Registers whose bits are not just kept.
const PWR_CSR: u32 = 0x4000_7004;
const RCC_CR: u32 = 0x4002_3800;
const RCC_PLLCFGR: u32 = 0x4002_3804;
const RCC_CFGR: u32 = 0x4002_3808;
const RCC_BDCR: u32 = 0x4002_3870;
const RCC_CSR: u32 = 0x4002_3874;
const FLASH_OPTCR: u32 = 0x4002_3c14;

impl Block {
    const fn words(&self) -> usize {
        self.size as usize / 4
    }

    /// Index of the word at `address`, if it is in the block.
    const fn word(&self, address: u32) -> Option<usize> {
        let offset = address.wrapping_sub(self.base);
        if offset < self.size && offset.is_multiple_of(4) {
            Some(offset as usize / 4)
        } else {
            None
        }
    }
}

/// The registers' contents.
pub struct Shadow {
    pwr: [u32; PWR.words()],
    rcc_flash: [u32; RCC_FLASH.words()],
}

impl Shadow {
    /// The registers at power-on.
    pub const fn at_reset() -> Self {
        let mut rcc_flash = [0; RCC_FLASH.words()];
        rcc_flash[(RCC_CR - RCC_FLASH.base) as usize / 4] = 0x0000_0083;
        rcc_flash[(RCC_PLLCFGR - RCC_FLASH.base) as usize / 4] = 0x2400_3010;
        rcc_flash[(RCC_CSR - RCC_FLASH.base) as usize / 4] = 0x0e00_0000;
        rcc_flash[(FLASH_OPTCR - RCC_FLASH.base) as usize / 4] = 0x0fff_aaed;
        Self {
            pwr: [0; PWR.words()],
            rcc_flash,
        }
    }

    fn register(&mut self, address: u32) -> Option<&mut u32> {
        if let Some(word) = PWR.word(address) {
            self.pwr.get_mut(word)
        } else {
            self.rcc_flash.get_mut(RCC_FLASH.word(address)?)
        }
    }

    /// Value that the chip returns: the register with ready bits that follow their enable bits.
    /// `None` outside the registers.
    pub fn read(&mut self, address: u32) -> Option<u32> {
        let value = *self.register(address)?;
        Some(match address {
            // HSI, HSE, PLL and PLLI2S: on at bits 0, 16, 24, 26, ready one above.
            RCC_CR => value | (value & 0x0501_0001) << 1,
            // The clock in use (bits 3:2) is the one selected (bits 1:0).
            RCC_CFGR => value & !0b1100 | (value & 0b11) << 2,
            // LSE and LSI: on at bit 0, ready at bit 1.
            RCC_BDCR | RCC_CSR => value | (value & 1) << 1,
            // Voltage scaling is ready.
            PWR_CSR => value | 1 << 14,
            _ => value,
        })
    }

    /// Keeps what is written; `None` outside the registers.
    pub fn write(&mut self, address: u32, value: u32) -> Option<()> {
        /// "Remove reset flags" of RCC_CSR, and the flags.
        const RMVF: u32 = 1 << 24;
        const FLAGS: u32 = 0xfe << 24;
        let clears_flags = address == RCC_CSR && value & RMVF != 0;
        *self.register(address)? = if clears_flags {
            value & !(RMVF | FLAGS)
        } else {
            value
        };
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The start of the HAL, register by register as the reference manual (RM0090) tells it.
    #[test]
    fn clocks_become_ready_when_they_are_switched_on_and_not_before() {
        let mut chip = Shadow::at_reset();
        let (hse_on, hse_ready, pll_on, pll_ready) = (1 << 16, 1 << 17, 1 << 24, 1 << 25);
        let reset = chip.read(RCC_CR).unwrap();
        assert_eq!(reset & (hse_ready | pll_ready), 0);
        chip.write(RCC_CR, reset | hse_on).unwrap();
        assert_eq!(
            chip.read(RCC_CR).unwrap() & (hse_ready | pll_ready),
            hse_ready
        );
        chip.write(RCC_CR, reset | hse_on | pll_on).unwrap();
        assert_ne!(chip.read(RCC_CR).unwrap() & pll_ready, 0);
        chip.write(RCC_CFGR, 0b10).unwrap();
        assert_eq!(
            chip.read(RCC_CFGR).unwrap(),
            0b1010,
            "the PLL is selected and in use"
        );
        chip.write(RCC_CFGR, 0b00).unwrap();
        assert_eq!(
            chip.read(RCC_CFGR).unwrap(),
            0,
            "back on the internal clock"
        );
    }

    #[test]
    fn reset_flags_are_those_of_power_on_until_they_are_removed() {
        let mut chip = Shadow::at_reset();
        let flags = chip.read(RCC_CSR).unwrap();
        assert_eq!(flags, 0x0e00_0000, "power-on, pin, brown-out");
        chip.write(RCC_CSR, flags | 1 << 24).unwrap();
        assert_eq!(chip.read(RCC_CSR), Some(0));
    }

    #[test]
    fn only_words_of_the_three_blocks_are_registers() {
        let mut chip = Shadow::at_reset();
        for address in [
            0x4000_6ffc,
            0x4000_7400,
            0x4002_37fc,
            0x4002_4000,
            0x4002_3802,
            0,
        ] {
            assert_eq!(chip.read(address), None, "{address:#x}");
            assert_eq!(chip.write(address, 1), None, "{address:#x}");
        }
        for address in [0x4000_7000, 0x4000_73fc, 0x4002_3c00, 0x4002_3ffc] {
            assert_eq!(chip.write(address, 0x5a), Some(()), "{address:#x}");
            assert_eq!(chip.read(address), Some(0x5a), "{address:#x}");
        }
    }
}
