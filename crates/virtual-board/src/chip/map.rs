//! Address map of the peripherals, and the bits that enable their clocks.

use super::effect::Clocks;
use super::interrupt::Interrupt;
use super::pin::{PORTS, Signal};

/// A peripheral; all ports are one unit. Units that can have events come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(crate) enum Unit {
    /// Circuit around the chip.
    Circuit,
    /// Reset and clock control.
    Rcc,
    /// Flash; its event is the end of an operation.
    Flash,
    Iwdg,
    Wwdg,
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
    Adc,
    Dma1,
    Dma2,
    Spi1,
    Can1,
    Usart3,
    Pwr,
    Gpio,
    Exti,
    Tim11,
    Debug,
}

/// Offsets of the RCC's clock enable registers.
const AHB1ENR: u32 = 0x30;
const APB1ENR: u32 = 0x40;
const APB2ENR: u32 = 0x44;

/// Offset of the unique identifier within the debug unit, behind its registers.
pub(crate) const IDENTITY: u32 = 0x800;

/// Peripherals of the chip that are not modelled: first and last address, name.
#[rustfmt::skip]
const NOT_MODELLED: &[(u32, u32, &str)] = &[
    (0x4000_1000, 0x4000_13ff, "TIM6"), (0x4000_1400, 0x4000_17ff, "TIM7"), (0x4000_1800, 0x4000_1bff, "TIM12"),
    (0x4000_1c00, 0x4000_1fff, "TIM13"), (0x4000_2000, 0x4000_23ff, "TIM14"), (0x4000_2800, 0x4000_2bff, "RTC"),
    (0x4000_3400, 0x4000_37ff, "I2S2ext"), (0x4000_3800, 0x4000_3bff, "SPI2"),
    (0x4000_3c00, 0x4000_3fff, "SPI3"), (0x4000_4000, 0x4000_43ff, "I2S3ext"), (0x4000_4400, 0x4000_47ff, "USART2"),
    (0x4000_4c00, 0x4000_4fff, "UART4"), (0x4000_5000, 0x4000_53ff, "UART5"), (0x4000_5400, 0x4000_5fff, "I2C"),
    (0x4000_6800, 0x4000_6bff, "CAN2"), (0x4000_7400, 0x4000_77ff, "DAC"), (0x4001_0400, 0x4001_07ff, "TIM8"),
    (0x4001_1000, 0x4001_13ff, "USART1"), (0x4001_1400, 0x4001_17ff, "USART6"), (0x4001_2c00, 0x4001_2fff, "SDIO"),
    (0x4001_3800, 0x4001_3bff, "SYSCFG"), (0x4001_4000, 0x4001_43ff, "TIM9"), (0x4001_4400, 0x4001_47ff, "TIM10"),
    (0x4002_3000, 0x4002_33ff, "CRC"), (0x4002_4000, 0x4002_4fff, "BKPSRAM"), (0x4004_0000, 0x4007_ffff, "USB OTG HS"),
    (0x5000_0000, 0x5003_ffff, "USB OTG FS"), (0x5006_0800, 0x5006_0bff, "RNG"), (0x6000_0000, 0x9fff_ffff, "FSMC banks"),
    (0xa000_0000, 0xa000_0fff, "FSMC"), (0x4002_8000, 0x4002_93ff, "ETH"),
    (0x5005_0000, 0x5005_03ff, "DCMI"), (0x1fff_0000, 0x1fff_77ff, "the boot loader's memory"),
    (0x2200_0000, 0x23ff_ffff, "bit-band aliases"), (0x4200_0000, 0x43ff_ffff, "bit-band aliases"),
    (0x1fff_7800, 0x1fff_7a0f, "one-time programmable memory"), (0x1fff_c000, 0x1fff_c00f, "option bytes"),
];

/// Name of the peripheral at an address that exists on the chip and is not modelled; `None` for other addresses.
pub(crate) fn not_modelled(address: u32) -> Option<&'static str> {
    let found = NOT_MODELLED
        .iter()
        .find(|(first, last, _)| (*first..=*last).contains(&address));
    found.map(|(_, _, name)| *name)
}

/// Length of a port's register block, bytes.
const PORT: u32 = 0x400;

/// Address range of a peripheral.
struct AddressRange {
    first: u32,
    last: u32,
    unit: Unit,
    name: &'static str,
    gate: Option<(u32, u32)>,
}

