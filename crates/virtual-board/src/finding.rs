//! Findings: actions of a program that the chip's manual forbids or that are not modelled.

use crate::time::Time;
use std::collections::HashMap;
use std::fmt;

/// Kind of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FindingKind {
    /// An instruction or a feature that is not modelled: results after this finding are not reliable.
    NotModelled,
    /// An access to a peripheral whose clock is off.
    ClockGated,
    /// A write that changes a reserved bit.
    ReservedBit,
    /// An access to an address without memory or register.
    Unmapped,
    /// An unaligned access, or a width that the register does not allow.
    Alignment,
    /// A clock beyond its limit, or wrong wait states for the clock.
    ClockLimit,
    /// An access that the manual forbids in the present state.
    Forbidden,
    /// Lost data: overrun, underrun, collision.
    Lost,
    /// A fault of the core: hard fault, lock-up.
    Fault,
    /// A reset without an external cause.
    Reset,
    /// A pin with conflicting drivers, a floating pin that is read, or a peripheral without its pin.
    Pin,
}

impl FindingKind {
    /// Name in tables and in JSON.
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

/// One finding, with its place in the program and its number of occurrences.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Kind of the finding.
    pub kind: FindingKind,
    /// Description of the program's action, without time and address.
    pub text: String,
    /// Program counter at the first occurrence.
    pub pc: u32,
    /// Time of the first occurrence.
    pub at: Time,
    /// Number of occurrences.
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

/// Findings of a board. Occurrences with the same place in the program and the same text are one finding.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    list: Vec<Finding>,
    index: HashMap<(FindingKind, u32, String), usize>,
}

impl Findings {
    /// Records an occurrence of a finding.
    #[cold]
    pub fn note(&mut self, kind: FindingKind, pc: u32, at: Time, text: impl Into<String>) {
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

    /// Findings in the order of their first occurrences.
    pub fn list(&self) -> &[Finding] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_finding_at_the_same_place_is_counted() {
        let mut findings = Findings::default();
        for (pc, time) in [(8, 1), (8, 2), (12, 3)] {
            findings.note(FindingKind::ClockGated, pc, Time(time), "SPI1");
        }
        let counts: Vec<_> = findings
            .list()
            .iter()
            .map(|f| (f.pc, f.at.0, f.count))
            .collect();
        assert_eq!(counts, [(8, 1, 2), (12, 3, 1)]);
    }
}
