//! Serial line between an adapter and a virtual board.

use std::collections::VecDeque;
use virtual_board::Time;
use virtual_board::chip::Inputs;

/// Duration of a byte at 921 600 baud, ns.
const BYTE_NS: u64 = 10_851;

/// Bytes in transit in both directions.
#[derive(Clone, Default)]
pub struct SerialLine {
    incoming: VecDeque<u8>,
    /// Arrival time of the first byte of `incoming`.
    due: Time,
    /// Bytes that the board has sent.
    pub sent: Vec<u8>,
}

impl SerialLine {
    /// Sends bytes to the board from `now` on, after the bytes in transit.
    pub fn send(&mut self, bytes: &[u8], now: Time) {
        if self.incoming.is_empty() {
            self.due = now + Time::from_nanos(BYTE_NS);
        }
        self.incoming.extend(bytes);
    }

    /// Arrival time of the next byte at the board.
    pub fn next(&self) -> Time {
        match self.incoming.is_empty() {
            true => Time::NEVER,
            false => self.due,
        }
    }

    /// Delivers the byte that is due at `at`.
    pub fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        if self.next() <= at
            && let Some(byte) = self.incoming.pop_front()
        {
            inputs.serial.push(byte);
            self.due = at + Time::from_nanos(BYTE_NS);
        }
    }
}
