//! Executors by priority: the tick preempts the bus, and both preempt the thread.
//!
//! The executors use the interrupts of UART4 and UART5, peripherals that no board uses.

use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};

static TICK: InterruptExecutor = InterruptExecutor::new();
static BUS: InterruptExecutor = InterruptExecutor::new();

/// Spawners for the executors of the tick and the bus.
pub struct Spawners {
    /// Spawner of the tick's executor.
    pub tick: SendSpawner,
    /// Spawner of the bus's executor.
    pub bus: SendSpawner,
}

/// Starts both executors; call it once.
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
    // SAFETY: the executor was started with this interrupt.
    unsafe { TICK.on_interrupt() }
}

#[interrupt]
unsafe fn UART5() {
    // SAFETY: the executor was started with this interrupt.
    unsafe { BUS.on_interrupt() }
}
