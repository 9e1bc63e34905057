//! Memory protection unit of ARMv7-M: eight regions with subregions.
//!
//! A check walks over the regions, so its result is cached: for each page of 16 MiB, whether it is entirely readable
//! and writable; for each granule of 32 bytes in the two RAMs, the permissions. No region is smaller than 32 bytes.

const ENABLE: u32 = 1;
const HFNMIENA: u32 = 2;
const PRIVDEFENA: u32 = 4;
const REGIONS: usize = 8;

/// Kind of a data access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    Read,
    Write,
}

/// Rights of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Privileged,
    Unprivileged,
    /// Hard fault, NMI or FAULTMASK without HFNMIENA: the MPU is bypassed.
    Unchecked,
}

#[derive(Clone, Copy, Debug, Default)]
struct Region {
    base: u32,
    /// Attributes and size, as written.
    control: u32,
}

/// Bits of a cached result.
const KNOWN: u8 = 0x80;
const READ: u8 = 1;
const WRITE: u8 = 2;

/// Numbers of 32-byte granules: 128 KiB at 0x2000_0000 (SRAM1, SRAM2), 64 KiB at 0x1000_0000 (CCM).
const SRAM_GRANULES: usize = 4096;
const GRANULES: usize = SRAM_GRANULES + 2048;

#[derive(Clone, Debug)]
pub(super) struct Mpu {
    control: u32,
    selected: u32,
    regions: [Region; REGIONS],
    /// Cached results for unprivileged and privileged accesses; empty while the MPU is off.
    granules: Vec<[u8; 2]>,
}

impl Default for Mpu {
    fn default() -> Self {
        Self {
            control: 0,
            selected: 0,
            regions: [Region::default(); REGIONS],
            granules: Vec::new(),
        }
    }
}

impl Region {
    fn enabled(&self) -> bool {
        self.control & 1 != 0
    }

    /// Exponent of the size, 5 to 32.
    fn exponent(&self) -> u32 {
        (self.control >> 1 & 31) + 1
    }

    fn matches(&self, address: u32) -> bool {
        let exponent = self.exponent();
        if !self.enabled() || exponent < 5 {
            return false;
        }
        let inside = if exponent >= 32 {
            true
        } else {
            address >> exponent == self.base >> exponent
        };
        // Regions below 256 bytes have no subregions.
        let subregion = address >> (exponent.max(8) - 3) & 7;
        inside && (exponent < 8 || self.control >> (8 + subregion) & 1 == 0)
    }

    /// Permissions, READ and WRITE.
    fn permissions(&self, privileged: bool) -> u8 {
        match (self.control >> 24 & 7, privileged) {
            (1, true) | (2, true) | (3, _) => READ | WRITE,
            (2, false) | (5, true) | (6 | 7, _) => READ,
            _ => 0,
        }
    }

    fn overlaps_page(&self, page: u32) -> bool {
        let exponent = self.exponent();
        if !self.enabled() || exponent < 5 {
            return false;
        }
        if exponent >= 32 {
            return true;
        }
        let shift = exponent.max(24);
        (page << 24) >> shift == self.base >> shift
    }
}

impl Mpu {
    pub(super) fn enabled(&self) -> bool {
        self.control & ENABLE != 0
    }

    /// True if HFNMIENA is set: accesses by the handlers of hard fault and NMI are also checked.
    pub(super) fn checks_faults(&self) -> bool {
        self.control & HFNMIENA != 0
    }

    /// Reads a register by its offset from 0xE000_ED90.
    pub(super) fn read(&self, offset: u32) -> u32 {
        let region = &self.regions[self.selected as usize & 7];
        match offset {
            0 => (REGIONS as u32) << 8,
            4 => self.control,
            8 => self.selected,
            0x0c | 0x14 | 0x1c | 0x24 => region.base & !31 | self.selected & 7,
            0x10 | 0x18 | 0x20 | 0x28 => region.control,
            _ => 0,
        }
    }

    /// Writes a register and clears the cache.
    pub(super) fn write(&mut self, offset: u32, value: u32) {
        match offset {
            4 => self.control = value & (ENABLE | HFNMIENA | PRIVDEFENA),
            8 => self.selected = value & 7,
            0x0c | 0x14 | 0x1c | 0x24 => {
                if value & 0x10 != 0 {
                    self.selected = value & 7;
                }
                self.regions[self.selected as usize & 7].base = value & !31;
            }
            0x10 | 0x18 | 0x20 | 0x28 => {
                self.regions[self.selected as usize & 7].control = value & 0x173f_ff3f;
            }
            _ => {}
        }
        self.granules.clear();
        if self.enabled() {
            self.granules.resize(GRANULES, [0; 2]);
        }
    }

