//! Semihosting for programs (ARM's semihosting, version 2): output and exit.

use super::Flat;
use virtual_board::core::Core;

/// True if a program ended without an error.
pub type Ended = bool;

/// Serves a semihosting call; prints the program's output if `loud`. Returns the program's result when the call ends
/// the program; `None` otherwise.
pub fn serve(core: &mut Core, flat: &mut Flat, loud: bool) -> Option<Ended> {
    let (operation, block) = (core.register(0), core.register(1));
    let byte = |flat: &Flat, address: u32| {
        let memory = if address >> 24 == 0x20 {
            &flat.sram
        } else {
            &flat.flash
        };
        memory[(address & 0xff_ffff) as usize]
    };
    let word = |flat: &Flat, address: u32| {
        u32::from_le_bytes([0, 1, 2, 3].map(|k| byte(flat, address + k)))
    };
    let text: Vec<u8> = match operation {
        4 => (block..)
            .map(|a| byte(flat, a))
            .take_while(|&b| b != 0)
            .collect(),
        5 => {
            let (begin, length) = (word(flat, block + 4), word(flat, block + 8));
            (begin..begin + length).map(|a| byte(flat, a)).collect()
        }
        _ => Vec::new(),
    };
    if loud {
        print!("{}", String::from_utf8_lossy(&text));
    }
    let result = match operation {
        1 => 1,
        4 | 5 => 0,
        // Reason ADP_Stopped_ApplicationExit: in r1 (operation 0x18), or in a block with an exit code (0x20).
        0x18 => return Some(block == 0x2_0026),
        0x20 => return Some(word(flat, block) == 0x2_0026 && word(flat, block + 4) == 0),
        _ => u32::MAX,
    };
    core.set_register(0, result);
    core.set_register(15, core.pc() + 2);
    None
}
