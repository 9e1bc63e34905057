//! The protocol of one controller, bit by bit: arbitration, transmission, reception, errors and their counters (ISO
//! 11898-1; where the standard leaves a choice, as in the bxCAN).

mod errors;

use crate::time::Time;
use crate::wire::frame::{Bits, Frame};
use crate::wire::node::{ErrorKind, EventKind, Settings};
use crate::wire::receiver::{Receiver, ReceiverStep};
use crate::wire::statistics::Statistics;

/// Number of recessive bits after which a controller takes part.
const IDLE_BITS: u8 = 11;
/// Number of sequences of eleven recessive bits for recovery from bus-off.
const RECOVERY: u8 = 128;
/// Length of an error or overload flag, bits.
const FLAG: u8 = 6;
/// Length of the delimiter after an error or overload flag, bits.
const DELIMITER: u8 = 8;
/// Bits that an error-passive sender waits after the intermission.
const SUSPEND: u8 = 8;
/// Counter value from which a controller is error-passive.
const PASSIVE: u16 = 128;
/// Transmit counter value from which a controller is in bus-off.
const OFF: u16 = 256;

/// A mailbox waiting for transmission.
#[derive(Clone, Copy, Debug)]
struct Pending {
    mailbox: u8,
    frame: Frame,
    bits: Bits,
    aborted: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// Not on the bus.
    #[default]
    Out,
    /// Counts recessive bits before taking part.
    Joining(u8),
    /// Bus-off: number of consecutive recessive bits, and number of completed sequences of eleven recessive bits.
    BusOff(u8, u8),
    /// The bus is idle.
    Idle,
    /// Sends or receives a frame.
    Frame,
    /// Sends an error or overload flag: number of bits so far.
    Flag(u8),
    /// Waits for the end of the other nodes' flags. Number of dominant bits so far; after 8 it restarts at 1.
    Await(u8),
    /// Number of recessive bits of a delimiter so far.
    Delimiter(u8),
    /// Number of bits of the intermission so far.
    Intermission(u8),
    /// Number of bits that a passive sender has waited so far.
    Suspend(u8),
}

/// Kind of the flag that the controller sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Flag {
    #[default]
    Active,
    Passive,
    Overload,
}

/// A transmission that has ended, for the record of the wire.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ended {
    pub frame: Frame,
    pub start: Time,
    pub error: Option<ErrorKind>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Controller {
    settings: Option<Settings>,
    state: State,
    flag: Flag,
    /// Latest level in a passive error flag, which ends after six equal bits.
    flag_level: bool,
    /// True if a passive sender met no acknowledgement. This error is counted only if the sender reads a dominant bit
    /// during its flag.
    uncounted_ack_error: bool,
    /// True if this controller transmits or transmitted the present or latest frame.
    sender: bool,
    receiver: Receiver,
    sending: Option<(Pending, u8)>,
    pending: Vec<Pending>,
    /// Sample point of the start of frame.
    start: Time,
    tec: u16,
    rec: u16,
    off: bool,
    leaving: bool,
    /// True if the controller drives dominant in the next bit.
    pub dominant: bool,
    /// Events at the latest sample.
    pub events: Vec<EventKind>,
    /// Transmission that ended at the latest sample, for the wire to take; `None` otherwise.
    pub ended: Option<Ended>,
    pub statistics: Statistics,
}

impl Controller {
    /// Error counters as shown in the registers: transmit, receive.
    pub fn counters(&self) -> (u8, u8) {
        // In bus-off the bxCAN shows the last value that fits.
        let tec = if self.tec >= OFF { OFF - 8 } else { self.tec };
        (tec as u8, self.rec as u8)
    }

    /// True if the controller samples the bus.
    pub fn is_in(&self) -> bool {
        self.state != State::Out
    }

    /// Time until which the controller has nothing to do on a recessive bus.
    pub fn quiet_until(&self) -> Time {
        match self.state {
            State::Out => Time::NEVER,
            State::BusOff(..) if !self.recovers() => Time::NEVER,
            State::Idle if self.pending.is_empty() || !self.can_send() => Time::NEVER,
            _ => Time(0),
        }
    }

    /// True during a frame and the flags, delimiters and intermission after it.
    pub fn is_busy(&self) -> bool {
        !matches!(
            self.state,
            State::Out | State::Idle | State::Joining(_) | State::BusOff(..)
        )
    }

    /// True while no requested frame can begin: from the second bit of a frame on, and in flags and their delimiters.
    pub fn is_closed(&self) -> bool {
        match self.state {
            State::Frame => self.receiver.count() >= 2,
            State::Flag(_) | State::Await(_) | State::Delimiter(_) => true,
            _ => false,
        }
    }

    /// True if an edge restarts the bit (hard synchronization).
    pub fn is_hard(&self) -> bool {
        !matches!(
            self.state,
            State::Frame | State::Flag(_) | State::Await(_) | State::Delimiter(_)
        )
    }

    /// Settings; `None` until set.
    pub fn settings(&self) -> Option<&Settings> {
        self.settings.as_ref()
    }

