//! Option bytes and the register that shows them.
//!
//! The register can be written at any time once it is unlocked; the bytes follow when it is told so.
//! Protection of sectors and of reading counts from then on, the hardware watchdog from the next reset,
//! the brown-out level from the next power-on. Bytes whose writing was cut short are taken as erased.

/// OPTCR: the lock, and the start.
pub(super) const OPTLOCK: u32 = 1;
pub(super) const OPTSTRT: u32 = 1 << 1;
/// No write protection, no read protection, brown-out off, software watchdog: a new chip.
const BLANK: u32 = 0x0fff_aaec;
const ERASED: u32 = 0x0fff_ffec;
const WDG_SW: u32 = 1 << 5;

/// Read protection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protection {
    None,
    Debugger,
    Forever,
}

impl Protection {
    fn of(register: u32) -> Self {
        match register >> 8 & 0xff {
            0xaa => Self::None,
            0xcc => Self::Forever,
            _ => Self::Debugger,
        }
    }
}

/// Option bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    /// As the register has them at the places of its bits.
    bytes: u32,
    /// Brown-out level in force.
    brown_out: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            bytes: BLANK,
            brown_out: BLANK >> 2 & 3,
        }
    }
}

impl Options {
    /// What the register shows after a reset.
    pub fn register(&self) -> u32 {
        self.bytes | OPTLOCK
    }

    /// Power came on: the brown-out level is loaded.
    pub fn load(&mut self) {
        self.brown_out = self.bytes >> 2 & 3;
    }

    /// Brown-out level in force: 0 is the highest, 3 is off.
    pub fn brown_out(&self) -> u32 {
        self.brown_out
    }

    /// Whether the watchdog starts by itself.
    pub fn starts_watchdog(&self) -> bool {
        self.bytes & WDG_SW == 0
    }

    /// Whether a sector can be neither erased nor programmed.
    pub fn is_protected(&self, sector: u32) -> bool {
        self.bytes >> (16 + sector) & 1 == 0
    }

    /// Whether any sector is so.
    pub fn is_any_protected(&self) -> bool {
        self.bytes >> 16 & 0xfff != 0xfff
    }

    pub fn protection(&self) -> Protection {
        Protection::of(self.bytes)
    }

    /// Whether this value of the register takes read protection away, which erases the flash.
    pub fn unprotects(&self, register: u32) -> bool {
        self.protection() == Protection::Debugger && Protection::of(register) == Protection::None
    }

    /// Writes the bytes.
    pub fn write(&mut self, register: u32) {
        self.bytes = register & !(OPTLOCK | OPTSTRT);
    }

    /// Writing them was cut short.
    pub fn tear(&mut self) {
        self.bytes = ERASED;
    }

    /// Byte 0 to 15 of their place in memory: each half stands beside its complement.
    pub fn byte(&self, at: u32) -> u8 {
        let half = match at & !3 {
            0 => self.bytes & 0xffec,
            8 => self.bytes >> 16 & 0xfff,
            _ => return 0xff,
        };
        (((half & 0xffff) | !half << 16) >> (8 * (at & 3))) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_chip_has_the_manuals_reset_value() {
        let options = Options::default();
        assert_eq!(options.register(), 0x0fff_aaed);
        assert_eq!((options.brown_out(), options.starts_watchdog()), (3, false));
        assert!(!options.is_any_protected());
        // RDP and user byte, complemented; then the protections of the sectors.
        let bytes: Vec<_> = (0..12).map(|at| options.byte(at)).collect();
        assert_eq!(bytes[..4], [0xec, 0xaa, 0x13, 0x55]);
        assert_eq!(bytes[8..], [0xff, 0x0f, 0x00, 0xf0]);
    }

    #[test]
    fn the_brown_out_level_counts_from_the_next_power_on() {
        let mut options = Options::default();
        options.write(options.register() & !0xc);
        assert_eq!(options.brown_out(), 3);
        options.load();
        assert_eq!(options.brown_out(), 0);
    }

    #[test]
    fn read_protection_that_is_taken_away_erases() {
        let mut options = Options::default();
        let level = |options: &Options, rdp: u32| options.register() & !0xff00 | rdp << 8;
        let mut erases = |rdp: u32| {
            let register = level(&options, rdp);
            let erases = options.unprotects(register);
            options.write(register);
            erases
        };
        assert_eq!([0x55, 0xaa, 0xcc].map(&mut erases), [false, true, false]);
        assert_eq!(options.protection(), Protection::Forever);
    }

    #[test]
    fn sectors_are_protected_one_by_one() {
        let mut options = Options::default();
        options.write(options.register() & !(1 << 18));
        assert!(options.is_protected(2) && !options.is_protected(3));
        assert!(options.is_any_protected());
    }
}
