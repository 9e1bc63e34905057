//! The flash: bytes, wait states, erasing and programming, option bytes.
//!
//! Source: reference manual RM0090, chapter 3; times are typical ones of the data sheet (x32 at 3.3 V).
//! Erasing sets bits, programming clears them. While an operation runs, the core waits at its next
//! fetch or load from the flash. When the power fails during an operation, bits of the word are
//! programmed at random, and bytes of the sector are erased at random.
//!
//! Not modelled: bank 2, programming of 64 bits, the OTP area's locks, PCROP.

mod accelerator;

use super::Peripheral;
use super::interrupt::Interrupt;
use super::register::{Register, merge, word};
use super::shared::{Shared, Source};
use crate::core::{BusError, Width};
use crate::finding::Kind;
use crate::time::{Cycles, NEVER, Time, Timebase};
use accelerator::Accelerator;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "ACR", 0x1f07), word(0x04, "KEYR", !0), word(0x08, "OPTKEYR", !0), word(0x0c, "SR", 0x0001_00f3),
    word(0x10, "CR", 0x8301_037f), word(0x14, "OPTCR", 0x0fff_ffef),
];

const LENGTH: usize = 1 << 20;
const BASE: u32 = 0x0800_0000;
/// Option bytes as the program can read them.
const OPTIONS: u32 = 0x1fff_c000;

// Bits of SR.
const EOP: u32 = 1;
const WRPERR: u32 = 1 << 4;
const PGAERR: u32 = 1 << 5;
const PGPERR: u32 = 1 << 6;
const PGSERR: u32 = 1 << 7;
const BSY: u32 = 1 << 16;
const ERRORS: u32 = 0xf2;
// Bits of CR.
const PG: u32 = 1;
const SER: u32 = 1 << 1;
const MER: u32 = 1 << 2;
const STRT: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
// Bits of OPTCR.
const OPTLOCK: u32 = 1;
const OPTSTRT: u32 = 1 << 1;

/// Programming a byte, half or word.
const PROGRAM: Time = Time::from_micros(16);
/// Writing the option bytes.
const PROGRAM_OPTIONS: Time = Time::from_micros(20_000);