    /// Frame being transmitted, and the index of its next bit; `None` if no transmission is in progress.
    pub fn sending(&self) -> Option<(&Bits, usize)> {
        let (pending, place) = self.sending.as_ref()?;
        Some((&pending.bits, usize::from(*place)))
    }

    /// Received part of the present frame.
    pub fn arrived(&self) -> &Receiver {
        &self.receiver
    }

    /// True if the controller only receives, and has received this part of the frame.
    pub fn follows(&self, arrived: &Receiver) -> bool {
        let receives = self.state == State::Frame && self.sending.is_none();
        receives && !self.dominant && self.receiver == *arrived
    }

    /// Sets the received part of a frame without errors; a sender continues with bit `next`.
    pub fn fast_forward(&mut self, arrived: Receiver, next: usize) {
        self.receiver = arrived;
        if let Some((pending, place)) = &mut self.sending {
            *place = next as u8;
            self.dominant = !pending.bits.recessive(next);
        }
    }

    fn passive(&self) -> bool {
        self.tec >= PASSIVE || self.rec >= PASSIVE
    }

    fn with(&self, of: impl Fn(&Settings) -> bool) -> bool {
        self.settings.as_ref().is_some_and(of)
    }

    fn recovers(&self) -> bool {
        self.with(|s| s.recover) || !self.off
    }

    fn can_send(&self) -> bool {
        !self.leaving
    }

    /// Resets the controller; statistics are kept.
    pub fn reset(&mut self) {
        *self = Self {
            statistics: self.statistics,
            ..Self::default()
        };
    }

    /// Applies new settings, including joining and leaving the bus.
    pub fn set(&mut self, settings: Settings) {
        let was_in = self.is_in();
        match (was_in, settings.on) {
            (false, true) => {
                self.settings = Some(settings);
                self.leaving = false;
                self.state = State::Joining(0);
                // Without automatic recovery, a program starts the recovery from bus-off by leaving and rejoining.
                if self.tec >= OFF {
                    self.off = false;
                }
            }
            (false, false) => {
                self.settings = Some(settings);
                self.events.push(EventKind::Left);
            }
            (true, true) => {
                self.settings = Some(settings);
                self.leaving = false;
            }
            (true, false) => self.leave(),
        }
    }

    fn leave(&mut self) {
        if self.is_hard() {
            self.out();
        } else {
            self.leaving = true;
        }
    }

    fn out(&mut self) {
        (self.state, self.dominant, self.leaving) = (State::Out, false, false);
        self.events.push(EventKind::Left);
    }

    /// Queues a mailbox for transmission.
    pub fn request(&mut self, mailbox: u8, frame: Frame) {
        self.pending.retain(|p| p.mailbox != mailbox);
        self.pending.push(Pending {
            mailbox,
            frame,
            bits: frame.bits(),
            aborted: false,
        });
    }

    pub fn abort(&mut self, mailbox: u8) {
        let before = self.pending.len();
        self.pending.retain(|p| p.mailbox != mailbox);
        self.statistics.given_up += (before - self.pending.len()) as u64;
        if let Some((sending, _)) = &mut self.sending
            && sending.mailbox == mailbox
        {
            sending.aborted = true;
        }
    }

    /// Takes the pending mailbox of highest priority; `None` if no mailbox may be sent.
    fn choose(&mut self) -> Option<Pending> {
        if !self.can_send() {
            return None;
        }
        let waiting = self.pending.iter().enumerate();
        let (place, _) = waiting.min_by_key(|(_, p)| (p.frame.priority(), p.mailbox))?;
        Some(self.pending.swap_remove(place))
    }

    /// Samples a bit; afterwards [`Self::dominant`] is true if the controller drives dominant in the next bit.
    pub fn sample(&mut self, dominant: bool, now: Time) {
        let drove = std::mem::take(&mut self.dominant);
        match self.state {
            State::Out => {}
            State::Joining(count) => self.joining(count, dominant),
            State::BusOff(count, sequences) => self.bus_off(count, sequences, dominant),
            State::Idle => self.between(dominant, now, true),
            State::Frame => self.frame(drove, dominant, now),
            State::Flag(count) => self.flag(count, dominant),
            State::Await(count) => self.wait(count, dominant),
            State::Delimiter(count) => self.delimiter(count, dominant),
            State::Intermission(count) => self.intermission(count, dominant, now),
            State::Suspend(count) if dominant || count + 1 == SUSPEND => {
                self.between(dominant, now, !dominant);
            }
            State::Suspend(count) => self.state = State::Suspend(count + 1),
        }
    }

    fn joining(&mut self, count: u8, dominant: bool) {
        let count = if dominant { 0 } else { count + 1 };
        self.state = State::Joining(count);
        if count == IDLE_BITS {
            self.state = if self.tec >= OFF {
                State::BusOff(0, 0)
            } else {
                State::Idle
            };
            self.events.push(EventKind::Joined);
        }
    }

    fn bus_off(&mut self, count: u8, sequences: u8, dominant: bool) {
        if !self.recovers() {
            return;
        }
        let count = if dominant { 0 } else { count + 1 };
        self.state = State::BusOff(count, sequences);
        if count == IDLE_BITS {
            self.state = State::BusOff(0, sequences + 1);
            if sequences + 1 == RECOVERY {
                (self.tec, self.rec, self.off) = (0, 0, false);
                self.state = State::Idle;
                self.events.push(EventKind::Recovered);
            }
        }
    }

