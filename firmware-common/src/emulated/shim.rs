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

use crate::fault;

/// A block of registers: its first address and its size, a power of two that divides the address.
struct Block {
    base: u32,
    size: u32,
}

const PWR: Block = Block {
    base: 0x4000_7000,
    size: 0x400,
};
/// FLASH follows RCC within the same two pages.
const RCC_FLASH: Block = Block {
    base: 0x4002_3800,
    size: 0x800,
};

// Registers whose bits are not just kept.
const PWR_CSR: u32 = 0x4000_7004;
const RCC_CR: u32 = 0x4002_3800;
const RCC_PLLCFGR: u32 = 0x4002_3804;
const RCC_CFGR: u32 = 0x4002_3808;
const RCC_BDCR: u32 = 0x4002_3870;
const RCC_CSR: u32 = 0x4002_3874;
const FLASH_OPTCR: u32 = 0x4002_3c14;

/// Values at power-on that differ from zero.
const RESET_VALUES: [(u32, u32); 4] = [
    (RCC_CR, 0x0000_0083),
    (RCC_PLLCFGR, 0x2400_3010),
    (RCC_CSR, 0x0e00_0000),
    (FLASH_OPTCR, 0x0fff_aaed),
];

impl Block {
    const fn words(&self) -> usize {
        self.size as usize / 4
    }

    /// Index of the word at `address`, if it is in the block.
    const fn word(&self, address: u32) -> Option<usize> {
        let offset = address.wrapping_sub(self.base);
        if offset < self.size && offset.is_multiple_of(4) {
            Some(offset as usize / 4)
        } else {
            None
        }
    }

    /// Region attributes of the protection unit: this size, no access, no execution, enabled.
    const fn attributes(&self) -> u32 {
        const NO_EXECUTION: u32 = 1 << 28;
        const ENABLE: u32 = 1;
        NO_EXECUTION | (self.size.trailing_zeros() - 1) << 1 | ENABLE
    }
}

/// The registers' contents.
struct Shadow {
    pwr: [u32; PWR.words()],
    rcc_flash: [u32; RCC_FLASH.words()],
}

struct Shared(UnsafeCell<Shadow>);

// SAFETY: after `install` only the hard fault handler touches it, which nothing interrupts.
unsafe impl Sync for Shared {}

static SHADOW: Shared = Shared(UnsafeCell::new(Shadow {
    pwr: [0; PWR.words()],
    rcc_flash: [0; RCC_FLASH.words()],
}));

impl Shadow {
    fn register(&mut self, address: u32) -> Option<&mut u32> {
        if let Some(word) = PWR.word(address) {
            self.pwr.get_mut(word)
        } else {
            self.rcc_flash.get_mut(RCC_FLASH.word(address)?)
        }
    }

    /// What the chip would return: the register with ready bits that follow their enable bits.
    fn read(&mut self, address: u32) -> Option<u32> {
        let value = *self.register(address)?;
        Some(match address {
            // HSI, HSE, PLL and PLLI2S: on at bits 0, 16, 24, 26, ready one above.
            RCC_CR => value | (value & 0x0501_0001) << 1,
            // The clock in use (bits 3:2) is the one selected (bits 1:0).
            RCC_CFGR => value & !0b1100 | (value & 0b11) << 2,
            // LSE and LSI: on at bit 0, ready at bit 1.
            RCC_BDCR | RCC_CSR => value | (value & 1) << 1,
            // Voltage scaling is ready.
            PWR_CSR => value | 1 << 14,
            _ => value,
        })
    }

    fn write(&mut self, address: u32, value: u32) -> Option<()> {
        /// "Remove reset flags" of RCC_CSR, and the flags.
        const RMVF: u32 = 1 << 24;
        const FLAGS: u32 = 0xfe << 24;
        let clears_flags = address == RCC_CSR && value & RMVF != 0;
        let kept = if clears_flags {
            value & !(RMVF | FLAGS)
        } else {
            value
        };
        *self.register(address)? = kept;
        Some(())
    }
}

/// Puts the shadow in place; to be called before the first access to the registers.
pub fn install() {
    const ENABLE: u32 = 1;
    const DEFAULT_MAP_ELSEWHERE: u32 = 1 << 2;
    // SAFETY: interrupts are not in use yet, and the regions change nothing but the pages above.
    unsafe {
        for (address, value) in RESET_VALUES {
            if let Some(register) = (*SHADOW.0.get()).register(address) {
                *register = value;
            }
        }
        let mpu = &*cortex_m::peripheral::MPU::PTR;
        for (number, block) in (0..).zip([PWR, RCC_FLASH]) {
            mpu.rnr.write(number);
            mpu.rbar.write(block.base);
            mpu.rasr.write(block.attributes());
        }
        mpu.ctrl.write(ENABLE | DEFAULT_MAP_ELSEWHERE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
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

    /// Continues `size` bytes further, with the state of an if-then block moved on.
    fn skip(&mut self, size: u32) {
        let status = self.frame.xpsr();
        let block = (status >> 8) & 0xfc | (status >> 25) & 0b11;
        let next = if block & 0b111 == 0 {
            0
        } else {
            block & 0xe0 | (block << 1) & 0x1f
        };
        let moved = status & !(0xfc << 8 | 0b11 << 25) | (next & 0xfc) << 8 | (next & 0b11) << 25;
        // SAFETY: the instruction at pc has been carried out.
        unsafe {
            self.frame.set_xpsr(moved);
            self.frame.set_pc(self.frame.pc() + size);
        }
    }
}

/// A load or store of one word.
struct Access {
    load: bool,
    /// Register loaded or stored.
    value: u32,
    /// Base register and what it becomes, in the forms that change it.
    base: Option<(u32, i32)>,
    /// Bytes of the instruction.
    size: u32,
}

impl Access {
    /// Decodes the forms of LDR and STR that a compiler uses for registers of peripherals
    /// (ARMv7-M reference manual, A7.7.43–45 and A7.7.161–162); others are none.
    fn decode(first: u16, second: u16) -> Option<Self> {
        let (first, second) = (u32::from(first), u32::from(second));
        // STR and LDR with a register or a small immediate as offset; bit 11 tells them apart.
        if matches!(first & 0xfe00, 0x5000 | 0x5800) || matches!(first & 0xf000, 0x6000) {
            let load = first & 0x0800 != 0;
            return Some(Self {
                load,
                value: first & 0b111,
                base: None,
                size: 2,
            });
        }
        let (base, value) = (first & 0xf, second >> 12);
        let wide = |load, base| {
            Some(Self {
                load,
                value,
                base,
                size: 4,
            })
        };
        let load = first >> 4 & 1 == 1;
        match first >> 4 {
            // 12-bit offset.
            0xf8c | 0xf8d => wide(load, None),
            0xf84 | 0xf85 if second & 0x0fc0 == 0 => wide(load, None),
            // 8-bit offset: bit 11 set; bits 10:8 are before, up, write back.
            0xf84 | 0xf85 if second & 0x0800 != 0 => {
                let offset = (second & 0xff) as i32;
                let offset = if second & 0x0200 != 0 {
                    offset
                } else {
                    -offset
                };
                let write_back = second & 0x0100 != 0;
                wide(load, write_back.then_some((base, offset)))
            }
            _ => None,
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
        fault::hard_fault(registers.frame);
    }
}

/// The hard fault vector: saves the registers that the processor does not, and calls the above.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    core::arch::naked_asm!(
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
    )
}
