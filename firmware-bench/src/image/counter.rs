//! Instructions by the emulator's clock: it is told to let 128 ns pass with each instruction, and
//! SysTick counts at 168 MHz.

use core::arch::asm;
use core::hint::black_box;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{Peripherals, SYST};
use semihosting::println;

/// Thousandths of a tick of SysTick in an instruction.
const MILLITICKS: u64 = 21_504;
/// SysTick counts down from here; one count spans at most 780 000 instructions.
const RELOAD: u32 = 0x00ff_ffff;

/// Counts instructions.
pub struct Counter {
    /// Kept so that nobody else starts it anew.
    _clock: SYST,
    /// Ticks that a measurement of nothing takes.
    empty: u32,
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
            empty: 0,
        };
        counter.empty = counter.ticks(|| ());
        counter
    }

    #[inline(never)]
    fn ticks<T>(&mut self, call: impl FnOnce() -> T) -> u32 {
        cortex_m::asm::dsb();
        let before = SYST::get_current();
        black_box(call());
        let after = SYST::get_current();
        before.wrapping_sub(after) & RELOAD
    }

    /// Instructions of a call, its share of calling it included.
    pub fn count<T>(&mut self, call: impl FnOnce() -> T) -> u32 {
        let ticks = u64::from(self.ticks(call).saturating_sub(self.empty));
        ((1000 * ticks + MILLITICKS / 2) / MILLITICKS) as u32
    }

    /// Measures one call after another and prints the mean and the largest count.
    pub fn report<T>(&mut self, name: &str, repeats: u32, mut call: impl FnMut(u32) -> T) {
        let (mut sum, mut most) = (0, 0);
        for k in 0..repeats {
            let count = self.count(|| call(black_box(k)));
            sum += count;
            most = most.max(count);
        }
        println!("count {} {} {}", name, (sum + repeats / 2) / repeats, most);
    }

    /// The same for a function without a state: what it costs to bring the arguments to a call, and
    /// to take a result away as `nothing` does, is taken off.
    pub fn report_function<A: Copy, T, E>(
        &mut self,
        name: &str,
        repeats: u32,
        arguments: impl Fn(u32) -> A,
        function: impl Fn(A) -> T,
        nothing: impl Fn(A) -> E,
    ) {
        let (mut sum, mut most) = (0, 0);
        for k in 0..repeats {
            let argument = arguments(k);
            let count = self.count(|| function(black_box(argument)));
            let empty = self.count(|| nothing(black_box(argument)));
            let count = count.saturating_sub(empty);
            sum += count;
            most = most.max(count);
        }
        println!("count {} {} {}", name, (sum + repeats / 2) / repeats, most);
    }

    /// What a hundred instructions that do nothing are counted as.
    pub fn nops_100(&mut self) -> u32 {
        // SAFETY: nothing happens.
        self.count(|| unsafe { asm!(".rept 100", "nop", ".endr") })
    }

    /// What a thousand of them are counted as.
    pub fn nops_1000(&mut self) -> u32 {
        // SAFETY: nothing happens.
        self.count(|| unsafe { asm!(".rept 1000", "nop", ".endr") })
    }
}
