//! The protocol as one controller runs it, bit by bit: arbitration, sending, receiving, errors and
//! their counters (ISO 11898-1; where that leaves room, as the bxCAN does).

mod errors;

use crate::time::Time;
use crate::wire::frame::{Bits, Frame};
use crate::wire::node::{ErrorKind, Settings, What};
use crate::wire::receiver::{Receiver, Step};
use crate::wire::statistics::Statistics;

/// Recessive bits after which a controller takes part.
const IDLE_BITS: u8 = 11;
/// How often these must be seen to come back from bus-off.
const RECOVERY: u8 = 128;
/// Bits of a flag.
const FLAG: u8 = 6;
/// Bits of a delimiter.
const DELIMITER: u8 = 8;
/// Bits that an error-passive sender waits after the intermission.
const SUSPEND: u8 = 8;
/// Counters from here on make a controller error-passive.
const PASSIVE: u16 = 128;
/// A transmit counter from here on takes it off the bus.
const OFF: u16 = 256;

/// A mailbox that is to be sent.
#[derive(Clone, Copy, Debug)]
struct Pending {
    mailbox: u8,
    frame: Frame,
    bits: Bits,
    aborted: bool,
}

/// What a controller is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// Not on the bus.
    #[default]
    Out,
    /// Counts recessive bits before it takes part.
    Joining(u8),
    /// Off the bus by its errors: recessive bits in a row, and how often eleven of them.
    BusOff(u8, u8),
    /// Nothing goes on.
    Idle,
    /// A frame, sent or received.
    Frame,
    /// Sends a flag, bits so far.
    Flag(u8),
    /// Waits for the others' flags to end, dominant bits so far.
    Await(u8),
    /// Recessive bits of a delimiter so far.
    Delimiter(u8),
    /// Bits of the intermission so far.
    Intermission(u8),
    /// Bits of a passive sender's waiting so far.
    Suspend(u8),
}

/// What a flag is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Flag {
    #[default]
    Active,
    Passive,
    Overload,
}

/// A sending that ended, for the record of the wire.
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
    /// Of the six equal bits of a passive flag: the last level.
    flag_level: bool,
    /// A passive sender met no acknowledgement: only a dominant bit in its flag counts.
    spared: bool,
    /// It sent the frame that goes on or went on last.
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
    /// What it drives in the next bit.
    pub dominant: bool,
    /// What happened at the last sample.
    pub happened: Vec<What>,
    /// What it sent and how that ended.
    pub ended: Option<Ended>,
    pub statistics: Statistics,
}

impl Controller {
    /// Error counters as they are shown.
    pub fn counters(&self) -> (u8, u8) {
        // Off the bus the bxCAN shows the last value that fits.
        let tec = if self.tec >= OFF { OFF - 8 } else { self.tec };
        (tec as u8, self.rec as u8)
    }

    /// Whether it samples at all.
    pub fn is_in(&self) -> bool {
        self.state != State::Out
    }

    /// Up to when it does nothing on a bus that stays recessive.
    pub fn quiet_until(&self) -> Time {
        match self.state {
            State::Out => Time::NEVER,
            State::BusOff(..) if !self.recovers() => Time::NEVER,
            State::Idle if self.pending.is_empty() || !self.can_send() => Time::NEVER,
            _ => Time(0),
        }
    }

    /// Whether a frame goes on, or what follows one.
    pub fn is_busy(&self) -> bool {
        !matches!(
            self.state,
            State::Out | State::Idle | State::Joining(_) | State::BusOff(..)
        )
    }

    /// Whether it is in the middle of something that new requests do not change.
    pub fn is_closed(&self) -> bool {
        match self.state {
            State::Frame => self.receiver.count() >= 2,
            State::Flag(_) | State::Await(_) | State::Delimiter(_) => true,
            _ => false,
        }
    }

    /// Whether an edge begins a bit anew.
    pub fn is_hard(&self) -> bool {
        !matches!(
            self.state,
            State::Frame | State::Flag(_) | State::Await(_) | State::Delimiter(_)
        )
    }

