//! The core's side of `crates/virtual-board/oracle/stretches.py`: executes stretches of an image, `stretches
//! IMAGE`.
//!
//! First the whole flash. A request on standard input, words little-endian: the number of ranges of
//! code, and of each begin and end; once. Then batches: the bytes of both memories, the number of
//! stretches, and of each the address at which it begins, the most instructions, and its [`WORDS`]
//! words. The answer: for each stretch how many instructions it has, how many of these an IT block
//! skipped, the program counter and the words behind the last; then both memories, and a bit for every
//! two bytes of flash, set where an instruction was executed.
//!
//! A stretch ends before an instruction that faults, calls the supervisor, waits, lies outside the code,
//! is an exclusive store without a load of the same address, or sets bits of BASEPRI that are not there,
//! and never within an IT block.

mod flat;

use flat::Flat;
use flat::peer::{FLASH, MOST, WORDS, prepare, restart, set_state, state, word, words};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;
use virtual_board::core::{Core, Stop};
use virtual_board::image::Image;

/// Where in the flash the core's own code is: behind any image.
const OWN: usize = 0xf_f000;

struct Stretches {
    core: Core,
    flat: Flat,
    /// Whether a halfword of the flash belongs to code, and whether it was executed.
    code: Vec<bool>,
    executed: Vec<bool>,
}

/// What an instruction means to a stretch.
#[derive(PartialEq, Eq)]
enum Sort {
    Plain,
    /// Of which address.
    LoadExclusive(u32),
    StoreExclusive(u32),
    Ends,
}

/// ITSTATE, from EPSR.
fn it_state(xpsr: u32) -> u32 {
    xpsr >> 8 & 0xfc | xpsr >> 25 & 3
}

/// Whether the condition of an IT block fails (A7.3.1).
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
            // Breakpoints, supervisor calls, YIELD, WFE, WFI, SEV.
            0xbe00..=0xbeff | 0xdf00..=0xdfff | 0xbf10 | 0xbf20 | 0xbf30 | 0xbf40 => Sort::Ends,
            // BASEPRI and BASEPRI_MAX have 4 bits in an STM32F405 (PM0214, 2.1.3), 8 in Unicorn.
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

    /// Executes up to `most` instructions; gives how many can be compared and how many of these were
    /// skipped, and whether that is all that was done.
    fn attempt(&mut self, begin: u32, most: u32, words: &[u32]) -> ([u32; 2], bool) {
        // Masks and the exclusive monitor as after a reset.
        restart(&mut self.core, &mut self.flat);
        set_state(&mut self.core, words);
        self.core.set_register(15, begin);
        let (mut good, mut skipped, mut loaded) = ([0; 2], 0, None);
        for count in 1..=most {
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
            let until = self.core.cycles() + MOST;
            let stop = self.core.step(&mut self.flat, until);
            if stop != Stop::Step || self.core.exception() != 0 {
                return (good, false);
            }
            self.executed[(pc - FLASH) as usize / 2] = true;
            if it_state(self.core.xpsr()) == 0 {
                good = [count, skipped];
            }
        }
        (good, good[0] == most)
    }

    /// The same, and leaves nothing behind of what cannot be compared.
    fn stretch(&mut self, begin: u32, most: u32, words: &[u32]) -> [u32; 2] {
        let before = (self.flat.sram.clone(), self.flat.ccm.clone());
        let (mut good, mut exact) = self.attempt(begin, most, words);
        while !exact {
            (self.flat.sram, self.flat.ccm) = before.clone();
            (good, exact) = self.attempt(begin, good[0], words);
        }
        good
    }

    fn batch(&mut self, input: &mut impl Read, output: &mut impl Write) -> io::Result<()> {
        for _ in 0..word(input)? {
            let (begin, most) = (word(input)?, word(input)?);
            let words = words(input, WORDS)?;
            let good = self.stretch(begin, most, &words);
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
