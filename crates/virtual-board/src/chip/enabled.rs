//! Delay between enabling a peripheral's clock and the first access to the peripheral.
//!
//! Errata sheet ES0182, "Delay after an RCC peripheral clock enabling": two cycles on AHB, 1 + prescaler on APB, or a
//! DSB. A program that relies on the instructions in between keeps the delay only by chance: the next build may differ.
//! Any access within [`MARGIN`] without a DSB is therefore a finding.

use crate::time::Cycles;

/// Cycles after enabling in which an access without a DSB is a finding. The margin exceeds each delay of the errata
/// sheet, and the time between two adjacent source lines in compiled code.
const MARGIN: Cycles = 32;

/// Clocks enabled since the latest DSB: register, bit, cycle.
#[derive(Clone, Debug, Default)]
pub(super) struct Enabled(Vec<(u32, u32, Cycles)>);

impl Enabled {
    /// Records that these bits of an enable register were set.
    pub fn switched_on(&mut self, register: u32, bits: u32, now: Cycles) {
        let set = (0..32).filter(|bit| bits >> bit & 1 != 0);
        self.0.extend(set.map(|bit| (register, bit, now)));
    }

    /// Forgets the clocks enabled so far: after a DSB of the program or a reset of the chip their delay is over.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Cycles since the clock of this bit was enabled; `None` if [`MARGIN`] has passed, after a DSB, and from the
    /// second access on.
    pub fn is_early(&mut self, (register, bit): (u32, u32), now: Cycles) -> Option<Cycles> {
        self.0.retain(|(.., at)| now < at + MARGIN);
        let place = self
            .0
            .iter()
            .position(|of| (of.0, of.1) == (register, bit))?;
        Some(now - self.0.swap_remove(place).2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn access_within_the_margin_without_a_dsb_is_early() {
        let switched_on = || {
            let mut enabled = Enabled::default();
            enabled.switched_on(0x40, 1 << 11, 1000);
            enabled
        };
        assert_eq!(switched_on().is_early((0x40, 11), 1009), Some(9));
        assert_eq!(
            switched_on().is_early((0x40, 12), 1009),
            None,
            "another bit"
        );
        assert_eq!(
            switched_on().is_early((0x44, 11), 1009),
            None,
            "another register"
        );
        assert_eq!(switched_on().is_early((0x40, 11), 1031), Some(31));
        assert_eq!(switched_on().is_early((0x40, 11), 1032), None);
        let mut enabled = switched_on();
        enabled.clear();
        assert_eq!(enabled.is_early((0x40, 11), 1001), None);
    }
}