const fn range(
    first: u32,
    length: u32,
    unit: Unit,
    name: &'static str,
    gate: Option<(u32, u32)>,
) -> AddressRange {
    AddressRange {
        first,
        last: first + length - 1,
        unit,
        name,
        gate,
    }
}

const fn by(register: u32, bit: u32) -> Option<(u32, u32)> {
    Some((register, bit))
}

/// Address ranges in ascending order.
const ADDRESS_RANGES: [AddressRange; 21] = [
    range(0x1fff_7a10, 0x14, Unit::Debug, "UID", None),
    range(0x4000_0000, 0x400, Unit::Tim2, "TIM2", by(APB1ENR, 0)),
    range(0x4000_0400, 0x400, Unit::Tim3, "TIM3", by(APB1ENR, 1)),
    range(0x4000_0800, 0x400, Unit::Tim4, "TIM4", by(APB1ENR, 2)),
    range(0x4000_0c00, 0x400, Unit::Tim5, "TIM5", by(APB1ENR, 3)),
    range(0x4000_2c00, 0x400, Unit::Wwdg, "WWDG", by(APB1ENR, 11)),
    range(0x4000_3000, 0x400, Unit::Iwdg, "IWDG", None),
    range(0x4000_4800, 0x400, Unit::Usart3, "USART3", by(APB1ENR, 18)),
    range(0x4000_6400, 0x400, Unit::Can1, "CAN1", by(APB1ENR, 25)),
    range(0x4000_7000, 0x400, Unit::Pwr, "PWR", by(APB1ENR, 28)),
    range(0x4001_0000, 0x400, Unit::Tim1, "TIM1", by(APB2ENR, 0)),
    range(0x4001_2000, 0x400, Unit::Adc, "ADC1", by(APB2ENR, 8)),
    range(0x4001_3000, 0x400, Unit::Spi1, "SPI1", by(APB2ENR, 12)),
    range(0x4001_3c00, 0x400, Unit::Exti, "EXTI", None),
    range(0x4001_4800, 0x400, Unit::Tim11, "TIM11", by(APB2ENR, 18)),
    range(0x4002_0000, 9 * PORT, Unit::Gpio, "GPIO", None),
    range(0x4002_3800, 0x400, Unit::Rcc, "RCC", None),
    range(0x4002_3c00, 0x400, Unit::Flash, "FLASH", None),
    range(0x4002_6000, 0x400, Unit::Dma1, "DMA1", by(AHB1ENR, 21)),
    range(0x4002_6400, 0x400, Unit::Dma2, "DMA2", by(AHB1ENR, 22)),
    range(0xe004_2000, 0x400, Unit::Debug, "DBGMCU", None),
];

/// Index of each peripheral's address range; of the last range if the peripheral has several.
const RANGE_OF: [usize; Unit::COUNT] = {
    let mut ranges = [0; Unit::COUNT];
    let mut k = 0;
    while k < ADDRESS_RANGES.len() {
        ranges[ADDRESS_RANGES[k].unit as usize] = k;
        k += 1;
    }
    ranges
};

impl Unit {
    /// Number of units.
    const COUNT: usize = Self::Debug as usize + 1;

    /// Units that can have events. Of two events at the same cycle, the unit earlier in the list is first.
    pub const SCHEDULED: [Self; 16] = {
        use Unit::*;
        [
            Circuit, Rcc, Flash, Iwdg, Wwdg, Tim1, Tim2, Tim3, Tim4, Tim5, Adc, Dma1, Dma2, Spi1,
            Can1, Usart3,
        ]
    };

    /// Index of a timer, 0 for TIM1.
    pub const fn timer(self) -> usize {
        self as usize - Self::Tim1 as usize
    }

    /// Peripheral at an address, and the offset of the address in the peripheral; `None` if no modelled peripheral is
    /// there.
    pub fn at(address: u32) -> Option<(Self, u32)> {
        let k = ADDRESS_RANGES.partition_point(|range| range.last < address);
        let range = ADDRESS_RANGES.get(k)?;
        let offset = address.checked_sub(range.first)?;
        Some((range.unit, offset + range.unit.bias(range.first)))
    }

    /// Offset within the peripheral at which the range from `first` begins: 0 except for the identity, the second range
    /// of the debug unit.
    fn bias(self, first: u32) -> u32 {
        if first == 0x1fff_7a10 { IDENTITY } else { 0 }
    }

