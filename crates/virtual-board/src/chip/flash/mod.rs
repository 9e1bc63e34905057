//! The flash: bytes, wait states, erasing and programming, option bytes.
//!
//! Source: reference manual RM0090, chapter 3; times are typical ones of the data sheet. Erasing sets
//! bits, programming clears them. While an operation runs, the core waits at its next fetch or load
//! from the flash, cached or not. A reset during an operation leaves contents that nobody can rely on:
//! bits of the word programmed at random, bytes of the sector old, erased or something between.
//!
//! The manual gives no time for writing the option bytes; the one used is that of erasing the smallest
//! sector. An instruction cache that is not reset after an erase does no harm here, a data cache gives
//! the old bytes.
//!
//! Not modelled: programming of 64 bits, the boot loader, what read protection keeps from a debugger.

mod accelerator;
mod layout;
mod options;

use super::Peripheral;
use super::interrupt::Interrupt;
use super::part::Random;
use super::register::{Register, merge, narrow, word};
use super::shared::{Shared, Source};
use crate::core::{Transfer, Width};
use crate::finding::Kind;
use crate::time::{Cycles, NEVER, Time, Timebase};
use accelerator::Accelerator;
use layout::{BASE, LENGTH, ONCE_LENGTH, ONCE_LOCKS, PROGRAM, Parallelism, Place, SECTORS};
use options::{OPTLOCK, OPTSTRT, Options, Protection};

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "ACR", 0x1f07), word(0x04, "KEYR", !0), word(0x08, "OPTKEYR", !0), narrow(0x0c, "SR", 0x0001_00f3),
    narrow(0x10, "CR", 0x8301_037f), narrow(0x14, "OPTCR", 0x0fff_ffef),
];

// Bits of SR.
const EOP: u32 = 1;
const OPERR: u32 = 1 << 1;
const WRPERR: u32 = 1 << 4;
const PGAERR: u32 = 1 << 5;
const PGPERR: u32 = 1 << 6;
const PGSERR: u32 = 1 << 7;
const BSY: u32 = 1 << 16;
const CLEARED_BY_ONE: u32 = EOP | OPERR | WRPERR | PGAERR | PGPERR | PGSERR;
// Bits of CR.
const PG: u32 = 1;
const SER: u32 = 1 << 1;
const MER: u32 = 1 << 2;
const STRT: u32 = 1 << 16;
const EOPIE: u32 = 1 << 24;
const ERRIE: u32 = 1 << 25;
const LOCK: u32 = 1 << 31;
// Bits of ACR.
const PRFTEN: u32 = 1 << 8;
const ICEN: u32 = 1 << 9;
const DCEN: u32 = 1 << 10;
const ICRST: u32 = 1 << 11;
const DCRST: u32 = 1 << 12;

/// The slowest clock of the core for programming and erasing, Hz.
const SLOWEST_HZ: u64 = 1_000_000;

/// What is being done, and takes effect at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operation {
    /// A place and a value, and the bits of it that are being cleared.
    Program {
        place: Place,
        width: Width,
        clears: u32,
    },
    /// First and last byte.
    Erase { first: usize, last: usize },
    /// What is to stand in the option bytes.
    Options(u32),
}

/// An operation that the program has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashOperation {
    /// When it began.
    pub at: Time,
    /// How long it takes.
    pub takes: Time,
    /// Whether it erases.
    pub erases: bool,
}

/// Keys given so far to a lock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Keys {
    #[default]
    None,
    First,
    /// A wrong one: no key opens it until a reset.
    Broken,
}

/// The flash and its interface.
pub(crate) struct Flash {
    bytes: Vec<u8>,
    /// The area that is programmed once.
    once: Vec<u8>,
    accelerator: Accelerator,
    acr: u32,
    sr: u32,
    cr: u32,
    optcr: u32,
    options: Options,
    /// Of KEYR and OPTKEYR.
    keys: [Keys; 2],
    operation: Option<Operation>,
    busy_until: Time,
    changed: Option<(u32, u32)>,
    /// All operations so far.
    begun: Vec<FlashOperation>,
    /// Operations that a reset cut short.
    cuts: u64,
}

impl Default for Flash {
    fn default() -> Self {
        let options = Options::default();
        Self {
            bytes: vec![0xff; LENGTH],
            once: vec![0xff; ONCE_LENGTH],
            accelerator: Accelerator::new(),
            acr: 0,
            sr: 0,
            cr: LOCK,
            optcr: options.register(),
            options,
            keys: [Keys::None; 2],
            operation: None,
            busy_until: Time(0),
            changed: None,
            begun: Vec::new(),
            cuts: 0,
        }
    }
}

