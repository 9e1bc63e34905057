//! Errors: flags, delimiters, counters, bus-off.

use super::{Controller, DELIMITER, FLAG, Flag, OFF, State};
use crate::wire::node::{ErrorKind, EventKind};

impl Controller {
    pub(super) fn raise(&mut self, flag: Flag) {
        match flag {
            Flag::Active | Flag::Passive => self.statistics.error_frames += 1,
            Flag::Overload => self.statistics.overloads += 1,
        }
        self.flag = flag;
        self.state = State::Flag(0);
        self.dominant = flag != Flag::Passive;
    }

    /// Counts an error that was detected outside an error flag, and begins an error flag with the next bit.
    pub(super) fn error(&mut self, kind: ErrorKind) {
        self.statistics.errors[kind as usize] += 1;
        let passive = self.passive();
        self.uncounted_ack_error = false;
        if !self.sender {
            self.rec += 1;
        } else if kind == ErrorKind::Acknowledgement && passive {
            self.uncounted_ack_error = true;
        } else if kind != ErrorKind::Stuff {
            // A sender detects a stuff error only in the arbitration field, where the standard does not count it.
            self.tec += 8;
        }
        self.failed(Some(kind));
        self.events.push(EventKind::Error(kind));
        self.raise(if passive { Flag::Passive } else { Flag::Active });
        self.limit();
    }

    /// Adds 8 to the transmit counter of a sender or to the receive counter of a receiver; begins no error flag.
    pub(super) fn count(&mut self) {
        if self.sender {
            self.tec += 8;
        } else {
            self.rec += 8;
        }
        self.events.push(EventKind::Counted);
        self.limit();
    }

    pub(super) fn limit(&mut self) {
        self.rec = self.rec.min(255);
        if self.tec >= OFF {
            self.tec = OFF;
            self.off = true;
            self.dominant = false;
            self.statistics.bus_offs += 1;
            self.state = State::BusOff(0, 0);
            self.events.push(EventKind::Off);
            if self.leaving {
                self.out();
            }
        }
    }

    pub(super) fn flag(&mut self, count: u8, dominant: bool) {
        if self.flag == Flag::Passive {
            return self.passive_flag(count, dominant);
        }
        if !dominant {
            let kind = ErrorKind::BitDominant;
            self.statistics.errors[kind as usize] += 1;
            self.events.push(EventKind::Error(kind));
            let passive = self.passive();
            self.raise(if passive { Flag::Passive } else { Flag::Active });
            return self.count();
        }
        self.dominant = count + 1 < FLAG;
        self.state = if self.dominant {
            State::Flag(count + 1)
        } else {
            State::Await(0)
        };
    }

    /// Handles a bit of a passive error flag, which ends after six equal bits of either level.
    pub(super) fn passive_flag(&mut self, count: u8, dominant: bool) {
        let equal = count > 0 && dominant == self.flag_level;
        let count = if equal { count + 1 } else { 1 };
        self.flag_level = dominant;
        self.state = if count == FLAG {
            State::Await(0)
        } else {
            State::Flag(count)
        };
        if dominant && std::mem::take(&mut self.uncounted_ack_error) {
            self.count();
        }
    }

    pub(super) fn wait(&mut self, count: u8, dominant: bool) {
        if !dominant {
            self.state = State::Delimiter(1);
            return;
        }
        self.state = State::Await(count % 8 + 1);
        let first = count == 0 && self.flag != Flag::Overload && !self.sender;
        if first || count == 7 {
            self.count();
        }
    }

    pub(super) fn delimiter(&mut self, count: u8, dominant: bool) {
        match (dominant, count + 1) {
            (true, DELIMITER) => self.raise(Flag::Overload),
            (true, _) => self.error(ErrorKind::Form),
            (false, DELIMITER) => self.rest(),
            (false, count) => self.state = State::Delimiter(count),
        }
    }
}
