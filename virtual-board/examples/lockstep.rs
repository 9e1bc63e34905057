//! The core's side of `virtual-board/oracle/lockstep.py`: executes what it is handed and tells what
//! came out.
//!
//! First the 4096 bytes of flash that it needs for itself. A request on standard input, words little-endian: the address of the code, its bytes and the
//! code; bytes of data and the data, which go to [`DATA`] before each case; the address at which a
//! case ends, or 0 for one instruction; the number of cases, and for each its [`WORDS`] words: r0 to
//! r14, APSR, FPSCR, s0 to s31. The answer for each case: a word that is 0 if it came to its end,
//! instructions executed, the program counter, the words, the data.

mod flat;

use flat::Flat;
use std::io::{self, BufReader, BufWriter, Read, Write};
use virtual_board::core::{Core, Stop};

const FLASH: u32 = 0x0800_0000;
/// Where data go.
const DATA: u32 = 0x2000_4000;
/// Words of a case.
const WORDS: usize = 49;
/// No case executes more cycles.
const MOST: u64 = 1_000_000;

/// Switches the floating-point unit on and makes its context active.
const SETUP: [u16; 6] = [
    0x4802, // ldr r0, [pc, #8]
    0x4903, // ldr r1, [pc, #12]
    0x6001, // str r1, [r0]
    0xeeb0, 0x0a40, // vmov.f32 s0, s0
    0xbe00, // bkpt
];

/// Where [`SETUP`] and what every exception comes to are.
const SETUP_AT: usize = 0x400;
const HANDLER_AT: usize = 0x500;

fn prepare(flat: &mut Flat) -> Core {
    // Wherever a branch goes, there is an instruction.
    flat.flash
        .iter_mut()
        .zip([0x00, 0xbf].into_iter().cycle())
        .for_each(|(place, byte)| *place = byte);
    let mut vectors = vec![0x2000_8000u32, FLASH + SETUP_AT as u32 + 1];
    vectors.resize(100, FLASH + HANDLER_AT as u32 + 1);
    let bytes: Vec<u8> = vectors.iter().flat_map(|w| w.to_le_bytes()).collect();
    flat.program(0, &bytes);
    let setup: Vec<u8> = SETUP.iter().flat_map(|h| h.to_le_bytes()).collect();
    flat.program(SETUP_AT, &setup);
    flat.program(SETUP_AT + 12, &0xe000_ed88u32.to_le_bytes());
    flat.program(SETUP_AT + 16, &0x00f0_0000u32.to_le_bytes());
    flat.program(HANDLER_AT, &0xbe00u16.to_le_bytes());
    let mut core = Core::new();
    core.attach_debugger(true);
    restart(&mut core, flat);
    core
}

fn restart(core: &mut Core, flat: &mut Flat) {
    core.reset(flat);
    let until = core.cycles() + MOST;
    let stop = core.run(flat, until);
    assert!(matches!(stop, Stop::Breakpoint(_)), "{stop:?}");
}

/// Sets registers, executes, and gives whether it came to the end.
fn execute(core: &mut Core, flat: &mut Flat, words: &[u32], (begin, end): (u32, u32)) -> bool {
    for (number, &word) in words[..15].iter().enumerate() {
        core.set_register(number, word);
    }
    core.set_xpsr(words[15] | 1 << 24);
    core.set_fpscr(words[16]);
    for (number, &word) in words[17..].iter().enumerate() {
        core.set_single(number, word);
    }
    core.set_register(15, begin);
    let until = core.cycles() + MOST;
    if end == 0 {
        let stop = core.step(flat, until);
        return stop == Stop::Step && core.exception() == 0;
    }
    core.add_breakpoint(end);
    let stop = core.run(flat, until);
    core.remove_breakpoint(end);
    stop == Stop::Breakpoint(end) && core.exception() == 0
}

fn word(input: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    input.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

fn bytes(input: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; word(input)? as usize];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn serve(input: &mut impl Read, output: &mut impl Write) -> io::Result<()> {
    let mut flat = Flat::default();
    let mut core = prepare(&mut flat);
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
            let words = (0..WORDS)
                .map(|_| word(input))
                .collect::<io::Result<Vec<_>>>()?;
            let place = (DATA & 0xff_ffff) as usize;
            flat.sram[place..place + data.len()].copy_from_slice(&data);
            let before = core.instructions();
            let ended = execute(&mut core, &mut flat, &words, (begin, end));
            let count = (core.instructions() - before) as u32;
            let mut answer = vec![u32::from(!ended), count, core.pc()];
            answer.extend((0..15).map(|number| core.register(number)));
            answer.extend([core.xpsr() & 0xf80f_0000, core.fpscr()]);
            answer.extend((0..32).map(|number| core.single(number)));
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