impl Flash {
    /// The interface after a reset, at which the power came on or not. The bytes stay, but for an
    /// operation that was under way.
    pub fn reset(&mut self, power: bool, shared: &mut Shared) {
        if let Some(operation) = self.operation.take() {
            self.tear(operation, shared);
        }
        if power {
            self.options.load();
        }
        self.accelerator = Accelerator::new();
        (self.acr, self.sr, self.cr) = (0, 0, LOCK);
        self.optcr = self.options.register();
        self.keys = [Keys::None; 2];
        self.change(0, LENGTH - 1);
    }

    /// The power has failed: what counts from the next power-on does so now.
    pub fn power_failed(&mut self) {
        self.options.load();
    }

    /// Brown-out level in force, by the option bytes: 3 is off.
    pub fn brown_out(&self) -> u32 {
        self.options.brown_out()
    }

    /// Whether the option bytes have the watchdog start by itself.
    pub fn starts_watchdog(&self) -> bool {
        self.options.starts_watchdog()
    }

    /// Sets the brown-out level in the option bytes.
    pub fn set_brown_out(&mut self, level: u32) {
        let register = self.options.register();
        self.options.write(register & !(3 << 2) | (level & 3) << 2);
    }

    /// The operations that the program has begun so far.
    pub fn begun(&self) -> &[FlashOperation] {
        &self.begun
    }

    /// Its bytes.
    pub fn bytes_mut(&mut self) -> &mut Vec<u8> {
        self.change(0, LENGTH - 1);
        &mut self.bytes
    }

    /// Wait states that the program has set.
    pub fn wait_states(&self) -> u64 {
        self.accelerator.wait_states
    }

    /// Whether lines are fetched ahead.
    pub fn prefetches(&self) -> bool {
        self.acr & PRFTEN != 0
    }

    /// What an operation leaves that was cut short.
    fn tear(&mut self, operation: Operation, shared: &Shared) {
        self.cuts += 1;
        let mut random = Random::new(shared.part.seed ^ self.cuts << 32);
        match operation {
            Operation::Program {
                place,
                width,
                clears,
            } => self.clear(place, width, clears & random.next() as u32),
            Operation::Erase { first, last } => {
                for byte in &mut self.bytes[first..=last] {
                    let drawn = random.next();
                    let noise = (drawn >> 8) as u8;
                    match drawn & 3 {
                        0 => {}
                        1 => *byte |= noise,
                        2 => *byte = noise,
                        _ => *byte = 0xff,
                    }
                }
                self.change(first, last);
            }
            Operation::Options(_) => self.options.tear(),
        }
    }

    /// What stands at an address of the flash or its alias at 0; none elsewhere. For decoding and for
    /// a debugger: takes no time and knows no cache.
    pub fn peek(&self, address: u32, width: Width) -> Option<u32> {
        Some(match Place::of(address)? {
            Place::Main(at) => super::bus::get(&self.bytes, at, width),
            Place::Once(at) => super::bus::get(&self.once, at, width),
            Place::System => super::bus::get(&[0xff; 4], 0, width),
            Place::Options(at) => {
                let bytes: [u8; 4] = std::array::from_fn(|k| self.options.byte(at + k as u32));
                super::bus::get(&bytes, 0, width)
            }
        })
    }

    /// The same as a load by the program, with what it takes.
    #[inline]
    pub fn load(&mut self, at: Transfer, cycle: &mut Cycles, shared: &mut Shared) -> Option<u32> {
        if self.operation.is_some() && Place::of(at.address).is_some() {
            self.stall(cycle, shared);
        }
        let Some(place) = layout::main(at.address) else {
            return self.load_elsewhere(at, cycle, shared);
        };
        let line = place / 16;
        let bytes = &self.bytes[16 * line..16 * line + 16];
        let seen = self.accelerator.load(line as u32, bytes, cycle);
        Some(super::bus::get(seen, place % 16, at.width))
    }

    #[cold]
    fn load_elsewhere(&self, at: Transfer, cycle: &mut Cycles, shared: &mut Shared) -> Option<u32> {
        let value = self.peek(at.address, at.width)?;
        if Place::of(at.address) == Some(Place::System) {
            shared.note(Kind::NotModelled, "the boot loader's memory");
        }
        *cycle += self.accelerator.wait_states;
        Some(value)
    }

