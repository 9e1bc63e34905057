//! Queues between the tick and the controller's interrupts, without access to registers.
//!
//! Frames that wait longer than [`STALE`] are dropped, in the queue and in the mailboxes: after a bus failure, old
//! messages must not pass for new ones.

use core_algos::bus::CanFrame;
use core_algos::time::{EPOCH, Micros};
use heapless::spsc::{Consumer, Producer, Queue};

use super::mailboxes::{Mailboxes, Waiting};

/// Size of the queue of messages to be sent; a board sends at most fourteen messages in an epoch.
const SENDING: usize = 24;
/// Size of the queue of frames that wait for the next tick; the bus carries at most nine frames in a millisecond.
const ARRIVED: usize = 32;
/// Age at which a message is dropped, µs: two epochs.
const STALE: Micros = 2 * EPOCH;

/// A frame and the local time at which it was queued or had arrived.
pub type Timed = (Micros, CanFrame);

/// Both queues. A `heapless` queue holds one frame less than its size.
pub struct Queues {
    sending: Queue<Timed, { SENDING + 1 }>,
    arrived: Queue<Timed, { ARRIVED + 1 }>,
}

impl Queues {
    /// Creates both queues, empty.
    pub const fn new() -> Self {
        Self {
            sending: Queue::new(),
            arrived: Queue::new(),
        }
    }

    /// Splits the queues into the two ends of the tick and the two ends of the interrupt handlers.
    pub fn split(&mut self) -> Ends<'_> {
        let (to_send, queue) = self.sending.split();
        let (from_bus, arrived) = self.arrived.split();
        Ends {
            to_send,
            arrived,
            transmitter: Transmitter {
                queue,
                mailboxes: Mailboxes::new(),
            },
            from_bus,
        }
    }
}

/// Ends of both [`Queues`], for the tick and the interrupt handlers.
pub struct Ends<'a> {
    /// The tick's end for frames to be sent.
    pub to_send: Producer<'a, Timed>,
    /// The tick's end for received frames.
    pub arrived: Consumer<'a, Timed>,
    /// The transmit handler's end: queue and mailboxes.
    pub transmitter: Transmitter<'a>,
    /// The receive handler's end for received frames.
    pub from_bus: Producer<'a, Timed>,
}

/// Queue of frames to be sent, and the state of the mailboxes.
pub struct Transmitter<'a> {
    queue: Consumer<'a, Timed>,
    mailboxes: Mailboxes,
}

impl Transmitter<'_> {
    /// Marks a mailbox as free and returns its frame.
    pub fn release(&mut self, mailbox: usize) -> Option<Waiting> {
        self.mailboxes.release(mailbox)
    }

    /// Mailboxes whose frame is too old and must be aborted.
    pub fn stale(&self, now: Micros) -> impl Iterator<Item = usize> {
        self.mailboxes.stale(now, STALE)
    }

    /// Moves frames from the queue to mailboxes while the controller takes part in the bus. Calls `request` for each
    /// frame moved and `drop` for each frame that has waited too long.
    pub fn fill(
        &mut self,
        now: Micros,
        joined: bool,
        mut request: impl FnMut(usize, &CanFrame),
        mut drop: impl FnMut(),
    ) {
        while let Some(&(since, frame)) = self.queue.peek() {
            if now.saturating_sub(since) > STALE {
                drop();
            } else if joined && let Some(mailbox) = self.mailboxes.choose(frame.id) {
                let id = frame.id;
                self.mailboxes.fill(mailbox, Waiting { id, since });
                request(mailbox, &frame);
            } else {
                break;
            }
            self.queue.dequeue();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(id: u16) -> CanFrame {
        CanFrame {
            id,
            length: 0,
            data: [0; 8],
        }
    }

    /// Mailboxes and identifiers that were written, and the number of dropped frames.
    fn fill(transmitter: &mut Transmitter, now: Micros, joined: bool) -> (Vec<(usize, u16)>, u32) {
        let (mut written, mut dropped) = (Vec::new(), 0);
        transmitter.fill(
            now,
            joined,
            |mailbox, frame| written.push((mailbox, frame.id)),
            || dropped += 1,
        );
        (written, dropped)
    }

    #[test]
    fn frames_wait_for_a_mailbox_in_order() {
        let mut queues = Queues::new();
        let mut ends = queues.split();
        for id in [5, 4, 3, 2] {
            ends.to_send.enqueue((0, frame(id))).unwrap();
        }
        let transmitter = &mut ends.transmitter;
        let written = fill(transmitter, 1, true);
        assert_eq!(written, (vec![(0, 5), (1, 4), (2, 3)], 0));
        assert_eq!(fill(transmitter, 2, true), (vec![], 0));
        transmitter.release(1);
        assert_eq!(fill(transmitter, 3, true), (vec![(1, 2)], 0));
    }

    #[test]
    fn frames_off_the_bus_wait_and_are_dropped_when_old() {
        let mut queues = Queues::new();
        let mut ends = queues.split();
        ends.to_send.enqueue((0, frame(1))).unwrap();
        assert_eq!(fill(&mut ends.transmitter, STALE, false), (vec![], 0));
        assert_eq!(fill(&mut ends.transmitter, STALE, true), (vec![(0, 1)], 0));
        for id in [2, 3] {
            ends.to_send.enqueue((0, frame(id))).unwrap();
        }
        assert_eq!(fill(&mut ends.transmitter, STALE + 1, false), (vec![], 2));
        assert_eq!(fill(&mut ends.transmitter, STALE + 1, true), (vec![], 0));
    }

    #[test]
    fn frames_older_than_two_epochs_are_dropped_in_the_queue_and_stale_in_the_mailboxes() {
        let mut queues = Queues::new();
        let mut ends = queues.split();
        ends.to_send.enqueue((0, frame(1))).unwrap();
        let transmitter = &mut ends.transmitter;
        fill(transmitter, 0, true);
        ends.to_send.enqueue((0, frame(2))).unwrap();
        ends.to_send.enqueue((STALE, frame(3))).unwrap();
        assert!(transmitter.stale(STALE).eq([]));
        assert!(transmitter.stale(STALE + 1).eq([0]));
        assert_eq!(fill(transmitter, STALE + 1, true), (vec![(1, 3)], 1));
    }

    #[test]
    fn queues_hold_their_capacity_in_order() {
        let mut queues = Queues::new();
        let mut ends = queues.split();
        let put = |queue: &mut Producer<Timed>| {
            let all = 0..100;
            let put = all.take_while(|&id| queue.enqueue((0, frame(id))).is_ok());
            put.count()
        };
        assert_eq!(put(&mut ends.to_send), SENDING);
        assert_eq!(put(&mut ends.from_bus), ARRIVED);
        let taken = core::iter::from_fn(|| ends.arrived.dequeue());
        assert!(taken.map(|(_, frame)| frame.id).eq(0..ARRIVED as u16));
    }
}
