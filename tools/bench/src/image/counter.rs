//! Counts instructions by the virtual core's clock, which advances by 128 ns per instruction while SysTick counts at
//! 168 MHz. Measures stack by a pattern written below the stack pointer before a call.

use core::arch::asm;
use core::hint::black_box;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{Peripherals, SYST};
use cortex_m::register::{msp, pc};
use semihosting::println;

/// SysTick ticks per instruction, in thousandths.
const MILLITICKS: u64 = 21_504;
/// Reload value of SysTick; one period has at most 780 000 instructions.
const RELOAD: u32 = 0x00ff_ffff;

/// Number of painted words, an upper limit of the stack of a measured call.
const PAINTED: usize = 8192;
/// Pattern of an untouched word.
const PAINT: u32 = 0xc5a3_3a5c;

/// Cost of a call.
#[derive(Clone, Copy, Default)]
pub struct Cost {
    /// Number of instructions, the call itself included.
    pub instructions: u32,
    /// Stack that the call used, bytes.
    pub stack: u32,
    /// Address inside the function that makes the call; the compiler may have inlined the measured function there.
    pub code: u32,
}

/// Costs of several calls.
#[derive(Clone, Copy, Default)]
pub struct Total {
    calls: u32,
    sum: u32,
    most: u32,
    stack: u32,
    code: u32,
}

impl Total {
    /// Adds the cost of a call.
    pub fn add(&mut self, cost: Cost) {
        self.calls += 1;
        self.sum += cost.instructions;
        self.most = self.most.max(cost.instructions);
        self.stack = self.stack.max(cost.stack);
        self.code = cost.code;
    }

    /// Prints mean and largest count, largest stack, and the address of the code.
    pub fn print(&self, name: &str) {
        let mean = (self.sum + self.calls / 2) / self.calls.max(1);
        let Self {
            most, stack, code, ..
        } = self;
        println!("count {name} {mean} {most} {stack} {code:x}");
    }
}

/// Counter of the instructions and the stack of a call.
pub struct Counter {
    /// Timer of the measurement. It is owned, so that no other code can restart it.
    _clock: SYST,
    /// SysTick ticks that a measurement of an empty call takes.
    empty_ticks: u32,
    empty_stack: u32,
}

/// Paints the memory below the stack pointer, which is unused because there are no interrupts.
#[inline(always)]
fn paint() -> *mut u32 {
    let top = msp::read() as *mut u32;
    for i in 1..=PAINTED {
        // SAFETY: the stack has this room, and memory below the stack pointer is unused.
        unsafe { top.sub(i).write_volatile(PAINT) }
    }
    top
}

/// Bytes from `top` down to the lowest written byte.
#[inline(always)]
fn depth(top: *mut u32) -> u32 {
    let mut words = PAINTED;
    // SAFETY: the stack has room for the painted words.
    while words > 0 && unsafe { top.sub(words).read_volatile() } == PAINT {
        words -= 1;
    }
    assert!(words < PAINTED, "deeper than what is painted");
    4 * words as u32
}

impl Counter {
    /// Starts the clock.
    pub fn start() -> Self {
        // SAFETY: nothing else uses the peripherals.
        let mut clock = unsafe { Peripherals::steal() }.SYST;
        clock.set_clock_source(SystClkSource::Core);
        clock.set_reload(RELOAD);
        clock.clear_current();
        clock.enable_counter();
        let mut counter = Self {
            _clock: clock,
            empty_ticks: 0,
            empty_stack: 0,
        };
        let empty = counter.measure(|| ());
        counter.empty_ticks = empty.instructions;
        counter.empty_stack = empty.stack;
        println!("empty {:x}", empty.code);
        counter
    }

    /// Cost in ticks instead of instructions; includes the stack of the measurement.
    #[inline(always)]
    fn measure<T>(&mut self, call: impl FnOnce() -> T) -> Cost {
        let top = paint();
        let (instructions, code) = self.ticks(call);
        Cost {
            instructions,
            stack: depth(top),
            code,
        }
    }

    #[inline(never)]
    fn ticks<T>(&mut self, call: impl FnOnce() -> T) -> (u32, u32) {
        cortex_m::asm::dsb();
        let before = SYST::get_current();
        black_box(call());
        let after = SYST::get_current();
        (before.wrapping_sub(after) & RELOAD, pc::read())
    }

    /// Cost of a call, the call itself included.
    #[inline(always)]
    pub fn cost<T>(&mut self, call: impl FnOnce() -> T) -> Cost {
        let cost = self.measure(call);
        let ticks = u64::from(cost.instructions.saturating_sub(self.empty_ticks));
        Cost {
            instructions: ((1000 * ticks + MILLITICKS / 2) / MILLITICKS) as u32,
            stack: cost.stack.saturating_sub(self.empty_stack),
            code: cost.code,
        }
    }

    /// Measures repeated calls and prints their cost.
    pub fn report<T>(&mut self, name: &str, repeats: u32, mut call: impl FnMut(u32) -> T) {
        let mut total = Total::default();
        for k in 0..repeats {
            total.add(self.cost(|| call(black_box(k))));
        }
        total.print(name);
    }

    /// Measures and prints the cost of a stateless function, less the cost of `nothing`, which takes equal arguments
    /// and returns a result.
    pub fn report_function<A: Copy, T, E>(
        &mut self,
        name: &str,
        repeats: u32,
        arguments: impl Fn(u32) -> A,
        function: impl Fn(A) -> T,
        nothing: impl Fn(A) -> E,
    ) {
        let mut total = Total::default();
        for k in 0..repeats {
            let argument = arguments(k);
            let mut cost = self.cost(|| function(black_box(argument)));
            let empty = self.cost(|| nothing(black_box(argument)));
            cost.instructions = cost.instructions.saturating_sub(empty.instructions);
            total.add(cost);
        }
        total.print(name);
    }

    /// Counted instructions of 100 NOPs.
    pub fn nops_100(&mut self) -> u32 {
        // SAFETY: nothing happens.
        let nops = || unsafe { asm!(".rept 100", "nop", ".endr") };
        self.cost(nops).instructions
    }

    /// Counted instructions of 1000 NOPs.
    pub fn nops_1000(&mut self) -> u32 {
        // SAFETY: nothing happens.
        let nops = || unsafe { asm!(".rept 1000", "nop", ".endr") };
        self.cost(nops).instructions
    }
}