    /// The core waits until the operation has ended.
    #[cold]
    fn stall(&mut self, cycle: &mut Cycles, shared: &mut Shared) {
        *cycle = (*cycle).max(shared.base.cycle_of(self.busy_until));
        self.finish(shared);
    }

    /// The operation has ended.
    fn finish(&mut self, shared: &mut Shared) {
        let Some(operation) = self.operation.take() else {
            return;
        };
        match operation {
            Operation::Program {
                place,
                width,
                clears,
            } => self.clear(place, width, clears),
            Operation::Erase { first, last } => {
                self.bytes[first..=last].fill(0xff);
                self.change(first, last);
            }
            Operation::Options(register) => {
                if self.options.unprotects(register) {
                    self.bytes.fill(0xff);
                    self.change(0, LENGTH - 1);
                }
                self.options.write(register);
            }
        }
        self.sr &= !BSY;
        if self.cr & EOPIE != 0 {
            self.sr |= EOP;
        }
        shared.schedule(Source::Flash, NEVER);
        self.line(shared);
    }

    /// Clears bits.
    fn clear(&mut self, place: Place, width: Width, bits: u32) {
        let (bytes, at) = match place {
            Place::Main(at) => (&mut self.bytes, at),
            Place::Once(at) => (&mut self.once, at),
            Place::System | Place::Options(_) => return,
        };
        let value = super::bus::get(bytes, at, width) & !bits;
        super::bus::put(bytes, at, width, value);
        if let Place::Main(at) = place {
            self.change(at, at + width.bytes() as usize - 1);
        }
    }

    fn line(&self, shared: &mut Shared) {
        let end = self.sr & EOP != 0 && self.cr & EOPIE != 0;
        let error = self.sr & OPERR != 0 && self.cr & ERRIE != 0;
        shared.line(Interrupt::Flash, end || error);
    }

    /// An operation is refused.
    fn refuse(&mut self, flag: u32, text: String, shared: &mut Shared) {
        self.sr |= flag;
        if self.cr & ERRIE != 0 {
            self.sr |= OPERR;
        }
        shared.note(Kind::Forbidden, text);
        self.line(shared);
    }

    fn begin(&mut self, operation: Operation, takes: Time, shared: &mut Shared) {
        if shared.clocks.hclk_hz < SLOWEST_HZ {
            let text = "flash operation with a core's clock below 1 MHz";
            shared.note(Kind::ClockLimit, text);
        }
        self.begun.push(FlashOperation {
            at: shared.time(),
            takes,
            erases: matches!(operation, Operation::Erase { .. }),
        });
        self.sr |= BSY;
        self.operation = Some(operation);
        self.busy_until = shared.time() + takes;
        self.plan(shared);
    }

