//! How much stack was ever used: the runtime paints it before `main`, what is overwritten was used.

use core::ptr::addr_of;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Most bytes of stack in use at any time so far, and the bytes there are.
pub fn high_water() -> (usize, usize) {
    // Linker symbols: only their addresses mean something.
    let (low, high) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let words = (high as usize - low as usize) / 4;
    let untouched = (0..words)
        // Below the stack pointer nothing writes but interrupts, and any value read is as good.
        .take_while(|&i| unsafe { low.add(i).read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE)
        .count();
    (4 * (words - untouched), 4 * words)
}
