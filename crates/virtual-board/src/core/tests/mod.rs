//! Tests of the core. Programs are assembled halfwords with their assembly text.

mod debug;
mod exceptions;
mod faults;
mod floating;
mod instructions;
mod memory;
mod sleep;
mod timing;

use super::{BusError, Core, Stop, System, Transfer, Width};
use crate::finding::FindingKind;
use crate::time::Cycles;

/// First address of the program.
const CODE: u32 = 0x0800_0400;
/// Address at which the handler of exception 0 would be; each handler has 64 bytes.
const HANDLERS: u32 = 0x0800_1000;
/// Initial stack pointer, the end of the stack's memory.
const STACK: u32 = 0x2000_2000;
/// Address at which handlers and programs store words.
const LOG: u32 = 0x2000_0000;
/// Maximum number of cycles of a test.
const MAX_CYCLES: Cycles = 100_000;

/// Flash, SRAM and scheduled interrupt lines; records findings and the addresses of entered 16-byte fetch lines.
struct Chip {
    flash: Vec<u8>,
    sram: Vec<u8>,
    /// Start cycle and levels of the interrupt lines, in order of time.
    schedule: Vec<(Cycles, u128)>,
    lines: u128,
    until: Cycles,
    changed: Option<(u32, u32)>,
    notes: Vec<(FindingKind, String)>,
    resets: u32,
    entered: Vec<u32>,
}

impl Chip {
    fn place(&mut self, address: u32, width: Width) -> Result<&mut [u8], BusError> {
        let memory = match address >> 24 {
            0x08 | 0x00 => &mut self.flash,
            0x20 => &mut self.sram,
            _ => return Err(BusError),
        };
        let offset = (address & 0xff_ffff) as usize;
        let bytes = width.bytes() as usize;
        memory.get_mut(offset..offset + bytes).ok_or(BusError)
    }

    fn program(&mut self, address: u32, halves: &[u16]) {
        let place = (address & 0xff_ffff) as usize;
        for (place, half) in self.flash[place..].chunks_exact_mut(2).zip(halves) {
            place.copy_from_slice(&half.to_le_bytes());
        }
        self.changed = Some((address, address + 2 * halves.len() as u32));
    }

    fn set_word(&mut self, address: u32, word: u32) {
        if let Ok(place) = self.place(address, Width::Word) {
            place.copy_from_slice(&word.to_le_bytes());
        }
    }

    fn word(&mut self, address: u32) -> u32 {
        self.place(address, Width::Word).map_or(0, |place| {
            place.iter().rfold(0, |w, &b| w << 8 | u32::from(b))
        })
    }

    /// Words that the program stored, up to the first 0.
    fn log(&mut self) -> Vec<u32> {
        let words = (LOG..).step_by(4).map(|address| self.word(address));
        words.take_while(|&word| word != 0).collect()
    }

    fn found(&self, kind: FindingKind) -> bool {
        self.notes.iter().any(|(k, _)| *k == kind)
    }
}

impl System for Chip {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        let place = self.place(address, Width::Half)?;
        Ok(u16::from_le_bytes([place[0], place[1]]))
    }

    fn enter_line(&mut self, address: u32, _cycle: &mut Cycles) {
        self.entered.push(address);
    }

    fn read(&mut self, at: Transfer, _cycle: &mut Cycles) -> Result<u32, BusError> {
        assert!(at.is_aligned());
        let place = self.place(at.address, at.width)?;
        Ok(place.iter().rfold(0, |w, &b| w << 8 | u32::from(b)))
    }

    fn write(&mut self, at: Transfer, value: u32, _cycle: &mut Cycles) -> Result<(), BusError> {
        assert!(at.is_aligned());
        if at.address >> 24 != 0x20 {
            return Err(BusError);
        }
        let place = self.place(at.address, at.width)?;
        let bytes = value.to_le_bytes();
        place.copy_from_slice(&bytes[..place.len()]);
        Ok(())
    }

    fn limit(&self) -> Cycles {
        self.until
    }

    fn advance(&mut self, cycle: Cycles, until: Cycles) -> Cycles {
        while let Some(&(at, lines)) = self.schedule.first()
            && at <= cycle
        {
            self.lines = lines;
            self.schedule.remove(0);
        }
        let next = self.schedule.first().map_or(until, |&(at, _)| at);
        self.until = until.min(next);
        self.until
    }

    fn lines(&self) -> u128 {
        self.lines
    }

    fn take_changed_code(&mut self) -> Option<(u32, u32)> {
        self.changed.take()
    }

    fn request_reset(&mut self) {
        self.resets += 1;
    }

    fn note(&mut self, kind: FindingKind, _pc: u32, _cycle: Cycles, text: String) {
        self.notes.push((kind, text));
    }
}

