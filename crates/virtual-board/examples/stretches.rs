//! The core's side of `crates/virtual-board/oracle/stretches.py`: executes stretches of an image, `stretches IMAGE`. A
//! stretch is a sequence of instructions from a given address and state.
//!
//! The program first sends the whole flash. The first request on standard input, in little-endian words, occurs once:
//! number of code ranges, then start and end of each. Then batches follow: the bytes of SRAM and core-coupled memory;
//! number of stretches; and for each stretch its start address, the maximum number of instructions and its [`WORDS`]
//! words. The answer for each stretch: number of instructions, number of instructions that an IT block skipped, program
//! counter and words at the end. After the last stretch the answer ends with both memories, and one bit for each
//! halfword of flash, set if an instruction was executed there.
//!
//! A stretch never ends within an IT block. It ends before an instruction that faults, is a supervisor call, waits, is
//! outside the code, is an exclusive store without a load of the same address, or sets bits of BASEPRI that do not
//! exist.

mod flat;

use flat::Flat;
use flat::peer::{FLASH, MAX_CYCLES, WORDS, prepare, restart, set_state, state, word, words};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;
use virtual_board::core::{Core, Stop};
use virtual_board::image::Image;

/// Offset in the flash of the code that prepares the core, behind any image.
const OWN: usize = 0xf_f000;

struct Stretches {
    core: Core,
    flat: Flat,
    /// Two flags for each halfword of flash: `code` is true in a code range, `executed` if an instruction was executed
    /// there.
    code: Vec<bool>,
    executed: Vec<bool>,
}

/// Class of an instruction for a stretch.
#[derive(PartialEq, Eq)]
enum Sort {
    Plain,
    /// Address of the load.
    LoadExclusive(u32),
    StoreExclusive(u32),
    Ends,
}

/// ITSTATE in EPSR.
fn it_state(xpsr: u32) -> u32 {
    xpsr >> 8 & 0xfc | xpsr >> 25 & 3
}

/// True if the condition of the present IT block fails (A7.3.1).
fn is_skipped(xpsr: u32) -> bool {
    let it = it_state(xpsr);
    let [n, z, c, v] = [31, 30, 29, 28].map(|bit| xpsr >> bit & 1 != 0);
    let holds = match it >> 5 {
        0 => z,
        1 => c,
        2 => n,
        3 => v,
        4 => c && !z,
        5 => n == v,
        6 => n == v && !z,
        _ => return false,
    };
    it & 15 != 0 && holds == (it >> 4 & 1 != 0)
}

impl Stretches {
    fn half(&self, offset: usize) -> u16 {
        u16::from_le_bytes([self.flat.flash[offset], self.flat.flash[offset + 1]])
    }

    fn sort(&self, pc: u32) -> Sort {
        let offset = pc.wrapping_sub(FLASH) as usize;
        if self.code.get(offset / 2) != Some(&true) {
            return Sort::Ends;
        }
        let first = self.half(offset);
        let base = self.core.register(usize::from(first & 15).min(14));
        match first {
            // A stretch ends before a breakpoint, a supervisor call, YIELD, WFE, WFI or SEV.
            0xbe00..=0xbeff | 0xdf00..=0xdfff | 0xbf10 | 0xbf20 | 0xbf30 | 0xbf40 => Sort::Ends,
            // A write of low bits of BASEPRI cannot be compared: Unicorn has 8 bits, an STM32F405 4 (PM0214, 2.1.3).
            0xf380..=0xf38f
                if matches!(self.half(offset + 2) & 0xff, 0x11 | 0x12) && base & 15 != 0 =>
            {
                Sort::Ends
            }
            0xe840..=0xe85f => {
                let address = base.wrapping_add(4 * u32::from(self.half(offset + 2) & 0xff));
                match first & 0x10 {
                    0 => Sort::StoreExclusive(address),
                    _ => Sort::LoadExclusive(address),
                }
            }
            0xe8c0..=0xe8df => match (self.half(offset + 2) >> 4 & 15, first & 0x10) {
                (4 | 5, 0) => Sort::StoreExclusive(base),
                (4 | 5, _) => Sort::LoadExclusive(base),
                _ => Sort::Plain,
            },
            _ => Sort::Plain,
        }
    }

