//! What a program does that the chip's manual forbids, or that the model does not know.

use crate::time::Time;
use std::collections::HashMap;
use std::fmt;

/// What sort of thing was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// An instruction or a feature that is not modelled: the run proves nothing from here on.
    NotModelled,
    /// An access to a peripheral whose clock is off.
    ClockGated,
    /// A write that changes a reserved bit.
    ReservedBit,
    /// An access where there is nothing.
    Unmapped,
    /// An access that is not aligned, or not of a width that the register allows.
    Alignment,
    /// A clock beyond its limit, or the wrong number of wait states for it.
    ClockLimit,
    /// A register written at a moment at which it must not be.
    Forbidden,
    /// Data that were lost: overrun, underrun, collision.
    Lost,
    /// A fault of the processor: hard fault, lock-up.
    Fault,
    /// A reset that nobody outside asked for.
    Reset,
    /// A pin that two sides drive, or a peripheral without its pin.
    Pin,
}

impl Kind {
    /// The name in tables and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotModelled => "not modelled",
            Self::ClockGated => "clock off",
            Self::ReservedBit => "reserved bit",
            Self::Unmapped => "unmapped",
            Self::Alignment => "alignment",
            Self::ClockLimit => "clock limit",
            Self::Forbidden => "forbidden",
            Self::Lost => "lost",
            Self::Fault => "fault",
            Self::Reset => "reset",
            Self::Pin => "pin",
        }
    }
}

/// One thing that was found, with the place in the program and how often it happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What sort of thing.
    pub kind: Kind,
    /// What it is, in words.
    pub text: String,
    /// Program counter at the first time.
    pub pc: u32,
    /// The first time.
    pub at: Time,
    /// How often.
    pub count: u64,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            kind,
            text,
            pc,
            at,
            count,
        } = self;
        write!(f, "{at}, pc {pc:#010x}: {}: {text}", kind.name())?;
        if *count > 1 {
            write!(f, " ({count} times)")?;
        }
        Ok(())
    }
}

/// Findings of a board. One place in the program and one text make one finding.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    list: Vec<Finding>,
    index: HashMap<(Kind, u32, String), usize>,
}

impl Findings {
    /// Notes something.
    #[cold]
    pub fn note(&mut self, kind: Kind, pc: u32, at: Time, text: impl Into<String>) {
        let text = text.into();
        let next = self.list.len();
        let place = *self.index.entry((kind, pc, text.clone())).or_insert(next);
        match self.list.get_mut(place) {
            Some(known) => known.count += 1,
            None => self.list.push(Finding {
                kind,
                text,
                pc,
                at,
                count: 1,
            }),
        }
    }

    /// What was found, in the order of the first times.
    pub fn list(&self) -> &[Finding] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_again_at_the_same_place_is_counted() {
        let mut findings = Findings::default();
        for (pc, time) in [(8, 1), (8, 2), (12, 3)] {
            findings.note(Kind::ClockGated, pc, Time(time), "SPI1");
        }
        let counts: Vec<_> = findings
            .list()
            .iter()
            .map(|f| (f.pc, f.at.0, f.count))
            .collect();
        assert_eq!(counts, [(8, 1, 2), (12, 3, 1)]);
    }
}
