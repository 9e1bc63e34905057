//! The flash: bytes, wait states, erasing and programming.
//!
//! Source: reference manual RM0090, chapter 3; times are the typical values of the data sheet. Erasing sets bits,
//! programming clears them. While an operation runs, the core stalls at its next fetch or load from the flash, cached
//! or not. A reset during an operation leaves unreliable content: some of the bits to be programmed are zero; each byte
//! of an interrupted erase is old, erased, partly erased or random.
//!
//! An instruction cache that is not reset after an erase has no effect here; a data cache returns the old bytes. The
//! option bytes are those of a new chip, except the brown-out level, which comes from
//! [`ChipVariation`](super::ChipVariation).
//!
//! Not modelled: 64-bit programming, mass erase, writing the option bytes, the one-time programmable area, the boot
//! loader.

mod accelerator;
mod layout;
mod write;

use super::Peripheral;
use super::chip_variation::Random;
use super::interrupt::Interrupt;
use super::map::Unit;
use super::register::{Register, merge, narrow, word};
use super::shared::Shared;
use crate::core::{Transfer, Width};
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER, Time};
use accelerator::Accelerator;
use layout::{BASE, LENGTH, PROGRAM, Parallelism, SECTORS};

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "ACR", 0x1f07), word(0x04, "KEYR", !0), word(0x08, "OPTKEYR", !0), narrow(0x0c, "SR", 0x0001_00f3),
    narrow(0x10, "CR", 0x8301_037f), narrow(0x14, "OPTCR", 0x0fff_ffef),
];

// Bits of SR.
bits! {
    EOP 0, OPERR 1, PGPERR 6, PGSERR 7, BSY 16
}
/// Flags of SR that are cleared by writing one, with those of protection and alignment errors, which never occur here.
const CLEARED_BY_ONE: u32 = EOP | OPERR | 0xf0;
// Bits of CR.
bits! {
    PG 0, SER 1, MER 2, STRT 16, EOPIE 24, ERRIE 25, LOCK 31
}
// Bits of ACR.
bits! {
    PRFTEN 8, ICEN 9, DCEN 10, ICRST 11, DCRST 12
}

/// OPTCR of a new chip: no protection, software watchdog, and locked.
const OPTCR: u32 = 0x0fff_aaed;

/// Lowest core clock for programming and erasing, Hz.
const SLOWEST_HZ: u64 = 1_000_000;

/// Operation in progress; takes effect at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operation {
    /// Programs at the offset `place` of the main memory; `clears` are the bits that become zero.
    Program {
        place: usize,
        width: Width,
        clears: u32,
    },
    /// Erases from the first to the last byte.
    Erase { first: usize, last: usize },
}

/// Operation that the program has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashOperation {
    /// Start time of the operation.
    pub at: Time,
    /// Duration of the operation, without interruption.
    pub takes: Time,
    /// True for an erase, false for programming.
    pub erases: bool,
}

/// Progress of the unlock sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Keys {
    #[default]
    None,
    First,
    /// A wrong key was written: locked until the next reset.
    Broken,
}

/// The flash and its interface.
#[derive(Clone)]
pub(crate) struct Flash {
    bytes: Vec<u8>,
    accelerator: Accelerator,
    acr: u32,
    sr: u32,
    cr: u32,
    keys: Keys,
    operation: Option<Operation>,
    busy_until: Time,
    changed: Option<(u32, u32)>,
    begun: Vec<FlashOperation>,
    /// Number of operations interrupted by a reset or a power cut; varies the random content.
    cuts: u64,
}

impl Default for Flash {
    fn default() -> Self {
        Self {
            bytes: vec![0xff; LENGTH],
            accelerator: Accelerator::new(),
            acr: 0,
            sr: 0,
            cr: LOCK,
            keys: Keys::None,
            operation: None,
            busy_until: Time(0),
            changed: None,
            begun: Vec::new(),
            cuts: 0,
        }
    }
}

impl Flash {
    /// Resets the interface. The content stays, except that of an operation in progress.
    pub fn reset(&mut self, shared: &mut Shared) {
        if let Some(operation) = self.operation.take() {
            self.tear(operation, shared);
        }
        self.accelerator = Accelerator::new();
        (self.acr, self.sr, self.cr) = (0, 0, LOCK);
        self.keys = Keys::None;
        self.change(0, LENGTH - 1);
    }

    /// Operations that the program has begun so far.
    pub fn begun(&self) -> &[FlashOperation] {
        &self.begun
    }

    pub fn bytes_mut(&mut self) -> &mut Vec<u8> {
        self.change(0, LENGTH - 1);
        &mut self.bytes
    }

    pub fn wait_states(&self) -> u64 {
        self.accelerator.wait_states
    }

    /// True if the next line is prefetched.
    pub fn prefetches(&self) -> bool {
        self.acr & PRFTEN != 0
    }