    /// Handles a bit in which a frame may begin.
    fn between(&mut self, dominant: bool, now: Time, may: bool) {
        self.state = State::Idle;
        let chosen = if may { self.choose() } else { None };
        if dominant {
            self.begin(now, None);
            self.receiver.step(true);
            if let Some(pending) = chosen {
                self.take(pending, 1);
            }
        } else if let Some(pending) = chosen {
            self.begin(now, None);
            self.take(pending, 0);
        }
    }

    fn begin(&mut self, now: Time, sending: Option<(Pending, u8)>) {
        self.state = State::Frame;
        self.receiver = Receiver::default();
        self.sending = sending;
        self.sender = false;
        self.start = now;
    }

    fn take(&mut self, pending: Pending, next: u8) {
        self.sending = Some((pending, next));
        self.sender = true;
        self.dominant = !pending.bits.recessive(next.into());
        self.events.push(EventKind::Started {
            mailbox: pending.mailbox,
        });
    }

    fn frame(&mut self, drove: bool, dominant: bool, now: Time) {
        if self.receiver.count() == 0 {
            self.start = now;
        }
        if self.sending.is_some() {
            self.send(dominant);
        } else {
            self.receive(drove, dominant);
        }
    }

    /// Handles a bit of a transmitted frame.
    fn send(&mut self, dominant: bool) {
        let Some((pending, place)) = self.sending else {
            return;
        };
        let (bits, at) = (&pending.bits, usize::from(place));
        let sent = !bits.recessive(at);
        let acknowledges = at == bits.acknowledgement();
        if acknowledges {
            if !dominant {
                return self.error(ErrorKind::Acknowledgement);
            }
        } else if sent != dominant {
            if sent {
                return self.error(ErrorKind::BitDominant);
            }
            if !bits.is_arbitration(at) {
                return self.error(ErrorKind::BitRecessive);
            }
            if bits.is_stuff_bit(at) {
                return self.error(ErrorKind::Stuff);
            }
            self.statistics.arbitrations_lost += 1;
            self.sender = false;
            self.failed(None);
            return self.receive(false, dominant);
        }
        self.receiver.step(dominant);
        if at + 1 == bits.length() {
            return self.sent(pending);
        }
        self.dominant = !bits.recessive(at + 1);
        self.sending = Some((pending, place + 1));
    }

    fn sent(&mut self, pending: Pending) {
        self.sending = None;
        self.tec = self.tec.saturating_sub(1);
        self.statistics.sent += 1;
        self.ended = Some(Ended {
            frame: pending.frame,
            start: self.start,
            error: None,
        });
        self.events.push(EventKind::Sent {
            mailbox: pending.mailbox,
            start: self.start,
        });
        self.rest();
    }

    /// Begins the intermission.
    fn rest(&mut self) {
        self.state = State::Intermission(0);
        if self.leaving {
            self.out();
        }
    }

    /// Returns the mailbox to the queue after an error or a lost arbitration, unless it was aborted.
    fn failed(&mut self, error: Option<ErrorKind>) {
        let Some((pending, _)) = self.sending.take() else {
            return;
        };
        let again = !pending.aborted;
        if again {
            self.pending.push(pending);
        } else {
            self.statistics.given_up += 1;
        }
        if error.is_some() {
            self.ended = Some(Ended {
                frame: pending.frame,
                start: self.start,
                error,
            });
        }
        self.events.push(EventKind::Failed {
            mailbox: pending.mailbox,
            lost: error.is_none(),
            again,
        });
    }

    fn received(&mut self) {
        self.statistics.received += 1;
        self.events.push(EventKind::Received {
            frame: self.receiver.frame(),
            start: self.start,
        });
    }

    /// Handles a bit of a received frame.
    fn receive(&mut self, drove: bool, dominant: bool) {
        if drove && !dominant {
            return self.error(ErrorKind::BitDominant);
        }
        match self.receiver.step(dominant) {
            ReceiverStep::More => {}
            ReceiverStep::Acknowledge => self.dominant = true,
            ReceiverStep::Valid => {
                self.rec = match self.rec {
                    0 => 0,
                    1..=PASSIVE => self.rec - 1,
                    // The standard allows 119 to 127; the bxCAN uses 120.
                    _ => 120,
                };
                self.received();
            }
            ReceiverStep::End => self.rest(),
            ReceiverStep::Overload => self.raise(Flag::Overload),
            ReceiverStep::Error(kind) => self.error(kind),
        }
    }

    fn intermission(&mut self, count: u8, dominant: bool, now: Time) {
        match (dominant, count) {
            (true, 0 | 1) => self.raise(Flag::Overload),
            (false, 0 | 1) => self.state = State::Intermission(count + 1),
            (false, _) if self.sender && self.passive() => self.state = State::Suspend(0),
            (_, _) => self.between(dominant, now, !(self.sender && self.passive())),
        }
    }
}