    /// The settings while it takes part.
    pub fn settings(&self) -> Option<&Settings> {
        self.settings.as_ref()
    }

    /// The frame that it sends, and the bit that comes next.
    pub fn sending(&self) -> Option<(&Bits, usize)> {
        let (pending, place) = self.sending.as_ref()?;
        Some((&pending.bits, usize::from(*place)))
    }

    /// What has arrived of the frame that goes on.
    pub fn arrived(&self) -> &Receiver {
        &self.receiver
    }

    /// Whether it receives a frame of which so much has arrived, and does nothing else.
    pub fn follows(&self, arrived: &Receiver) -> bool {
        let receives = self.state == State::Frame && self.sending.is_none();
        receives && !self.dominant && self.receiver == *arrived
    }

    /// So much has arrived now of a frame without errors; a sender goes on with this bit.
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

    /// Cut off by a reset.
    pub fn reset(&mut self) {
        *self = Self {
            statistics: self.statistics,
            ..Self::default()
        };
    }

    /// Takes part in another way.
    pub fn set(&mut self, settings: Settings) {
        let was_in = self.is_in();
        match (was_in, settings.on) {
            (false, true) => {
                self.settings = Some(settings);
                self.leaving = false;
                self.state = State::Joining(0);
                // To leave and to come back is the program's way to begin the recovery.
                if self.tec >= OFF {
                    self.off = false;
                }
            }
            (false, false) => {
                self.settings = Some(settings);
                self.happened.push(What::Left);
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
        self.happened.push(What::Left);
    }

    /// A mailbox is to be sent.
    pub fn request(&mut self, mailbox: u8, frame: Frame) {
        self.pending.retain(|p| p.mailbox != mailbox);
        self.pending.push(Pending {
            mailbox,
            frame,
            bits: frame.bits(),
            aborted: false,
        });
    }

    /// A mailbox is not to be sent.
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

    /// The mailbox that goes first of those requested.
    fn choose(&mut self) -> Option<Pending> {
        if !self.can_send() {
            return None;
        }
        let waiting = self.pending.iter().enumerate();
        let (place, _) = waiting.min_by_key(|(_, p)| (p.frame.priority(), p.mailbox))?;
        Some(self.pending.swap_remove(place))
    }

    /// Samples a bit. The level to drive in the next bit is then in [`Self::dominant`].
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
            self.happened.push(What::Joined);
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
                self.happened.push(What::Recovered);
            }
        }
    }

    /// A bit in which a frame may begin.
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
        self.happened.push(What::Started {
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

    /// A bit of a frame that is sent.
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
        self.happened.push(What::Sent {
            mailbox: pending.mailbox,
            start: self.start,
        });
        self.rest();
    }

    /// The intermission begins.
    fn rest(&mut self) {
        self.state = State::Intermission(0);
        if self.leaving {
            self.out();
        }
    }

    /// Gives the mailbox back, by an error or a lost arbitration.
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
        self.happened.push(What::Failed {
            mailbox: pending.mailbox,
            lost: error.is_none(),
            again,
        });
    }

    fn received(&mut self) {
        self.statistics.received += 1;
        self.happened.push(What::Received {
            frame: self.receiver.frame(),
            start: self.start,
        });
    }

    /// A bit of a frame that is received.
    fn receive(&mut self, drove: bool, dominant: bool) {
        if drove && !dominant {
            return self.error(ErrorKind::BitDominant);
        }
        match self.receiver.step(dominant) {
            Step::More => {}
            Step::Acknowledge => self.dominant = true,
            Step::Valid => {
                self.rec = match self.rec {
                    0 => 0,
                    1..=PASSIVE => self.rec - 1,
                    // The bxCAN's choice among 119 to 127.
                    _ => 120,
                };
                self.received();
            }
            Step::End => self.rest(),
            Step::Overload => self.raise(Flag::Overload),
            Step::Error(kind) => self.error(kind),
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
