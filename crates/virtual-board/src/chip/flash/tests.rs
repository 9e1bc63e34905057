use super::*;
use crate::chip::testing::shared;

fn of(address: u32, width: Width) -> Transfer {
    Transfer {
        address,
        width,
        pc: 0,
    }
}

fn word(address: u32) -> Transfer {
    of(address, Width::Word)
}

fn unlocked(shared: &mut Shared) -> Flash {
    let mut flash = Flash::default();
    for key in [0x4567_0123, 0xcdef_89ab] {
        flash.write(0x04, key, !0, shared);
    }
    flash
}

#[test]
fn programming_clears_bits_and_stalls_the_core() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    flash.write(0x10, PG | 2 << 8, !0, &mut shared);
    for (value, stands) in [(0xffff_00ff, 0xffff_00ff), (0x1234_5678, 0x1234_0078)] {
        let mut cycle = shared.now;
        flash.program(word(BASE + 0x8000), value, &mut cycle, &mut shared);
        assert_ne!(flash.read(0x0c, &mut shared) & BSY, 0);
        let mut cycle = shared.now;
        let read = flash.load(word(BASE + 0x8000), &mut cycle, &mut shared);
        assert_eq!(read, Some(stands));
        // Programming takes 16 µs, 256 cycles at 16 MHz; the load waits for its end.
        assert_eq!(cycle - shared.now, 256);
        shared.now = cycle;
    }
    assert!(shared.findings.list().is_empty());
}

#[test]
fn sector_erase_takes_the_data_sheets_time_and_erases_its_sector_only() {
    // Typical times in the data sheet for 32-bit and 8-bit parallelism.
    for (size, millis) in [(2, 550), (0, 1200)] {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.bytes_mut().fill(0);
        flash.write(0x10, SER | 4 << 3 | size << 8 | STRT, !0, &mut shared);
        let due = shared.due(Unit::Flash);
        assert_eq!(due, millis * 16_000);
        assert_ne!(flash.read(0x0c, &mut shared) & BSY, 0);
        shared.now = due;
        flash.event(&mut shared);
        assert_eq!(flash.read(0x0c, &mut shared) & BSY, 0);
        assert_eq!(flash.peek(BASE + 0xffff, Width::Byte), Some(0));
        assert_eq!(flash.peek(BASE + 0x1_0000, Width::Word), Some(!0));
        assert_eq!(flash.peek(BASE + 0x1_ffff, Width::Byte), Some(0xff));
        assert_eq!(flash.peek(BASE + 0x2_0000, Width::Byte), Some(0));
    }
}

#[test]
fn forbidden_accesses_are_findings_without_effect() {
    let mut shared = shared();
    let mut flash = Flash::default();
    let mut cycle = 0;
    flash.program(word(BASE), 0, &mut cycle, &mut shared);
    flash.write(0x10, PG, !0, &mut shared);
    flash.write(0x04, 1, !0, &mut shared);
    assert!(shared.bus_error);
    for key in [0x4567_0123, 0xcdef_89ab] {
        flash.write(0x04, key, !0, &mut shared);
    }
    assert_eq!(flash.read(0x10, &mut shared), LOCK);
    assert_eq!(flash.peek(BASE, Width::Word), Some(!0));
    assert!(shared.findings.list().len() >= 3);
}

/// Error flags after a store of this width.
fn errors_of(flash: &mut Flash, width: Width, shared: &mut Shared) -> u32 {
    flash.write(0x0c, CLEARED_BY_ONE, !0, shared);
    let mut cycle = shared.now;
    flash.program(of(BASE + 0x2_0000, width), 0, &mut cycle, shared);
    flash.read(0x0c, shared) & !BSY
}

#[test]
fn each_error_sets_its_flag() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    assert_eq!(errors_of(&mut flash, Width::Word, &mut shared), PGSERR);
    flash.write(0x10, PG | 2 << 8 | ERRIE, !0, &mut shared);
    let found = errors_of(&mut flash, Width::Byte, &mut shared);
    assert_eq!(found, PGPERR | OPERR);
    assert_eq!(shared.lines, 1 << Interrupt::Flash as u32);
    flash.write(0x10, MER | STRT, !0, &mut shared);
    flash.write(0x08, 1, !0, &mut shared);
    assert_eq!(flash.read(0x0c, &mut shared) & BSY, 0);
    assert_eq!(shared.kinds()[2..], [FindingKind::NotModelled; 2]);
    assert_eq!(flash.peek(BASE + 0x2_0000, Width::Word), Some(!0));
}

