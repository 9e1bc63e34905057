//! The bare Olimex STM32-H405: pins used by the board itself, and pins used by the chip's boot loader.
//!
//! Sources: board files in NuttX (`boards/arm/stm32/olimex-stm32-h405`), ChibiOS (`os/hal/boards/OLIMEX_STM32_H405`)
//! and Zephyr (`boards/arm/olimex_stm32_h405`); for USB_P, the board files of the robot phobos.

use crate::chip::{Net, Pin, Usable};

const fn net(port: char, number: u8, name: &'static str, part: &'static str) -> Net {
    usable(port, number, name, part, Usable::No)
}

const fn usable(
    port: char,
    number: u8,
    name: &'static str,
    part: &'static str,
    usable: Usable,
) -> Net {
    Net {
        pin: Pin::new(port, number),
        name,
        part,
        usable,
    }
}

/// Nets of the board, one for each connected pin.
pub const NETS: &[Net] = &[
    usable('A', 0, "BUT", "user button", Usable::Input),
    net('A', 11, "USBDM", "USB data"),
    net('A', 12, "USBDP", "USB data"),
    net('A', 13, "TMS", "debug port"),
    net('A', 14, "TCK", "debug port"),
    net('A', 15, "TDI", "debug port"),
    net('B', 2, "BOOT1", "jumper to ground or supply"),
    net('B', 3, "TDO", "debug port"),
    net('B', 4, "TRST", "debug port"),
    net(
        'C',
        4,
        "USB_P",
        "supply of USB by a divider: high while a cable is plugged",
    ),
    net('C', 11, "DISC", "pull-up of USB"),
    usable('C', 12, "LED", "LED to the supply", Usable::Output),
    net('C', 14, "OSC32_IN", "crystal of 32 kHz"),
    net('C', 15, "OSC32_OUT", "crystal of 32 kHz"),
    net('H', 0, "OSC_IN", "crystal of 8 MHz"),
    net('H', 1, "OSC_OUT", "crystal of 8 MHz"),
];

/// A pin used by the boot loader in ROM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoaderPin {
    /// Pin of the chip.
    pub pin: Pin,
    /// Signal of the loader on this pin.
    pub signal: &'static str,
    /// True if the loader drives the pin.
    pub driven: bool,
}

const fn loader(port: char, number: u8, signal: &'static str, driven: bool) -> LoaderPin {
    LoaderPin {
        pin: Pin::new(port, number),
        signal,
        driven,
    }
}

/// Pins that the boot loader uses while BOOT0 is high (DS8626, section 2.2.13).
pub const LOADER: &[LoaderPin] = &[
    loader('A', 9, "USART1 TX", true),
    loader('A', 10, "USART1 RX", false),
    loader('B', 10, "USART3 TX", true),
    loader('B', 11, "USART3 RX", false),
    loader('C', 10, "USART3 TX", true),
    loader('C', 11, "USART3 RX", false),
    loader('B', 5, "CAN2 RX", false),
    loader('B', 13, "CAN2 TX", true),
    loader('A', 11, "USB DM", true),
    loader('A', 12, "USB DP", true),
];
