//! Data watchpoint and trace unit: the cycle counter. The comparators belong to the debugger; they only store the
//! written values.

use crate::time::Cycles;

const CYCCNTENA: u32 = 1;
/// Value of DWT_CTRL: four comparators (NUMCOMP).
const CONTROL: u32 = 0x4000_0000;

#[derive(Clone, Debug, Default)]
pub(super) struct Dwt {
    control: u32,
    /// Counter value at the reference point `from`, the latest start, stop or write. `from` counts the cycles in which
    /// the core was not asleep.
    value: u32,
    from: Cycles,
    comparators: [u32; 16],
    /// DEMCR.TRCENA: true if the unit is enabled.
    pub(super) enabled: bool,
}

impl Dwt {
    fn runs(&self) -> bool {
        self.enabled && self.control & CYCCNTENA != 0
    }

    fn count(&self, awake: Cycles) -> u32 {
        if self.runs() {
            self.value
                .wrapping_add(awake.wrapping_sub(self.from) as u32)
        } else {
            self.value
        }
    }

    fn rebase(&mut self, awake: Cycles) {
        self.value = self.count(awake);
        self.from = awake;
    }

    /// Sets DEMCR.TRCENA; `awake` is the number of cycles that the core was not asleep.
    pub(super) fn enable(&mut self, enabled: bool, awake: Cycles) {
        self.rebase(awake);
        self.enabled = enabled;
    }

    /// Reads a register by its offset from 0xE000_1000.
    pub(super) fn read(&self, offset: u32, awake: Cycles) -> u32 {
        match offset {
            0 => CONTROL | self.control,
            4 => self.count(awake),
            0x20..0x60 => self.comparators[(offset as usize >> 2) & 15],
            _ => 0,
        }
    }

    /// Writes a register; false if it enables a feature that is not modelled.
    pub(super) fn write(&mut self, offset: u32, value: u32, awake: Cycles) -> bool {
        self.rebase(awake);
        match offset {
            0 => {
                self.control = value & 0x007f_ffff;
                value & 0x007f_f000 == 0
            }
            4 => {
                self.value = value;
                true
            }
            0x20..0x60 => {
                self.comparators[(offset as usize >> 2) & 15] = value;
                offset & 15 != 8 || value == 0
            }
            _ => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_only_while_both_enables_are_set() {
        let mut dwt = Dwt::default();
        dwt.write(0, CYCCNTENA, 10);
        assert_eq!(dwt.read(4, 50), 0);
        dwt.enable(true, 100);
        assert_eq!(dwt.read(4, 130), 30);
        dwt.write(0, 0, 140);
        assert_eq!(dwt.read(4, 500), 40);
        dwt.write(4, u32::MAX, 500);
        dwt.write(0, CYCCNTENA, 600);
        assert_eq!(dwt.read(4, 602), 1);
        assert_eq!(dwt.read(0, 602), CONTROL | CYCCNTENA);
    }
}
