//! Executors by priority: the tick above the bus, both above what runs in the thread.
//!
//! Interrupts of peripherals that no board uses lend them their priority.

use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};

static TICK: InterruptExecutor = InterruptExecutor::new();
static BUS: InterruptExecutor = InterruptExecutor::new();

/// Spawners of the two.
pub struct Spawners {
    /// For the tick.
    pub tick: SendSpawner,
    /// For the bus.
    pub bus: SendSpawner,
}

/// Starts both; to be called once.
pub fn start() -> Spawners {
    interrupt::UART4.set_priority(Priority::P5);
    interrupt::UART5.set_priority(Priority::P7);
    Spawners {
        tick: TICK.start(interrupt::UART4),
        bus: BUS.start(interrupt::UART5),
    }
}

#[interrupt]
unsafe fn UART4() {
    // SAFETY: this is the interrupt the executor was started with.
    unsafe { TICK.on_interrupt() }
}

#[interrupt]
unsafe fn UART5() {
    // SAFETY: this is the interrupt the executor was started with.
    unsafe { BUS.on_interrupt() }
}
