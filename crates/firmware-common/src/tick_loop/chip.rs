//! Hardware of the tick loop on the board.

use core_algos::bus::Message;
use core_algos::time::Micros;
use cortex_m::peripheral::{DCB, DWT};
use embassy_time::Instant;

use super::Hardware;
use crate::can::{self, Arrived, Receiver, Sender};
use crate::led::Led;
use crate::task_watchdog::CheckIn;

/// LED, bus and task watchdog of the tick loop.
pub struct Chip {
    led: Led,
    sender: Sender,
    receiver: Receiver,
    check_in: CheckIn,
}

impl Chip {
    /// Combines these parts and starts the cycle counter.
    pub fn new(led: Led, sender: Sender, receiver: Receiver, check_in: CheckIn) -> Self {
        // SAFETY: only the cycle counter is accessed, and enabling it twice is harmless.
        let mut core = unsafe { cortex_m::Peripherals::steal() };
        DCB::enable_trace(&mut core.DCB);
        core.DWT.enable_cycle_counter();
        Self {
            led,
            sender,
            receiver,
            check_in,
        }
    }

    /// Local time at which this board's latest [`Message::TimeSync`] had left the bus, µs; `None` if none has left
    /// since the last call.
    pub fn take_sync_sent(&mut self) -> Option<Micros> {
        self.sender.take_sync_sent()
    }
}

impl Hardware for Chip {
    fn check_in(&mut self) {
        self.check_in.report();
    }

    fn now(&self) -> Micros {
        Instant::now().as_micros()
    }

    fn cycles(&self) -> u32 {
        DWT::cycle_count()
    }

    fn is_bus_off(&self) -> bool {
        can::is_off()
    }

    fn set_led(&mut self, lit: bool) {
        self.led.set(lit);
    }

    fn receive(&mut self) -> Option<Arrived> {
        self.receiver.take()
    }

    fn send(&mut self, message: &Message) -> Option<Message> {
        self.sender.send(message)
    }

    fn send_link_frame(&mut self) {
        self.sender.send_link_frame();
    }
}