    fn range(self) -> &'static AddressRange {
        &ADDRESS_RANGES[RANGE_OF[self as usize]]
    }

    /// Name of the peripheral; the name of a port includes its letter.
    pub fn name_at(self, offset: u32) -> String {
        match self {
            Self::Gpio => format!("GPIO{}", char::from(b'A' + (offset / PORT) as u8)),
            Self::Debug if offset >= IDENTITY => "UID".to_owned(),
            Self::Debug => "DBGMCU".to_owned(),
            _ => self.range().name.to_owned(),
        }
    }

    /// Register and bit of the RCC that enable the peripheral's clock; `None` if its clock is always on.
    pub fn gate(self, offset: u32) -> Option<(u32, u32)> {
        match self {
            Self::Gpio => Some((AHB1ENR, offset / PORT)),
            _ => self.range().gate,
        }
    }

    /// Peripheral whose clock this bit of an enable register enables; `None` if not modelled. The same bit of the reset
    /// register resets the peripheral.
    pub fn reset_by(register: u32, bit: u32) -> Option<Self> {
        if register == AHB1ENR && (bit as usize) < PORTS {
            return Some(Self::Gpio);
        }
        let gate = Some((register, bit));
        let range = ADDRESS_RANGES.iter().find(|range| range.gate == gate)?;
        Some(range.unit)
    }

    pub fn interrupts(self) -> &'static [Interrupt] {
        use Interrupt::*;
        match self {
            Self::Tim1 => &[Tim1Break, Tim1Update, Tim1Trigger, Tim1Compare],
            Self::Tim2 => &[Tim2],
            Self::Tim3 => &[Tim3],
            Self::Tim4 => &[Tim4],
            Self::Tim5 => &[Tim5],
            Self::Adc => &[Adc],
            Self::Dma1 => &Interrupt::OF_STREAMS[0],
            Self::Dma2 => &Interrupt::OF_STREAMS[1],
            Self::Spi1 => &[Spi1],
            Self::Can1 => &[Can1Tx, Can1Rx0, Can1Rx1, Can1Sce],
            Self::Usart3 => &[Usart3],
            _ => &[],
        }
    }

    pub fn outputs(self) -> &'static [Signal] {
        use Signal::*;
        match self {
            Self::Tim1 => &[
                Tim1Ch1, Tim1Ch2, Tim1Ch3, Tim1Ch4, Tim1Ch1N, Tim1Ch2N, Tim1Ch3N,
            ],
            Self::Tim2 | Self::Tim3 | Self::Tim4 | Self::Tim5 => &Signal::CHANNELS[self.timer()],
            Self::Spi1 => &[Spi1Sck, Spi1Mosi],
            Self::Usart3 => &[Usart3Tx],
            _ => &[],
        }
    }

    pub fn inputs(self) -> &'static [Signal] {
        use Signal::*;
        match self {
            Self::Tim1 => &[Tim1Bkin, Tim1Ch1, Tim1Ch2],
            Self::Tim2 | Self::Tim3 | Self::Tim4 | Self::Tim5 => self.outputs().split_at(2).0,
            _ => &[],
        }
    }

    /// Offset of a register within its port or peripheral.
    pub fn register_offset(self, offset: u32) -> u32 {
        match self {
            Self::Gpio => offset % PORT,
            _ => offset,
        }
    }

    /// Cycles that the bus adds to an access: on APB two periods of the bus clock, one to wait for an edge and one for
    /// the access; elsewhere one cycle.
    pub fn bus_cycles(self, clocks: &Clocks) -> u64 {
        match self.range().first {
            0x4000_0000..=0x4000_ffff => 2 * clocks.apb1,
            0x4001_0000..=0x4001_ffff => 2 * clocks.apb2,
            _ => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_ranges_ascend_without_overlap() {
        for pair in ADDRESS_RANGES.windows(2) {
            assert!(
                pair[0].last < pair[1].first,
                "{} {}",
                pair[0].name,
                pair[1].name
            );
        }
    }

    #[test]
    fn addresses_of_the_manual_map_to_their_peripherals() {
        assert_eq!(Unit::at(0x4002_0414), Some((Unit::Gpio, 0x414)));
        assert_eq!(Unit::Gpio.name_at(0x414), "GPIOB");
        assert_eq!(Unit::Gpio.gate(0x414), Some((AHB1ENR, 1)));
        assert_eq!(Unit::at(0x4001_2304), Some((Unit::Adc, 0x304)));
        assert_eq!(Unit::at(0x4000_5400), None);
        assert_eq!(Unit::at(0xe004_2000), Some((Unit::Debug, 0)));
    }
}