#[test]
fn end_of_operation_interrupts_and_a_write_to_cr_stalls_until_then() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    flash.write(0x10, PG | 2 << 8 | EOPIE, !0, &mut shared);
    let mut cycle = shared.now;
    flash.program(word(BASE), 0, &mut cycle, &mut shared);
    assert_eq!(shared.lines, 0);
    flash.write(0x10, EOPIE, !0, &mut shared);
    // Programming takes 16 µs, 256 cycles at 16 MHz; the write to CR waits for its end.
    assert_eq!(shared.held_until, 256);
    assert_eq!(flash.read(0x0c, &mut shared), EOP);
    assert_eq!(shared.lines, 1 << Interrupt::Flash as u32);
    flash.write(0x0c, EOP, !0, &mut shared);
    assert_eq!(shared.lines, 0);
}

#[test]
fn low_supply_or_slow_clock_is_a_finding() {
    for (volts, size, hz, findings) in [
        (2.75, 2, 16_000_000, 0),
        (2.65, 2, 16_000_000, 1),
        (2.65, 1, 16_000_000, 0),
        (3.3, 2, 500_000, 1),
    ] {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        shared.volts = volts;
        shared.clocks.hclk_hz = hz;
        flash.write(0x10, SER | size << 8 | STRT, !0, &mut shared);
        assert_eq!(shared.findings.list().len(), findings, "{volts} {size}");
    }
}

#[test]
fn power_cut_while_programming_leaves_random_bits() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    let mut torn = 0;
    for k in 0..32 {
        flash.cr = PG | 2 << 8;
        let mut cycle = 0;
        flash.program(word(BASE + 4 * k), 0xff, &mut cycle, &mut shared);
        flash.reset(&mut shared);
        let word = flash.peek(BASE + 4 * k, Width::Word).unwrap_or(0);
        assert_eq!(word & 0xff, 0xff, "bits that were not to be cleared");
        torn += u32::from(word != 0xff && word != !0);
    }
    assert!(torn > 25, "{torn}");
}

#[test]
fn power_cut_while_erasing_leaves_a_mixture_of_old_and_erased_bytes() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    flash.bytes_mut().fill(0x5a);
    flash.write(0x10, SER | 1 << 3 | 2 << 8 | STRT, !0, &mut shared);
    flash.reset(&mut shared);
    let (before, rest) = flash.bytes.split_at(0x4000);
    let (sector, behind) = rest.split_at(0x4000);
    let count = |bytes: &[u8], byte: u8| bytes.iter().filter(|b| **b == byte).count();
    for byte in [0x5a, 0xff] {
        let found = count(sector, byte);
        assert!((3000..6000).contains(&found), "{byte} {found}");
    }
    for others in [before, behind] {
        assert_eq!(count(others, 0x5a), others.len());
    }
}

#[test]
fn data_cache_returns_old_bytes_after_an_erase_until_reset() {
    let mut shared = shared();
    let mut flash = unlocked(&mut shared);
    flash.bytes_mut()[0x8000] = 0x12;
    flash.write(0x00, DCEN | 5, !0, &mut shared);
    let load = |flash: &mut Flash, shared: &mut Shared| {
        let mut cycle = shared.now;
        flash.load(of(BASE + 0x8000, Width::Byte), &mut cycle, shared)
    };
    assert_eq!(load(&mut flash, &mut shared), Some(0x12));
    flash.write(0x10, SER | 2 << 3 | 2 << 8 | STRT, !0, &mut shared);
    assert_eq!(load(&mut flash, &mut shared), Some(0x12));
    assert_eq!(flash.peek(BASE + 0x8000, Width::Byte), Some(0xff));
    // Resetting the cache while it is on has no effect.
    flash.write(0x00, DCEN | DCRST | 5, !0, &mut shared);
    assert_eq!(load(&mut flash, &mut shared), Some(0x12));
    assert_eq!(shared.findings.list().len(), 1);
    for acr in [5, DCRST | 5, DCEN | 5] {
        flash.write(0x00, acr, !0, &mut shared);
    }
    assert_eq!(load(&mut flash, &mut shared), Some(0xff));
}