    /// True if the whole page of 16 MiB is readable and writable.
    pub(super) fn page_is_open(&self, page: u32, mode: Mode) -> bool {
        if !self.enabled() || mode == Mode::Unchecked {
            return true;
        }
        if self.regions.iter().any(|r| r.overlaps_page(page)) {
            // The page is uniform if the highest region that overlaps it covers all of it.
            let Some(last) = self.regions.iter().rfind(|r| r.overlaps_page(page)) else {
                return false;
            };
            let whole =
                last.exponent() >= 27 || (last.exponent() >= 24 && last.control & 0xff00 == 0);
            let open = last.permissions(mode == Mode::Privileged) == READ | WRITE;
            return whole && open && last.matches(page << 24);
        }
        self.control & PRIVDEFENA != 0 && mode == Mode::Privileged
    }

    /// True if instructions may be fetched from the whole page of 16 MiB; the page must be executable in the default
    /// map.
    pub(super) fn page_executes(&self, page: u32, mode: Mode) -> bool {
        let by_default = self.control & PRIVDEFENA != 0 && mode == Mode::Privileged;
        let touched = || self.regions.iter().any(|r| r.overlaps_page(page));
        !self.enabled() || mode == Mode::Unchecked || by_default && !touched()
    }

    fn walk(&self, address: u32, privileged: bool) -> u8 {
        match self.regions.iter().rfind(|r| r.matches(address)) {
            Some(region) => region.permissions(privileged),
            None if self.control & PRIVDEFENA != 0 && privileged => READ | WRITE,
            None => 0,
        }
    }

    /// True if a load or store is permitted; not for the private peripherals.
    pub(super) fn allows_data(&mut self, address: u32, access: Access, mode: Mode) -> bool {
        if !self.enabled() || mode == Mode::Unchecked {
            return true;
        }
        let privileged = mode == Mode::Privileged;
        let wanted = if access == Access::Write { WRITE } else { READ };
        let granule = match address {
            0x2000_0000..0x2002_0000 => (address as usize & 0x1_ffff) >> 5,
            0x1000_0000..0x1001_0000 => SRAM_GRANULES + ((address as usize & 0xffff) >> 5),
            _ => return self.walk(address, privileged) & wanted != 0,
        };
        let kept = self
            .granules
            .get(granule)
            .map_or(0, |g| g[usize::from(privileged)]);
        if kept & KNOWN != 0 {
            return kept & wanted != 0;
        }
        let permissions = self.walk(address, privileged);
        if let Some(g) = self.granules.get_mut(granule) {
            g[usize::from(privileged)] = permissions | KNOWN;
        }
        permissions & wanted != 0
    }