/// A core after reset, ready to execute a program. Handlers are breakpoints until replaced.
struct Machine {
    core: Core,
    chip: Chip,
}

impl Machine {
    fn new(program: &[u16]) -> Self {
        let mut chip = Chip {
            flash: vec![0xff; 0x1_0000],
            sram: vec![0; 0x1_0000],
            schedule: Vec::new(),
            lines: 0,
            until: 0,
            changed: None,
            notes: Vec::new(),
            resets: 0,
            entered: Vec::new(),
        };
        chip.set_word(0, STACK);
        chip.set_word(4, CODE | 1);
        for exception in 2..98 {
            chip.set_word(4 * exception, (HANDLERS + 64 * exception) | 1);
            chip.program(HANDLERS + 64 * exception, &[0xbe00]);
        }
        chip.program(CODE, program);
        let mut core = Core::new();
        core.attach_debugger(true);
        core.reset(&mut chip);
        Self { core, chip }
    }

    fn handler(mut self, exception: u32, program: &[u16]) -> Self {
        self.chip.program(HANDLERS + 64 * exception, program);
        self
    }

    fn register(self, number: usize, value: u32) -> Self {
        self.registers(&[(number, value)])
    }

    fn registers(mut self, values: &[(usize, u32)]) -> Self {
        for &(number, value) in values {
            self.core.set_register(number, value);
        }
        self
    }

    fn run(&mut self) -> Stop {
        let until = self.core.cycles() + MAX_CYCLES;
        self.core.run(&mut self.chip, until)
    }

    /// Runs to a breakpoint; returns the active exception.
    fn run_to_breakpoint(&mut self) -> u16 {
        let (stop, pc) = (self.run(), self.core.pc());
        let notes = &self.chip.notes;
        assert_eq!(stop, Stop::Breakpoint(pc), "at {pc:#x}: {notes:?}");
        self.core.exception()
    }

    /// Runs to a breakpoint in an exception and checks registers of private peripherals.
    fn ends_in(&mut self, exception: u16, registers: &[(u32, u32)]) {
        assert_eq!(self.run_to_breakpoint(), exception);
        for &(address, value) in registers {
            assert_eq!(self.private(address), value, "{address:#x}");
        }
    }

    /// Continues from the present breakpoint to the next; returns the active exception.
    fn go_on(&mut self) -> u16 {
        let pc = self.core.pc();
        self.core.set_register(15, pc + 2);
        self.run_to_breakpoint()
    }

    fn r(&self, number: usize) -> u32 {
        self.core.register(number)
    }

    /// Value of a register of the private peripherals, read as the program would.
    fn private(&mut self, address: u32) -> u32 {
        let at = Transfer::word(address, self.core.pc());
        let value = self.core.load(&mut self.chip, at);
        value.unwrap_or(0xdead_beef)
    }

    /// Writes a register of the private peripherals.
    fn set_private(&mut self, address: u32, value: u32) {
        let at = Transfer::word(address, self.core.pc());
        let done = self.core.store(&mut self.chip, at, value);
        assert_eq!(done, Ok(()));
    }
}

const ISER0: u32 = 0xe000_e100;
const ISPR0: u32 = 0xe000_e200;
const IPR0: u32 = 0xe000_e400;
const ICSR: u32 = 0xe000_ed04;
const VTOR: u32 = 0xe000_ed08;
const AIRCR: u32 = 0xe000_ed0c;
const SCR: u32 = 0xe000_ed10;
const CCR: u32 = 0xe000_ed14;
const SHPR3: u32 = 0xe000_ed20;
const SHCSR: u32 = 0xe000_ed24;
const CFSR: u32 = 0xe000_ed28;
const HFSR: u32 = 0xe000_ed2c;
const MMFAR: u32 = 0xe000_ed34;
const BFAR: u32 = 0xe000_ed38;
const CPACR: u32 = 0xe000_ed88;
const FPCCR: u32 = 0xe000_ef34;
const FPCAR: u32 = 0xe000_ef38;
