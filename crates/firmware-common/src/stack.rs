//! The stack: how much of it was ever used, and what ends it.
//!
//! The runtime paints it before `main`; what is overwritten was used. It lies at the bottom of the RAM
//! (`memory.x`), and the memory protection unit guards what is below: a store there is a fault at the
//! instruction that makes it, and no variable is changed. Without the guard the store would be a bus
//! error, some instructions later.

use core::ptr::addr_of;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
    static _stack_budget: u32;
}

/// Bytes below the stack to which the protection unit denies access: more than the largest frame, so
/// that no function steps over it; what lies further below is no RAM either. The chip has nothing there.
const GUARD: u32 = 16 * 1024;
/// Region of the protection unit; of those that overlap the last counts.
const REGION: u32 = 7;

/// Sets the guard; call it first.
pub(crate) fn guard() {
    const ENABLE: u32 = 1;
    const DEFAULT_MAP_ELSEWHERE: u32 = 1 << 2;
    const NO_EXECUTION: u32 = 1 << 28;
    const NO_ACCESS: u32 = NO_EXECUTION | (GUARD.trailing_zeros() - 1) << 1 | ENABLE;
    // SAFETY: the region changes nothing but the addresses below the stack, where nothing is.
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

/// True if a fault is a stack overflow: the stack pointer left the stack, or the denied address
/// lies in the guard. `status` and `address` are the registers CFSR and MMFAR.
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
    /// The most that was in use.
    pub used: usize,
    /// Allowed use: `_stack_budget` in `memory.x`; the linker reserves this room.
    pub budget: usize,
    /// Size of the stack.
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
