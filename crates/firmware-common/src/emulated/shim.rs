//! Clock, power and flash registers that QEMU does not model, so that the HAL starts unmodified.
//!
//! QEMU's STM32F405 has no ready bits in RCC, PWR and FLASH, and the HAL waits for them. Here the
//! memory protection unit denies access to their pages. Each load or store there raises a fault;
//! the handler carries it out on a shadow of the registers in which the ready bits follow their
//! enable bits at once, and continues behind the instruction. Any other fault is a real one.
//!
//! It also keeps peripheral resets from QEMU's RCC, which a reset on APB2 can crash.
//!
//! # Why the hard fault
//!
//! The HAL starts under a critical section, where a memory management fault has no priority to be
//! taken and becomes a hard fault. So it is left to become one always.

use core::cell::UnsafeCell;
use core::ptr::with_exposed_provenance_mut;

use cortex_m_rt::ExceptionFrame;

use super::instruction::{Access, after_instruction};
use super::shadow::{Block, PWR, RCC_FLASH, Shadow};
use crate::fault;

struct Shared(UnsafeCell<Shadow>);

// SAFETY: after `install` only the hard fault handler touches it, which nothing interrupts.
unsafe impl Sync for Shared {}

static SHADOW: Shared = Shared(UnsafeCell::new(Shadow::at_reset()));

/// Puts the shadow in place; to be called before the first access to the registers.
pub fn install() {
    const ENABLE: u32 = 1;
    const DEFAULT_MAP_ELSEWHERE: u32 = 1 << 2;
    // SAFETY: interrupts are not in use yet, and the regions change nothing but the pages above.
    unsafe {
        let mpu = &*cortex_m::peripheral::MPU::PTR;
        for (number, block) in (0..).zip([PWR, RCC_FLASH]) {
            mpu.rnr.write(number);
            mpu.rbar.write(block.base);
            mpu.rasr.write(no_access(&block));
        }
        mpu.ctrl.write(ENABLE | DEFAULT_MAP_ELSEWHERE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Attributes of a region of the protection unit: of this size, no access, no execution, enabled.
const fn no_access(block: &Block) -> u32 {
    const NO_EXECUTION: u32 = 1 << 28;
    const ENABLE: u32 = 1;
    NO_EXECUTION | (block.size.trailing_zeros() - 1) << 1 | ENABLE
}

/// Registers at a fault: those that the processor put on the stack (with status and return address),
/// and those that the handler put there.
struct Registers<'a> {
    frame: &'a mut ExceptionFrame,
    saved: &'a mut [u32; 8],
}

impl Registers<'_> {
    fn get(&self, number: u32) -> u32 {
        let frame = &*self.frame;
        match number {
            0 => frame.r0(),
            1 => frame.r1(),
            2 => frame.r2(),
            3 => frame.r3(),
            4..=11 => self.saved[number as usize - 4],
            12 => frame.r12(),
            _ => frame.lr(),
        }
    }

    fn set(&mut self, number: u32, value: u32) {
        // SAFETY: the values are those that the instruction would have left.
        unsafe {
            match number {
                0 => self.frame.set_r0(value),
                1 => self.frame.set_r1(value),
                2 => self.frame.set_r2(value),
                3 => self.frame.set_r3(value),
                4..=11 => self.saved[number as usize - 4] = value,
                12 => self.frame.set_r12(value),
                _ => self.frame.set_lr(value),
            }
        }
    }

    /// Continues `size` bytes further.
    fn skip(&mut self, size: u32) {
        // SAFETY: the instruction at pc has been carried out.
        unsafe {
            self.frame.set_xpsr(after_instruction(self.frame.xpsr()));
            self.frame.set_pc(self.frame.pc() + size);
        }
    }
}

/// Carries out the access that faulted; `None` if it is not one for the shadow.
fn replay(registers: &mut Registers) -> Option<()> {
    const DATA_ACCESS: u32 = 1 << 1;
    const ADDRESS_VALID: u32 = 1 << 7;
    const MEMORY_FAULTS: u32 = 0xff;
    // SAFETY: reads of fault registers; writing ones clears the bits that are looked at here.
    let scb = unsafe { &*cortex_m::peripheral::SCB::PTR };
    let status = scb.cfsr.read();
    if status & (DATA_ACCESS | ADDRESS_VALID) != DATA_ACCESS | ADDRESS_VALID {
        return None;
    }
    let address = scb.mmfar.read();
    let pc = with_exposed_provenance_mut::<u16>(registers.frame.pc() as usize);
    // SAFETY: the processor has just fetched the instruction from there.
    let access = unsafe { Access::decode(pc.read_volatile(), pc.add(1).read_volatile()) }?;
    // SAFETY: this handler is alone, see `Shared`.
    let shadow = unsafe { &mut *SHADOW.0.get() };
    if access.load {
        let value = shadow.read(address)?;
        registers.set(access.value, value);
    } else {
        shadow.write(address, registers.get(access.value))?;
    }
    if let Some((base, offset)) = access.base {
        registers.set(base, registers.get(base).wrapping_add_signed(offset));
    }
    registers.skip(access.size);
    // SAFETY: as above.
    unsafe { scb.cfsr.write(status & MEMORY_FAULTS) };
    Some(())
}

/// Called with the frame that the processor stacked and with r4 to r11 as the handler stacked them.
unsafe extern "C" fn on_hard_fault(frame: *mut ExceptionFrame, saved: *mut [u32; 8]) {
    // SAFETY: both are on the stack of the program that faulted, which waits.
    let mut registers = unsafe {
        Registers {
            frame: &mut *frame,
            saved: &mut *saved,
        }
    };
    if replay(&mut registers).is_none() {
        let sp = core::ptr::from_ref(registers.frame) as u32;
        fault::hard_fault(registers.frame.pc(), registers.frame.lr(), sp);
    }
}

/// The hard fault vector: saves the registers that the processor does not, and calls the above. A stack
/// that is used up is begun anew: the program has ended.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    core::arch::naked_asm!(
        "movw r0, #:lower16:_stack_end",
        "movt r0, #:upper16:_stack_end",
        "mov r2, sp",
        "cmp r2, r0",
        "bhs 1f",
        "movw r0, #:lower16:_stack_start",
        "movt r0, #:upper16:_stack_start",
        "msr msp, r0",
        "movs r0, #0",
        "movs r1, #0",
        "b {overflow}",
        "1:",
        "tst lr, #4",
        "ite eq",
        "mrseq r0, msp",
        "mrsne r0, psp",
        // r3 only keeps the stack aligned to eight bytes.
        "push {{r3-r11, lr}}",
        "add r1, sp, #4",
        "bl {handler}",
        "pop {{r3-r11, pc}}",
        handler = sym on_hard_fault,
        overflow = sym fault::hard_fault,
    )
}