/// First and last byte, and time to erase, of a sector.
fn sector(number: u32) -> Option<(usize, usize, Time)> {
    let kib = |k: usize| k << 10;
    let (first, length, millis) = match number {
        0..=3 => (kib(16) * number as usize, kib(16), 250),
        4 => (kib(64), kib(64), 550),
        5..=11 => (kib(128) * (number as usize - 4), kib(128), 1000),
        _ => return None,
    };
    Some((first, first + length - 1, Time::from_micros(1000 * millis)))
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operation {
    /// A place, its length, and what stood there.
    Program(usize, usize, u32),
    /// First and last byte.
    Erase(usize, usize),
    Options,
}

/// The flash and its interface.
pub(crate) struct Flash {
    bytes: Vec<u8>,
    accelerator: Accelerator,
    acr: u32,
    sr: u32,
    cr: u32,
    optcr: u32,
    /// Option bytes as they will be found at the next reset.
    options: u32,
    /// Keys given so far to KEYR and OPTKEYR; two open, a wrong one closes until a reset.
    keys: [u8; 2],
    operation: Option<Operation>,
    busy_until: Time,
    changed: Option<(u32, u32)>,
    random: u64,
}

/// A lock that no key opens until a reset.
const BROKEN: u8 = 9;
/// Option bytes of a new chip: no write protection, no read protection, brown-out off.
const BLANK_OPTIONS: u32 = 0x0fff_aaec;

impl Default for Flash {
    fn default() -> Self {
        Self {
            bytes: vec![0xff; LENGTH],
            accelerator: Accelerator::new(),
            acr: 0,
            sr: 0,
            cr: LOCK,
            optcr: BLANK_OPTIONS | OPTLOCK,
            options: BLANK_OPTIONS,
            keys: [0; 2],
            operation: None,
            busy_until: Time(0),
            changed: None,
            random: 0x9e37_79b9_7f4a_7c15,
        }
    }
}

impl Flash {
    /// The interface after a reset; the bytes stay. An operation under way was cut short if the power
    /// was off.
    pub fn reset(&mut self) {
        self.accelerator = Accelerator::new();
        (self.acr, self.sr, self.cr) = (0, 0, LOCK);
        self.optcr = self.options | OPTLOCK;
        self.keys = [0; 2];
        if let Some(operation) = self.operation.take() {
            self.tear(operation);
        }
        self.changed = Some((BASE, BASE + LENGTH as u32 - 1));
    }

    /// Brown-out level by the option bytes in force: 3 is off.
    pub fn brown_out(&self) -> u32 {
        self.options >> 2 & 3
    }

    /// Its bytes.
    pub fn bytes_mut(&mut self) -> &mut Vec<u8> {
        self.changed = Some((BASE, BASE + LENGTH as u32 - 1));
        &mut self.bytes
    }

    /// Wait states that the program has set.
    pub fn wait_states(&self) -> u64 {
        self.accelerator.wait_states
    }

    /// What an operation leaves that was cut short.
    fn tear(&mut self, operation: Operation) {
        let mut random = self.random;
        let mut draw = || {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random as u8
        };
        match operation {
            Operation::Program(at, length, before) => {
                let before = before.to_le_bytes();
                for (byte, before) in self.bytes[at..at + length].iter_mut().zip(before) {
                    *byte |= before & draw();
                }
            }
            Operation::Erase(first, last) => {
                for byte in &mut self.bytes[first..=last] {
                    *byte |= draw();
                }
            }
            Operation::Options => {}
        }
        self.random = random;
    }

    fn place(address: u32) -> Option<usize> {
        let at = address.wrapping_sub(BASE) as usize;
        if at < LENGTH {
            return Some(at);
        }
        // With the boot pin low the flash is seen at 0 too.
        ((address as usize) < LENGTH).then_some(address as usize)
    }

    /// What stands at an address of the flash, its alias at 0, or the option bytes; none elsewhere.
    pub fn peek(&self, address: u32, width: Width) -> Option<u32> {
        if let Some(at) = Self::place(address) {
            return Some(super::get(&self.bytes, at, width));
        }
        let offset = address.wrapping_sub(OPTIONS);
        (offset < 16).then(|| {
            let half = |value: u32| value | !value << 16;
            let value = match offset & !3 {
                0 => half(self.options & 0xffec),
                8 => half(self.options >> 16 & 0xfff),
                _ => !0,
            };
            value >> (8 * (offset & 3))
        })
    }

    /// The same as a load by the program, with what it takes.
    #[inline]
    pub fn load(
        &mut self,
        address: u32,
        width: Width,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> Option<Result<u32, BusError>> {
        let Some(at) = Self::place(address) else {
            return self.peek(address, width).map(Ok);
        };
        if self.operation.is_some() {
            self.stall(cycle, shared);
        }
        let line = at / 16;
        let bytes = &self.bytes[16 * line..16 * line + 16];
        let seen = self.accelerator.load(line as u32, bytes, cycle);
        Some(Ok(super::get(seen, at % 16, width)))
    }

    /// The core waits until the operation has ended.
    #[cold]
    fn stall(&mut self, cycle: &mut Cycles, shared: &mut Shared) {
        *cycle = (*cycle).max(shared.base.cycle_of(self.busy_until));
        self.finish(shared);
    }

    fn finish(&mut self, shared: &mut Shared) {
        if self.operation.take().is_some() {
            self.sr &= !BSY;
            if self.cr & 1 << 24 != 0 {
                self.sr |= EOP;
            }
            shared.schedule(Source::Flash, NEVER);
            self.line(shared);
        }
    }

    fn line(&self, shared: &mut Shared) {
        let end = self.sr & EOP != 0 && self.cr & 1 << 24 != 0;
        let error = self.sr & ERRORS != 0 && self.cr & 1 << 25 != 0;
        shared.line(Interrupt::Flash, end || error);
    }

    fn begin(&mut self, operation: Operation, takes: Time, shared: &mut Shared) {
        self.sr |= BSY;
        self.operation = Some(operation);
        self.busy_until = shared.time() + takes;
        let cycle = shared.base.cycle_of(self.busy_until);
        shared.schedule(Source::Flash, cycle);
    }

    fn change(&mut self, first: usize, last: usize) {
        let (first, last) = (BASE + first as u32, BASE + last as u32);
        self.changed = Some(match self.changed {
            Some((a, b)) => (a.min(first), b.max(last)),
            None => (first, last),
        });
    }

    fn is_protected(&self, number: u32) -> bool {
        self.options >> (16 + number) & 1 == 0
    }

    fn sector_of(at: usize) -> u32 {
        (0..12)
            .find(|&number| sector(number).is_some_and(|(_, last, _)| at <= last))
            .unwrap_or(11)
    }

    /// A store to an address of the flash; none elsewhere.
    pub fn program(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> Option<Result<(), BusError>> {
        let at = Self::place(address)?;
        if self.operation.is_some() {
            self.stall(cycle, shared);
            shared.now = *cycle;
        }
        if self.cr & (LOCK | PG) != PG {
            shared.note(
                Kind::Forbidden,
                format!("flash written at {address:#010x} without PG"),
            );
            self.sr |= PGSERR;
            self.line(shared);
            return Some(Ok(()));
        }
        if self.cr >> 8 & 3 != width.bytes().trailing_zeros() {
            shared.note(
                Kind::Forbidden,
                "flash written in another width than PSIZE says",
            );
            self.sr |= PGPERR;
            return Some(Ok(()));
        }
        if self.is_protected(Self::sector_of(at)) {
            self.sr |= WRPERR;
            return Some(Ok(()));
        }
        let before = super::get(&self.bytes, at, width);
        super::put(&mut self.bytes, at, width, before & value);
        let length = width.bytes() as usize;
        self.change(at, at + length - 1);
        self.begin(Operation::Program(at, length, before), PROGRAM, shared);
        Some(Ok(()))
    }

    fn erase(&mut self, shared: &mut Shared) {
        let number = self.cr >> 3 & 15;
        let (first, last, takes) = if self.cr & MER != 0 {
            (0, LENGTH - 1, Time::from_micros(8_000_000))
        } else if let Some(sector) = sector(number) {
            sector
        } else {
            shared.note(
                Kind::Forbidden,
                format!("flash sector {number} erased: there are 12"),
            );
            return;
        };
        if self.is_protected(number) {
            self.sr |= WRPERR;
            return;
        }
        // What stood there is needed if the power fails; it is lost bit by bit then.
        self.bytes[first..=last].fill(0xff);
        self.change(first, last);
        self.begin(Operation::Erase(first, last), takes, shared);
    }

    /// The program enters a line of 16 bytes.
    #[inline]
    pub fn enter_line(&mut self, address: u32, cycle: &mut Cycles, shared: &mut Shared) {
        if let Some(at) = Self::place(address) {
            if self.operation.is_some() {
                self.stall(cycle, shared);
            }
            self.accelerator.enter(at as u32 / 16, cycle);
        }
    }

    /// Addresses whose bytes changed since the last call, first and last.
    #[inline]
    pub fn take_changed(&mut self) -> Option<(u32, u32)> {
        self.changed.take()
    }

    fn key(&mut self, which: usize, value: u32, keys: [u32; 2], shared: &mut Shared) {
        let given = &mut self.keys[which];
        *given = match *given {
            k @ (0 | 1) if value == keys[k as usize] => k + 1,
            _ => {
                shared.note(
                    Kind::Forbidden,
                    "flash: a wrong key, locked until the next reset",
                );
                BROKEN
            }
        };
        if *given == 2 {
            *given = 0;
            match which {
                0 => self.cr &= !LOCK,
                _ => self.optcr &= !OPTLOCK,
            }
        }
    }

    fn write_cr(&mut self, value: u32, shared: &mut Shared) {
        if self.cr & LOCK != 0 {
            shared.note(Kind::Forbidden, "FLASH_CR written while locked");
            return;
        }
        if self.sr & BSY != 0 {
            shared.note(Kind::Forbidden, "FLASH_CR written while busy");
            return;
        }
        self.cr = value & !STRT;
        if value & STRT != 0 {
            match value & (PG | SER | MER) {
                SER | MER => self.erase(shared),
                _ => {
                    shared.note(Kind::Forbidden, "FLASH_CR: STRT without one of SER and MER");
                    self.sr |= PGSERR;
                }
            }
        }
        self.line(shared);
    }

    fn write_acr(&mut self, value: u32, shared: &mut Shared) {
        for (reset, on, name) in [(11, 9, "instruction"), (12, 10, "data")] {
            if value >> reset & 1 != 0 && self.acr >> on & 1 != 0 {
                let text = format!("FLASH_ACR: the {name} cache is reset while it is on");
                shared.note(Kind::Forbidden, text);
            }
        }
        self.acr = value & 0x1f07;
        self.accelerator.set(value);
    }

    fn write_optcr(&mut self, value: u32, shared: &mut Shared) {
        if self.optcr & OPTLOCK != 0 {
            shared.note(Kind::Forbidden, "FLASH_OPTCR written while locked");
            return;
        }
        self.optcr = value & !OPTSTRT;
        if value & OPTSTRT != 0 {
            self.options = value & !(OPTLOCK | OPTSTRT);
            self.begin(Operation::Options, PROGRAM_OPTIONS, shared);
        }
    }
}

impl Peripheral for Flash {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.acr,
            0x0c => self.sr,
            0x10 => self.cr,
            0x14 => self.optcr,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => self.write_acr(merge(self.acr, value, mask), shared),
            0x04 => self.key(0, value, [0x4567_0123, 0xcdef_89ab], shared),
            0x08 => self.key(1, value, [0x0819_2a3b, 0x4c5d_6e7f], shared),
            0x0c => {
                self.sr &= !(value & 0xf3);
                self.line(shared);
            }
            0x10 => self.write_cr(value, shared),
            _ => self.write_optcr(merge(self.optcr, value, mask), shared),
        }
        let _ = PGAERR;
    }

    fn event(&mut self, _source: Source, shared: &mut Shared) {
        self.finish(shared);
    }

    fn clocks_changed(&mut self, _old: &Timebase, shared: &mut Shared) {
        if self.operation.is_some() {
            let cycle = shared.base.cycle_of(self.busy_until);
            shared.schedule(Source::Flash, cycle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    fn unlocked(shared: &mut Shared) -> Flash {
        let mut flash = Flash::default();
        for key in [0x4567_0123, 0xcdef_89ab] {
            flash.write(0x04, key, !0, shared);
        }
        flash
    }

    #[test]
    fn a_word_is_programmed_by_clearing_bits_and_the_core_waits_for_it() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.write(0x10, PG | 2 << 8, !0, &mut shared);
        for (value, stands) in [(0xffff_00ff, 0xffff_00ff), (0x1234_5678, 0x1234_0078)] {
            let mut cycle = shared.now;
            flash.program(BASE + 0x8000, Width::Word, value, &mut cycle, &mut shared);
            assert_ne!(flash.read(0x0c, &mut shared) & BSY, 0);
            let mut cycle = shared.now;
            let read = flash.load(BASE + 0x8000, Width::Word, &mut cycle, &mut shared);
            assert_eq!(read, Some(Ok(stands)));
            // 16 µs at 16 MHz.
            assert_eq!(cycle - shared.now, 256);
            shared.now = cycle;
        }
        assert!(shared.findings.list().is_empty());
    }

    #[test]
    fn sectors_are_erased_in_their_time_and_their_places_are_the_manuals() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.bytes_mut().fill(0);
        flash.write(0x10, SER | 4 << 3 | STRT, !0, &mut shared);
        let due = shared.due(Source::Flash);
        assert_eq!(due, 550 * 16_000);
        assert_eq!(flash.peek(BASE + 0xffff, Width::Byte), Some(0));
        assert_eq!(flash.peek(BASE + 0x1_0000, Width::Word), Some(!0));
        assert_eq!(flash.peek(BASE + 0x1_ffff, Width::Byte), Some(0xff));
        assert_eq!(flash.peek(BASE + 0x2_0000, Width::Byte), Some(0));
        shared.now = due;
        flash.event(Source::Flash, &mut shared);
        assert_eq!(flash.read(0x0c, &mut shared) & BSY, 0);
    }

    #[test]
    fn what_the_manual_forbids_is_found_and_changes_nothing() {
        let mut shared = shared();
        let mut flash = Flash::default();
        let mut cycle = 0;
        flash.program(BASE, Width::Word, 0, &mut cycle, &mut shared);
        flash.write(0x10, PG, !0, &mut shared);
        flash.write(0x04, 1, !0, &mut shared);
        for key in [0x4567_0123, 0xcdef_89ab] {
            flash.write(0x04, key, !0, &mut shared);
        }
        assert_eq!(flash.read(0x10, &mut shared), LOCK);
        assert_eq!(flash.peek(BASE, Width::Word), Some(!0));
        assert!(shared.findings.list().len() >= 3);
    }

    #[test]
    fn a_power_cut_leaves_some_bits_of_a_word_and_some_bytes_of_a_sector() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.write(0x10, PG | 2 << 8, !0, &mut shared);
        let mut torn = 0;
        for k in 0..32 {
            flash.cr = PG | 2 << 8;
            let mut cycle = 0;
            flash.program(BASE + 4 * k, Width::Word, 0, &mut cycle, &mut shared);
            flash.reset();
            let word = flash.peek(BASE + 4 * k, Width::Word);
            torn += u32::from(word != Some(0) && word != Some(!0));
        }
        assert!(torn > 25, "{torn}");
    }
}