    /// Applies an interrupted operation: a random part of the bits or bytes is changed.
    fn tear(&mut self, operation: Operation, shared: &Shared) {
        self.cuts += 1;
        let mut random = Random::new(shared.variation.seed ^ self.cuts << 32);
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
        }
    }

    /// Value at an address of the flash or of its alias at 0; `None` elsewhere. For decoding and debugging: takes no
    /// time and bypasses the cache.
    pub fn peek(&self, address: u32, width: Width) -> Option<u32> {
        let at = layout::main(address)?;
        Some(super::bus::get(&self.bytes, at, width))
    }

    /// Value of a load by the program; `None` if the address is elsewhere. Advances `cycle` by the time of the access.
    #[inline]
    pub fn load(&mut self, at: Transfer, cycle: &mut Cycles, shared: &mut Shared) -> Option<u32> {
        let place = layout::main(at.address)?;
        if self.operation.is_some() {
            self.stall(cycle, shared);
        }
        let line = place / 16;
        let bytes = &self.bytes[16 * line..16 * line + 16];
        let loaded = self.accelerator.load(line as u32, bytes, cycle);
        Some(super::bus::get(loaded, place % 16, at.width))
    }

    /// Stalls the core until the operation has ended.
    #[cold]
    fn stall(&mut self, cycle: &mut Cycles, shared: &mut Shared) {
        *cycle = (*cycle).max(shared.base.cycle_of(self.busy_until));
        self.finish(shared);
    }

    /// Completes the operation.
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
        }
        self.sr &= !BSY;
        if self.cr & EOPIE != 0 {
            self.sr |= EOP;
        }
        shared.schedule(Unit::Flash, NEVER);
        self.line(shared);
    }

    fn clear(&mut self, place: usize, width: Width, bits: u32) {
        let value = super::bus::get(&self.bytes, place, width) & !bits;
        super::bus::put(&mut self.bytes, place, width, value);
        self.change(place, place + width.bytes() as usize - 1);
    }

    fn line(&self, shared: &mut Shared) {
        let end = self.sr & EOP != 0 && self.cr & EOPIE != 0;
        let error = self.sr & OPERR != 0 && self.cr & ERRIE != 0;
        shared.line(Interrupt::Flash, end || error);
    }

    /// Rejects an operation: sets `flag` of SR and records a finding.
    fn refuse(&mut self, flag: u32, text: String, shared: &mut Shared) {
        self.sr |= flag;
        if self.cr & ERRIE != 0 {
            self.sr |= OPERR;
        }
        shared.note(FindingKind::Forbidden, text);
        self.line(shared);
    }

    fn begin(&mut self, operation: Operation, takes: Time, shared: &mut Shared) {
        if shared.clocks.hclk_hz < SLOWEST_HZ {
            let text = "flash operation with a core clock below 1 MHz";
            shared.note(FindingKind::ClockLimit, text);
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
        shared.schedule(Unit::Flash, cycle);
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

    /// Records a finding if the supply is too low for the selected parallelism. The operation continues, because the
    /// chip does not check the supply.
    fn check_supply(&self, shared: &mut Shared) {
        let parallelism = self.parallelism();
        if !parallelism.is_allowed(shared.volts) {
            let (bits, volts) = (8 << parallelism.0, shared.volts);
            let text = format!("flash operation of {bits} bits at a supply of {volts:.2} V");
            shared.note(FindingKind::Forbidden, text);
        }
    }

    /// Stores to an address of the flash; false if the address is elsewhere.
    pub fn program(
        &mut self,
        at: Transfer,
        value: u32,
        cycle: &mut Cycles,
        shared: &mut Shared,
    ) -> bool {
        let Transfer { address, width, .. } = at;
        let Some(place) = layout::main(address) else {
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
            let text = "flash written in a width other than PSIZE".to_owned();
            self.refuse(PGPERR, text, shared);
        } else {
            self.check_supply(shared);
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
            let text = format!("flash sector {number} erased: must be less than {SECTORS}");
            return self.refuse(PGSERR, text, shared);
        };
        self.check_supply(shared);
        let takes = self.parallelism().sector(number);
        self.begin(Operation::Erase { first, last }, takes, shared);
    }

    /// Fetches from a line of 16 bytes that the program enters.
    #[inline]
    pub fn enter_line(&mut self, address: u32, cycle: &mut Cycles, shared: &mut Shared) {
        if let Some(at) = layout::main(address) {
            if self.operation.is_some() {
                self.stall(cycle, shared);
            }
            self.accelerator.enter(at as u32 / 16, cycle);
        }
    }

    /// First and last address of the bytes changed since the last call; `None` without a change.
    #[inline]
    pub fn take_changed(&mut self) -> Option<(u32, u32)> {
        self.changed.take()
    }
}

impl Peripheral for Flash {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.acr,
            0x0c => self.sr,
            0x10 => self.cr,
            0x14 => OPTCR & !0xc | shared.variation.brown_out << 2,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => self.write_acr(merge(self.acr, value, mask), shared),
            0x04 => {
                if self.key(value, shared) {
                    self.cr &= !LOCK;
                }
            }
            0x0c => {
                self.sr &= !(value & CLEARED_BY_ONE);
                self.line(shared);
            }
            0x10 => self.write_cr(merge(self.cr, value, mask), shared),
            _ => shared.note(
                FindingKind::NotModelled,
                "FLASH: the program writes option bytes",
            ),
        }
    }

    fn event(&mut self, shared: &mut Shared) {
        self.finish(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        if self.operation.is_some() {
            self.plan(shared);
        }
    }
}

#[cfg(test)]
mod tests;
