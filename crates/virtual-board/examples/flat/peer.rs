//! Shared parts of the two programs that are compared with Unicorn: a core prepared for floating-point code, its state
//! as words, and words in a stream.

use super::Flat;
use std::io::{self, Read};
use virtual_board::core::{Core, Stop};

/// Number of words of a state: r0 to r14, APSR, FPSCR, s0 to s31.
pub const WORDS: usize = 49;
/// Maximum number of cycles of a case.
pub const MAX_CYCLES: u64 = 1_000_000;
pub const FLASH: u32 = 0x0800_0000;

/// Enables the floating-point unit and activates its context.
const SETUP: [u16; 6] = [
    0x4802, // ldr r0, [pc, #8]
    0x4903, // ldr r1, [pc, #12]
    0x6001, // str r1, [r0]
    0xeeb0, 0x0a40, // vmov.f32 s0, s0
    0xbe00, // bkpt
];

/// Writes vectors and, at an offset, [`SETUP`] into the flash; every exception leads to a breakpoint behind [`SETUP`].
pub fn prepare(flat: &mut Flat, offset: usize) -> Core {
    let handler = offset + 0x100;
    let mut vectors = vec![0x2000_8000u32, FLASH + offset as u32 + 1];
    vectors.resize(100, FLASH + handler as u32 + 1);
    let bytes: Vec<u8> = vectors.iter().flat_map(|w| w.to_le_bytes()).collect();
    flat.program(0, &bytes);
    let setup: Vec<u8> = SETUP.iter().flat_map(|h| h.to_le_bytes()).collect();
    flat.program(offset, &setup);
    flat.program(offset + 12, &0xe000_ed88u32.to_le_bytes());
    flat.program(offset + 16, &0x00f0_0000u32.to_le_bytes());
    flat.program(handler, &0xbe00u16.to_le_bytes());
    let mut core = Core::new();
    core.attach_debugger(true);
    restart(&mut core, flat);
    core
}

/// Resets the core and executes [`SETUP`].
pub fn restart(core: &mut Core, flat: &mut Flat) {
    core.reset(flat);
    let until = core.cycles() + MAX_CYCLES;
    let stop = core.run(flat, until);
    assert!(matches!(stop, Stop::Breakpoint(_)), "{stop:?}");
}

/// Sets registers and flags.
pub fn set_state(core: &mut Core, words: &[u32]) {
    for (number, &word) in words[..15].iter().enumerate() {
        core.set_register(number, word);
    }
    core.set_xpsr(words[15] | 1 << 24);
    core.set_fpscr(words[16]);
    for (number, &word) in words[17..].iter().enumerate() {
        core.set_single(number, word);
    }
}

/// Program counter and words of the state.
pub fn state(core: &Core) -> Vec<u32> {
    let mut words = vec![core.pc()];
    words.extend((0..15).map(|number| core.register(number)));
    words.extend([core.xpsr() & 0xf80f_0000, core.fpscr()]);
    words.extend((0..32).map(|number| core.single(number)));
    words
}

/// Next word of a stream, little-endian.
pub fn word(input: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    input.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// Next words of a stream.
pub fn words(input: &mut impl Read, count: usize) -> io::Result<Vec<u32>> {
    (0..count).map(|_| word(input)).collect()
}