    /// Executes up to `max_instructions` instructions. Returns the number of instructions up to the latest one after
    /// which a stretch may end, how many of them an IT block skipped, and true if none was executed afterwards.
    fn attempt(&mut self, begin: u32, max_instructions: u32, words: &[u32]) -> ([u32; 2], bool) {
        // The restart clears the masks and the exclusive monitor, which a previous stretch may have set.
        restart(&mut self.core, &mut self.flat);
        set_state(&mut self.core, words);
        self.core.set_register(15, begin);
        let (mut good, mut skipped, mut loaded) = ([0; 2], 0, None);
        for count in 1..=max_instructions {
            let pc = self.core.pc();
            skipped += u32::from(is_skipped(self.core.xpsr()));
            match self.sort(pc) {
                Sort::Ends => return (good, good[0] == count - 1),
                Sort::StoreExclusive(address) if loaded != Some(address) => {
                    return (good, good[0] == count - 1);
                }
                Sort::StoreExclusive(_) => loaded = None,
                Sort::LoadExclusive(address) => loaded = Some(address),
                Sort::Plain => {}
            }
            let until = self.core.cycles() + MAX_CYCLES;
            let stop = self.core.step(&mut self.flat, until);
            if stop != Stop::Step || self.core.exception() != 0 {
                return (good, false);
            }
            self.executed[(pc - FLASH) as usize / 2] = true;
            if it_state(self.core.xpsr()) == 0 {
                good = [count, skipped];
            }
        }
        (good, good[0] == max_instructions)
    }

    /// Executes a stretch. If an attempt executes instructions after the last one at which the stretch may end, the
    /// memories are restored and a shorter attempt follows.
    fn stretch(&mut self, begin: u32, max_instructions: u32, words: &[u32]) -> [u32; 2] {
        let before = (self.flat.sram.clone(), self.flat.ccm.clone());
        let (mut good, mut exact) = self.attempt(begin, max_instructions, words);
        while !exact {
            (self.flat.sram, self.flat.ccm) = before.clone();
            (good, exact) = self.attempt(begin, good[0], words);
        }
        good
    }

    fn batch(&mut self, input: &mut impl Read, output: &mut impl Write) -> io::Result<()> {
        for _ in 0..word(input)? {
            let (begin, max_instructions) = (word(input)?, word(input)?);
            let words = words(input, WORDS)?;
            let good = self.stretch(begin, max_instructions, &words);
            for word in good.into_iter().chain(state(&self.core)) {
                output.write_all(&word.to_le_bytes())?;
            }
        }
        output.write_all(&self.flat.sram)?;
        output.write_all(&self.flat.ccm)?;
        let bits = self.executed.chunks(8).map(|chunk| {
            let bits = chunk.iter().enumerate();
            bits.fold(0, |byte, (k, &bit)| byte | u8::from(bit) << k)
        });
        output.write_all(&bits.collect::<Vec<u8>>())?;
        output.flush()
    }
}

fn serve(image: &Image, input: &mut impl Read, output: &mut impl Write) -> io::Result<()> {
    let mut flat = Flat::default();
    image.load(&mut flat.flash);
    let core = prepare(&mut flat, OWN);
    output.write_all(&flat.flash)?;
    output.flush()?;
    let halves = flat.flash.len() / 2;
    let mut stretches = Stretches {
        core,
        flat,
        code: vec![false; halves],
        executed: vec![false; halves],
    };
    for _ in 0..word(input)? {
        let [begin, end] = [word(input)?, word(input)?].map(|a| (a - FLASH) as usize / 2);
        stretches.code[begin..end].fill(true);
    }
    loop {
        match input.read_exact(&mut stretches.flat.sram) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            done => done?,
        }
        input.read_exact(&mut stretches.flat.ccm)?;
        stretches.batch(input, output)?;
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: stretches IMAGE")?;
    let image = Image::open(Path::new(&path))?;
    serve(
        &image,
        &mut BufReader::new(io::stdin().lock()),
        &mut BufWriter::new(io::stdout().lock()),
    )?;
    Ok(())
}