    /// True if an instruction fetch is permitted. The default map forbids peripherals and devices.
    pub(super) fn allows_fetch(&self, address: u32, mode: Mode) -> bool {
        let default = !matches!(address >> 28, 4 | 5 | 0xa..=0xf);
        if !self.enabled() || mode == Mode::Unchecked {
            return default;
        }
        if address >> 28 >= 0xe {
            return false;
        }
        let privileged = mode == Mode::Privileged;
        match self.regions.iter().rfind(|r| r.matches(address)) {
            Some(region) => {
                region.control >> 28 & 1 == 0 && region.permissions(privileged) & READ != 0
            }
            None => default && privileged && self.control & PRIVDEFENA != 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RW: u32 = 3 << 24;
    const RO: u32 = 6 << 24;

    fn unit(regions: &[(u32, u32)], control: u32) -> Mpu {
        let mut mpu = Mpu::default();
        for (k, &(base, attributes)) in regions.iter().enumerate() {
            mpu.write(0x0c, base | 0x10 | k as u32);
            mpu.write(0x10, attributes);
        }
        mpu.write(4, control);
        mpu
    }

    /// SIZE and ENABLE of RASR for an enabled region of 2^`exponent` bytes.
    const fn size(exponent: u32) -> u32 {
        (exponent - 1) << 1 | 1
    }

    #[test]
    fn guard_region_of_32_bytes_forbids_only_its_bytes() {
        let guard = (0x2000_1000, size(5));
        let mut mpu = unit(&[guard], ENABLE | PRIVDEFENA);
        for address in (0x2000_0f00..0x2000_1100u32).step_by(4) {
            let expected = !(0x2000_1000..0x2000_1020).contains(&address);
            for _ in 0..2 {
                let allowed = mpu.allows_data(address, Access::Write, Mode::Privileged);
                assert_eq!(allowed, expected, "{address:#x}");
            }
            assert!(mpu.allows_data(address, Access::Write, Mode::Unchecked));
            assert!(!mpu.allows_data(address, Access::Read, Mode::Unprivileged));
        }
        assert!(!mpu.page_is_open(0x20, Mode::Privileged));
        assert!(mpu.page_is_open(0x40, Mode::Privileged));
        assert!(!mpu.page_is_open(0x40, Mode::Unprivileged));
    }

    #[test]
    fn highest_region_wins_and_disabled_subregions_fall_through() {
        // A writable region of 64 KiB contains a read-only region of 2 KiB, whose subregions 0 and 7 are disabled.
        let regions = [
            (0x2000_0000, RW | size(16)),
            (0x2000_0800, RO | 0x81 << 8 | size(11)),
        ];
        let mut mpu = unit(&regions, ENABLE);
        for address in (0x2000_0000..0x2001_0000u32).step_by(32) {
            let read_only = (0x2000_0900..0x2000_0f00).contains(&address);
            let write = mpu.allows_data(address, Access::Write, Mode::Unprivileged);
            assert_eq!(write, !read_only, "{address:#x}");
            assert!(mpu.allows_data(address, Access::Read, Mode::Unprivileged));
        }
        assert!(!mpu.allows_data(0x2001_0000, Access::Read, Mode::Privileged));
    }

    #[test]
    fn permissions_follow_the_table_of_the_manual() {
        // Each row is AP, and four bits: privileged read, write, unprivileged read, write (table B3-15).
        let table = [
            (0, 0b0000),
            (1, 0b1100),
            (2, 0b1110),
            (3, 0b1111),
            (5, 0b1000),
            (6, 0b1010),
            (7, 0b1010),
        ];
        for (ap, bits) in table {
            let mut mpu = unit(&[(0x6000_0000, ap << 24 | size(20))], ENABLE | PRIVDEFENA);
            let asked = [
                (Access::Read, Mode::Privileged),
                (Access::Write, Mode::Privileged),
                (Access::Read, Mode::Unprivileged),
                (Access::Write, Mode::Unprivileged),
            ];
            for (k, (access, mode)) in asked.into_iter().enumerate() {
                let expected = bits >> (3 - k) & 1 != 0;
                assert_eq!(
                    mpu.allows_data(0x6000_0040, access, mode),
                    expected,
                    "{ap} {k}"
                );
            }
            assert_eq!(
                mpu.allows_fetch(0x6000_0040, Mode::Privileged),
                bits & 8 != 0
            );
        }
    }

    #[test]
    fn execute_never_and_default_map_forbid_fetching() {
        let regions = [
            (0x2000_0000, 1 << 28 | RW | size(17)),
            (0x4000_0000, RW | size(20)),
        ];
        let mpu = unit(&regions, ENABLE | PRIVDEFENA);
        assert!(!mpu.allows_fetch(0x2000_0000, Mode::Privileged));
        assert!(mpu.allows_fetch(0x4000_0000, Mode::Privileged));
        assert!(!mpu.allows_fetch(0x5000_0000, Mode::Privileged));
        assert!(mpu.allows_fetch(0x0800_0000, Mode::Privileged));
        assert!(mpu.page_executes(0x08, Mode::Privileged));
        assert!(!mpu.page_executes(0x20, Mode::Privileged));
        assert!(!mpu.allows_fetch(0x0800_0000, Mode::Unprivileged));
        assert!(!mpu.page_executes(0x08, Mode::Unprivileged));
        assert!(!unit(&regions, ENABLE).page_executes(0x08, Mode::Privileged));
        assert!(unit(&regions, ENABLE).page_executes(0x08, Mode::Unchecked));
        let off = Mpu::default();
        assert!(off.allows_fetch(0x2000_0000, Mode::Unprivileged));
        assert!(!off.allows_fetch(0x4000_0000, Mode::Privileged));
        assert!(!off.allows_fetch(0xe000_0000, Mode::Privileged));
    }

    #[test]
    fn page_is_open_only_if_all_of_it_is() {
        let all = [(0, RW | size(32))];
        assert!(unit(&all, ENABLE).page_is_open(0x20, Mode::Unprivileged));
        let read_only = [(0, RW | size(32)), (0x0800_0000, RO | size(20))];
        let mpu = unit(&read_only, ENABLE);
        assert!(!mpu.page_is_open(0x08, Mode::Privileged));
        assert!(mpu.page_is_open(0x09, Mode::Privileged));
    }
}
