//! The core's side of `crates/virtual-board/oracle/lockstep.py`: executes requested cases and reports the results.
//!
//! The program first sends the first 4096 bytes of its flash, which contain its own vectors and code. A request on
//! standard input, in little-endian words: address of the code, its length in bytes, and the code; length of the data
//! in bytes, and the data, which are stored at [`DATA`] before each case; address at which a case ends, or 0 for one
//! instruction; number of cases; and for each case its [`WORDS`] words: r0 to r14, APSR, FPSCR, s0 to s31. The answer
//! for each case: 0 if the case reached its end, number of executed instructions, program counter, the words, the data.

mod flat;

use flat::Flat;
use flat::peer::{FLASH, MAX_CYCLES, WORDS, prepare, restart, set_state, state, word, words};
use std::io::{self, BufReader, BufWriter, Read, Write};
use virtual_board::core::{Core, Stop};

/// Address of the data.
const DATA: u32 = 0x2000_4000;
/// Offset in the flash of the code that prepares the core.
const OWN: usize = 0x400;

/// Sets registers and executes a case; true if the case reached its end.
fn execute(core: &mut Core, flat: &mut Flat, words: &[u32], (begin, end): (u32, u32)) -> bool {
    set_state(core, words);
    core.set_register(15, begin);
    let until = core.cycles() + MAX_CYCLES;
    if end == 0 {
        let stop = core.step(flat, until);
        return stop == Stop::Step && core.exception() == 0;
    }
    core.add_breakpoint(end);
    let stop = core.run(flat, until);
    core.remove_breakpoint(end);
    stop == Stop::Breakpoint(end) && core.exception() == 0
}

fn bytes(input: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; word(input)? as usize];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn serve(input: &mut impl Read, output: &mut impl Write) -> io::Result<()> {
    let mut flat = Flat::default();
    // NOPs fill the flash, so that every branch target has an instruction.
    flat.flash
        .iter_mut()
        .zip([0x00, 0xbf].into_iter().cycle())
        .for_each(|(place, byte)| *place = byte);
    let mut core = prepare(&mut flat, OWN);
    output.write_all(&flat.flash[..0x1000])?;
    output.flush()?;
    loop {
        let begin = match word(input) {
            Ok(begin) => begin,
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            Err(error) => return Err(error),
        };
        let code = bytes(input)?;
        flat.program((begin - FLASH) as usize, &code);
        let data = bytes(input)?;
        let (end, cases) = (word(input)?, word(input)?);
        for _ in 0..cases {
            let words = words(input, WORDS)?;
            let place = (DATA & 0xff_ffff) as usize;
            flat.sram[place..place + data.len()].copy_from_slice(&data);
            let before = core.instructions();
            let ended = execute(&mut core, &mut flat, &words, (begin, end));
            let count = (core.instructions() - before) as u32;
            let mut answer = vec![u32::from(!ended), count];
            answer.extend(state(&core));
            for word in answer {
                output.write_all(&word.to_le_bytes())?;
            }
            output.write_all(&flat.sram[place..place + data.len()])?;
            if !ended {
                restart(&mut core, &mut flat);
            }
        }
        output.flush()?;
    }
}

fn main() -> io::Result<()> {
    serve(
        &mut BufReader::new(io::stdin().lock()),
        &mut BufWriter::new(io::stdout().lock()),
    )
}
