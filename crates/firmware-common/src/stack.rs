//! Stack: largest use, and detection of an overflow.
//!
//! The runtime fills the stack with a pattern before `main`; overwritten words were used. The stack is at the bottom
//! of the RAM (`memory.x`), and the memory protection unit guards the addresses below. A store below the stack is a
//! fault at the instruction that makes it, and no variable is changed. Without the guard the store would be a bus
//! error, reported some instructions later.

use core::ptr::addr_of;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
    static _stack_budget: u32;
}

/// Bytes below the stack that the protection unit denies. They exceed the largest stack frame, so that no function
/// skips the guard. The chip has no memory at these addresses or below.
const GUARD: u32 = 16 * 1024;
/// Region of the protection unit; where regions overlap, the highest number applies.
const REGION: u32 = 7;

/// Sets the guard; call it first.
pub(crate) fn guard() {
    const ENABLE: u32 = 1;
    const DEFAULT_MAP_ELSEWHERE: u32 = 1 << 2;
    const NO_EXECUTION: u32 = 1 << 28;
    const NO_ACCESS: u32 = NO_EXECUTION | (GUARD.trailing_zeros() - 1) << 1 | ENABLE;
    // SAFETY: the region denies only addresses below the stack, where the chip has no memory.
    unsafe {
        let mpu = &*cortex_m::peripheral::MPU::PTR;
        mpu.rnr.write(REGION);
        mpu.rbar.write(end() - GUARD);
        mpu.rasr.write(NO_ACCESS);
        mpu.ctrl.write(ENABLE | DEFAULT_MAP_ELSEWHERE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// True if a fault is a stack overflow: the stack pointer left the stack, the processor could not stack registers on
/// exception entry, or the denied address lies in the guard. `status` and `address` are the registers CFSR and MMFAR.
pub(crate) fn overflowed(sp: u32, status: u32, address: u32) -> bool {
    const ADDRESS_VALID: u32 = 1 << 7;
    const ON_ENTRY: u32 = 1 << 4;
    const ON_FLOATING_POINT: u32 = 1 << 5;
    let guarded = end() - GUARD..end();
    sp < end()
        || status & (ON_ENTRY | ON_FLOATING_POINT) != 0
        || (status & ADDRESS_VALID != 0 && guarded.contains(&address))
}

/// The lowest address of the stack.
fn end() -> u32 {
    addr_of!(_stack_end) as u32
}

/// Largest stack use so far, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HighWater {
    /// Largest stack use, bytes.
    pub used: usize,
    /// Allowed use, bytes: `_stack_budget` in `memory.x`, which the linker reserves.
    pub budget: usize,
    /// Size of the stack, bytes.
    pub size: usize,
}

/// Measures the stack use by reading the stack up to the first used word.
pub fn high_water() -> HighWater {
    // Of linker symbols only the address has a meaning.
    let (low, high) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let words = (high as usize - low as usize) / 4;
    let untouched = (0..words)
        // SAFETY: the memory from `low` to `high` is the stack. Below the stack pointer only interrupts write, and
        // any value read is valid.
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
        defmt::write!(
            to,
            "stack {} bytes used, budget {}, size {}",
            used,
            budget,
            size
        );
    }
}