    fn plan(&self, shared: &mut Shared) {
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

    fn parallelism(&self) -> Parallelism {
        Parallelism(self.cr >> 8 & 3)
    }

    /// Whether the supply suffices for the parallelism that is set; where not, the operation goes on,
    /// as the chip does not know.
    fn judge_supply(&self, shared: &mut Shared) {
        let parallelism = self.parallelism();
        if !parallelism.is_allowed(shared.volts) {
            let (bits, volts) = (8 << parallelism.0, shared.volts);
            let text = format!("flash operation by {bits} bits at a supply of {volts:.2} V");
            shared.note(Kind::Forbidden, text);
        }
    }

    /// Whether the place is written for good.
    fn is_protected(&self, place: Place) -> bool {
        match place {
            Place::Main(at) => self.options.is_protected(layout::sector_of(at)),
            // Each block of 32 bytes has its lock byte behind them; the lock bytes have none.
            Place::Once(at) => {
                let first = ONCE_LENGTH - ONCE_LOCKS;
                at < first && self.once[first + at / 32] == 0
            }
            Place::System | Place::Options(_) => true,
        }
    }

    /// A store to an address of the flash; false elsewhere.
    pub fn program(
        &mut self,
        at: Transfer,
        value: u32,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> bool {
        let Transfer { address, width, .. } = at;
        let Some(place) = Place::of(address) else {
            return false;
        };
        if self.operation.is_some() {
            self.stall(cycle, shared);
            shared.now = *cycle;
        }
        if self.cr & (LOCK | PG) != PG {
            let text = format!("flash written at {address:#010x} without PG");
            self.refuse(PGSERR, text, shared);
        } else if !self.parallelism().is(width) {
            let text = "flash written in another width than PSIZE says".to_owned();
            self.refuse(PGPERR, text, shared);
        } else if self.is_protected(place) {
            let text = format!("flash written at {address:#010x}, which is protected");
            self.refuse(WRPERR, text, shared);
        } else {
            self.judge_supply(shared);
            let before = self.peek(address, width).unwrap_or(0) & width.mask();
            let operation = Operation::Program {
                place,
                width,
                clears: before & !value,
            };
            self.begin(operation, PROGRAM, shared);
        }
        true
    }

    fn erase_sector(&mut self, shared: &mut Shared) {
        let number = self.cr >> 3 & 15;
        let Some((first, last)) = layout::sector(number) else {
            let text = format!("flash sector {number} erased: there are {SECTORS}");
            return self.refuse(PGSERR, text, shared);
        };
        if self.options.is_protected(number) {
            let text = format!("flash sector {number} erased, which is protected");
            return self.refuse(WRPERR, text, shared);
        }
        self.judge_supply(shared);
        let takes = self.parallelism().sector(number);
        self.begin(Operation::Erase { first, last }, takes, shared);
    }

    fn erase_all(&mut self, shared: &mut Shared) {
        if self.options.is_any_protected() {
            let text = "flash erased, of which a sector is protected".to_owned();
            return self.refuse(WRPERR, text, shared);
        }
        self.judge_supply(shared);
        let (first, last) = (0, LENGTH - 1);
        let takes = self.parallelism().all();
        self.begin(Operation::Erase { first, last }, takes, shared);
    }

    /// The program enters a line of 16 bytes.
    #[inline]
    pub fn enter_line(&mut self, address: u32, cycle: &mut Cycles, shared: &mut Shared) {
        if let Some(at) = layout::main(address) {
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

    /// A key; whether the lock is open now.
    fn key(&mut self, which: usize, value: u32, keys: [u32; 2], shared: &mut Shared) -> bool {
        let given = &mut self.keys[which];
        match *given {
            Keys::None if value == keys[0] => *given = Keys::First,
            Keys::First if value == keys[1] => {
                *given = Keys::None;
                return true;
            }
            _ => {
                *given = Keys::Broken;
                shared.bus_error = true;
                let text = "flash: a wrong key, locked until the next reset";
                shared.note(Kind::Forbidden, text);
            }
        }
        false
    }

    /// The bus holds a write to a control register while an operation runs.
    fn wait(&mut self, shared: &mut Shared) {
        if self.operation.is_some() {
            shared.held_until = shared.base.cycle_of(self.busy_until);
            shared.now = shared.now.max(shared.held_until);
            self.finish(shared);
        }
    }

    fn write_cr(&mut self, value: u32, shared: &mut Shared) {
        self.wait(shared);
        if self.cr & LOCK != 0 {
            return shared.note(Kind::Forbidden, "FLASH_CR written while locked");
        }
        self.cr = value & !STRT;
        if value & STRT != 0 {
            match value & (SER | MER) {
                SER => self.erase_sector(shared),
                MER => self.erase_all(shared),
                _ => {
                    let text = "FLASH_CR: STRT without one of SER and MER".to_owned();
                    self.refuse(PGSERR, text, shared);
                }
            }
        }
        self.line(shared);
    }

    fn write_acr(&mut self, mut value: u32, shared: &mut Shared) {
        for (reset, on, name) in [(ICRST, ICEN, "instruction"), (DCRST, DCEN, "data")] {
            if value & reset != 0 && self.acr & on != 0 {
                let text = format!("FLASH_ACR: the {name} cache is reset while it is on");
                shared.note(Kind::Forbidden, text);
                value &= !reset;
            }
        }
        self.acr = value & 0x1f07;
        self.accelerator.set(value);
    }

    fn write_optcr(&mut self, value: u32, shared: &mut Shared) {
        self.wait(shared);
        if self.optcr & OPTLOCK != 0 {
            return shared.note(Kind::Forbidden, "FLASH_OPTCR written while locked");
        }
        if self.options.protection() == Protection::Forever {
            let text = "FLASH_OPTCR written at read protection level 2";
            return shared.note(Kind::Forbidden, text);
        }
        self.optcr = value & !OPTSTRT;
        if value & OPTSTRT != 0 {
            let mut takes = self.parallelism().sector(0);
            if self.options.unprotects(value) {
                takes = takes + self.parallelism().all();
            }
            self.begin(Operation::Options(value), takes, shared);
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
            0x04 => {
                if self.key(0, value, [0x4567_0123, 0xcdef_89ab], shared) {
                    self.cr &= !LOCK;
                }
            }
            0x08 => {
                if self.key(1, value, [0x0819_2a3b, 0x4c5d_6e7f], shared) {
                    self.optcr &= !OPTLOCK;
                }
            }
            0x0c => {
                self.sr &= !(value & CLEARED_BY_ONE);
                self.line(shared);
            }
            0x10 => self.write_cr(merge(self.cr, value, mask), shared),
            _ => self.write_optcr(merge(self.optcr, value, mask), shared),
        }
    }

    fn event(&mut self, _source: Source, shared: &mut Shared) {
        self.finish(shared);
    }

    fn clocks_changed(&mut self, _old: &Timebase, shared: &mut Shared) {
        if self.operation.is_some() {
            self.plan(shared);
        }
    }
}

#[cfg(test)]
mod tests {
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
    fn a_word_is_programmed_by_clearing_bits_and_the_core_waits_for_it() {
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
            // 16 µs at 16 MHz.
            assert_eq!(cycle - shared.now, 256);
            shared.now = cycle;
        }
        assert!(shared.findings.list().is_empty());
    }

    #[test]
    fn sectors_are_erased_in_their_time_and_their_places_are_the_manuals() {
        // Typical times of the data sheet at 32 and 8 bits.
        for (size, millis) in [(2, 550), (0, 1200)] {
            let mut shared = shared();
            let mut flash = unlocked(&mut shared);
            flash.bytes_mut().fill(0);
            flash.write(0x10, SER | 4 << 3 | size << 8 | STRT, !0, &mut shared);
            let due = shared.due(Source::Flash);
            assert_eq!(due, millis * 16_000);
            assert_ne!(flash.read(0x0c, &mut shared) & BSY, 0);
            shared.now = due;
            flash.event(Source::Flash, &mut shared);
            assert_eq!(flash.read(0x0c, &mut shared) & BSY, 0);
            assert_eq!(flash.peek(BASE + 0xffff, Width::Byte), Some(0));
            assert_eq!(flash.peek(BASE + 0x1_0000, Width::Word), Some(!0));
            assert_eq!(flash.peek(BASE + 0x1_ffff, Width::Byte), Some(0xff));
            assert_eq!(flash.peek(BASE + 0x2_0000, Width::Byte), Some(0));
        }
    }

    #[test]
    fn what_the_manual_forbids_is_found_and_changes_nothing() {
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

    /// Errors that a store of this width leaves.
    fn errors_of(flash: &mut Flash, width: Width, shared: &mut Shared) -> u32 {
        flash.write(0x0c, CLEARED_BY_ONE, !0, shared);
        let mut cycle = shared.now;
        flash.program(of(BASE + 0x2_0000, width), 0, &mut cycle, shared);
        flash.read(0x0c, shared) & !BSY
    }

    #[test]
    fn each_error_has_its_flag() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        assert_eq!(errors_of(&mut flash, Width::Word, &mut shared), PGSERR);
        flash.write(0x10, PG | 2 << 8 | ERRIE, !0, &mut shared);
        let found = errors_of(&mut flash, Width::Byte, &mut shared);
        assert_eq!(found, PGPERR | OPERR);
        assert_eq!(shared.lines, 1 << Interrupt::Flash as u32);
        flash.options.write(flash.options.register() & !(1 << 21));
        let found = errors_of(&mut flash, Width::Word, &mut shared);
        assert_eq!(found, WRPERR | OPERR);
        flash.write(0x10, SER | 5 << 3 | STRT, !0, &mut shared);
        assert_eq!(flash.read(0x0c, &mut shared) & (BSY | WRPERR), WRPERR);
        flash.write(0x10, MER | STRT, !0, &mut shared);
        assert_eq!(flash.read(0x0c, &mut shared) & BSY, 0);
        assert_eq!(flash.peek(BASE + 0x2_0000, Width::Word), Some(!0));
    }

    #[test]
    fn the_end_of_an_operation_interrupts_and_a_write_to_cr_waits_for_it() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.write(0x10, PG | 2 << 8 | EOPIE, !0, &mut shared);
        let mut cycle = shared.now;
        flash.program(word(BASE), 0, &mut cycle, &mut shared);
        assert_eq!(shared.lines, 0);
        flash.write(0x10, EOPIE, !0, &mut shared);
        // 16 µs at 16 MHz.
        assert_eq!(shared.held_until, 256);
        assert_eq!(flash.read(0x0c, &mut shared), EOP);
        assert_eq!(shared.lines, 1 << Interrupt::Flash as u32);
        flash.write(0x0c, EOP, !0, &mut shared);
        assert_eq!(shared.lines, 0);
    }

    #[test]
    fn the_supply_and_the_clock_must_suffice() {
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
    fn a_power_cut_leaves_some_bits_of_a_word() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        let mut torn = 0;
        for k in 0..32 {
            flash.cr = PG | 2 << 8;
            let mut cycle = 0;
            flash.program(word(BASE + 4 * k), 0xff, &mut cycle, &mut shared);
            flash.reset(true, &mut shared);
            let word = flash.peek(BASE + 4 * k, Width::Word).unwrap_or(0);
            assert_eq!(word & 0xff, 0xff, "bits that were not to be cleared");
            torn += u32::from(word != 0xff && word != !0);
        }
        assert!(torn > 25, "{torn}");
    }

    #[test]
    fn a_power_cut_leaves_a_sector_that_is_neither_old_nor_erased() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.bytes_mut().fill(0x5a);
        flash.write(0x10, SER | 1 << 3 | 2 << 8 | STRT, !0, &mut shared);
        flash.reset(true, &mut shared);
        let count = |byte: u8| {
            flash.bytes[0x4000..0x8000]
                .iter()
                .filter(|b| **b == byte)
                .count()
        };
        assert!((3000..6000).contains(&count(0x5a)), "{}", count(0x5a));
        assert!((3000..6000).contains(&count(0xff)), "{}", count(0xff));
        assert!(
            flash.bytes[..0x4000]
                .iter()
                .chain(&flash.bytes[0x8000..])
                .all(|b| *b == 0x5a)
        );
    }

    #[test]
    fn option_bytes_are_written_and_a_cut_leaves_them_erased() {
        for cut in [false, true] {
            let mut shared = shared();
            let mut flash = Flash::default();
            flash.write(0x14, 0, !0, &mut shared);
            assert_eq!(shared.findings.list().len(), 1, "locked");
            for key in [0x0819_2a3b, 0x4c5d_6e7f] {
                flash.write(0x08, key, !0, &mut shared);
            }
            let wanted = flash.read(0x14, &mut shared) & !0xc;
            flash.write(0x14, wanted, !0, &mut shared);
            flash.write(0x14, wanted | OPTSTRT, !0, &mut shared);
            assert_ne!(flash.read(0x0c, &mut shared) & BSY, 0);
            if !cut {
                shared.now = shared.due(Source::Flash);
                flash.event(Source::Flash, &mut shared);
                flash.reset(false, &mut shared);
                assert_eq!(flash.brown_out(), 3, "not before the next power-on");
            }
            flash.reset(true, &mut shared);
            let (level, rdp) = if cut { (3, 0xff) } else { (0, 0xaa) };
            assert_eq!(flash.brown_out(), level);
            assert_eq!(flash.read(0x14, &mut shared) >> 8 & 0xff, rdp);
        }
    }

    #[test]
    fn the_area_that_is_programmed_once_is_locked_by_blocks() {
        let mut shared = shared();
        let mut flash = unlocked(&mut shared);
        flash.write(0x10, PG, !0, &mut shared);
        // The lock byte of block 1.
        for (address, value) in [
            (0x1fff_7820, 7),
            (0x1fff_7a01, 0),
            (0x1fff_7820, 0),
            (0x1fff_7840, 3),
        ] {
            let mut cycle = shared.now;
            flash.program(of(address, Width::Byte), value, &mut cycle, &mut shared);
            shared.now = shared.due(Source::Flash).min(shared.now + 1000);
            flash.event(Source::Flash, &mut shared);
        }
        let byte = |address: u32| flash.peek(address, Width::Byte);
        assert_eq!([byte(0x1fff_7820), byte(0x1fff_7840)], [Some(7), Some(3)]);
        assert_eq!(flash.sr & WRPERR, WRPERR);
    }

    #[test]
    fn the_data_cache_gives_old_bytes_after_an_erase_until_it_is_reset() {
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
        // A reset of the cache while it is on is not one.
        flash.write(0x00, DCEN | DCRST | 5, !0, &mut shared);
        assert_eq!(load(&mut flash, &mut shared), Some(0x12));
        assert_eq!(shared.findings.list().len(), 1);
        for acr in [5, DCRST | 5, DCEN | 5] {
            flash.write(0x00, acr, !0, &mut shared);
        }
        assert_eq!(load(&mut flash, &mut shared), Some(0xff));
    }
}
