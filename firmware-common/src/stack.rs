//! How much stack was ever used: the runtime paints it before `main`, what is overwritten was used.

use core::ptr::addr_of;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
    static _stack_budget: u32;
}

/// How much of the stack was in use at most so far, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HighWater {
    /// The most that was in use.
    pub used: usize,
    /// What may be: `_stack_budget` in `memory.x`, for which the linker makes sure that there is room.
    pub budget: usize,
    /// What there is.
    pub size: usize,
}

/// Measures it: reads all that was never used.
pub fn high_water() -> HighWater {
    // Linker symbols: only their addresses mean something.
    let (low, high) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let words = (high as usize - low as usize) / 4;
    let untouched = (0..words)
        // SAFETY: from `low` to `high` is memory of the stack. Below the stack pointer nothing
        // writes but interrupts, and any value read is as good.
        .take_while(|&i| unsafe { low.add(i).read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE)
        .count();
    HighWater {
        used: 4 * (words - untouched),
        budget: addr_of!(_stack_budget) as usize,
        size: 4 * words,
    }
}

impl defmt::Format for HighWater {
    fn format(&self, to: defmt::Formatter) {
        let Self { used, budget, size } = self;
        defmt::write!(to, "stack {} of {} bytes, {} there", used, budget, size);
    }
}
