//! Pattern of a board's LED: the operating state of its node, and in fault the code.

use core::fmt;

use crate::bus::Message;
use crate::safety::OperatingState;
use crate::topology::Node;

/// Duration of a beat, ms. A digit n is n blinks of two beats: one lit, one dark.
const BEAT_MS: u32 = 200;
/// Dark beats between two digits.
const GAP: u32 = 4;
/// Dark beats after the last digit.
const PAUSE: u32 = 10;

/// Pattern of each state except fault: time lit and period, ms.
const PATTERNS: [(OperatingState, u32, u32); 5] = [
    (OperatingState::Boot, 500, 1000),
    (OperatingState::Idle, 100, 2000),
    (OperatingState::Armed, 250, 500),
    (OperatingState::Active, 1, 1),
    (OperatingState::SafeStop, 100, 200),
];

/// Pattern of a state, for the documentation.
pub struct Pattern(pub OperatingState);

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digit = 2 * BEAT_MS;
        match pattern(self.0) {
            Some((lit, period)) if lit == period => f.write_str("on"),
            Some((lit, period)) => write!(f, "on for {lit} of {period} ms"),
            None => write!(
                f,
                "the code's two hexadecimal digits: digit n is n blinks of {digit} ms; 0 is one blink of {} ms",
                3 * BEAT_MS
            ),
        }
    }
}

fn pattern(state: OperatingState) -> Option<(u32, u32)> {
    let found = PATTERNS.iter().find(|pattern| pattern.0 == state);
    found.map(|&(_, lit, period)| (lit, period))
}

/// State and code on the LED.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Led {
    state: OperatingState,
    code: u8,
}

impl Led {
    /// Takes in a message that the board sends. The heartbeat of its node sets the pattern; the heartbeat of a lead
    /// node on the same board does not count.
    pub fn receive(&mut self, message: &Message) {
        if let Message::NodeStatus {
            node,
            state,
            reason,
            ..
        } = *message
            && node != Node::Lead
        {
            (self.state, self.code) = (state, reason);
        }
    }

    /// True if the LED is lit at `ms`, milliseconds since a fixed instant.
    pub fn is_lit(&self, ms: u32) -> bool {
        match pattern(self.state) {
            Some((lit, period)) => ms % period < lit,
            None => self.blinks(ms / BEAT_MS),
        }
    }

    fn blinks(&self, beat: u32) -> bool {
        let digits = [self.code >> 4, self.code & 0xf];
        // Beats of a digit: lit and dark by turns, or three lit ones for 0.
        let length = |digit: u8| if digit == 0 { 3 } else { 2 * u32::from(digit) };
        let period = digits.map(length).iter().sum::<u32>() + GAP + PAUSE;
        let mut beat = beat % period;
        for digit in digits {
            if beat < length(digit) {
                return digit == 0 || beat.is_multiple_of(2);
            }
            match beat.checked_sub(length(digit) + GAP) {
                Some(after) => beat = after,
                None => return false,
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::testing::beat;

    fn led(node: Node, state: OperatingState, reason: u8) -> Led {
        let mut led = Led::default();
        led.receive(&beat(node, 0, state, reason));
        led
    }

    /// Intervals from 0 to `ms`: true if lit, and duration in s.
    fn stretches(led: Led, ms: u32) -> Vec<(bool, f64)> {
        let mut found: Vec<(bool, f64)> = Vec::new();
        for ms in 0..ms {
            match found.last_mut() {
                Some((lit, length)) if *lit == led.is_lit(ms) => *length += 1e-3,
                _ => found.push((led.is_lit(ms), 1e-3)),
            }
        }
        let rounded = |(lit, length): (bool, f64)| (lit, (length * 10.0).round() / 10.0);
        found.into_iter().map(rounded).collect()
    }

    #[test]
    fn a_fault_blinks_its_code_digit_by_digit() {
        let (on, off) = ((true, 0.2), (false, 0.2));
        let short = led(Node::axle(1), OperatingState::Fault, 0x21);
        // Two blinks, a gap, one blink, the pause, and the first blink of the next round.
        let expected = [on, off, on, (false, 1.0), on, (false, 2.2), on];
        assert_eq!(stretches(short, 4_200), expected);
        let zero = led(Node::beam(0), OperatingState::Fault, 0x10);
        let expected = [on, (false, 1.0), (true, 0.6), (false, 2.0)];
        assert_eq!(stretches(zero, 3_800), expected);
    }

    #[test]
    fn pattern_texts_differ_and_match_the_light() {
        let texts = OperatingState::ALL.map(|state| Pattern(state).to_string());
        assert_eq!(Pattern(OperatingState::Active).to_string(), "on");
        let fault = Pattern(OperatingState::Fault).to_string();
        assert!(fault.contains("of 400 ms"), "{fault}");
        assert!(fault.ends_with("of 600 ms"), "{fault}");
        for (i, state) in OperatingState::ALL.into_iter().enumerate() {
            assert!(!texts[..i].contains(&texts[i]), "{}", texts[i]);
            let led = led(Node::axle(0), state, 0);
            let on = (0..2000).filter(|&ms| led.is_lit(ms)).count();
            let [lit, period] = match texts[i].split(' ').collect::<Vec<_>>()[..] {
                ["on", "for", lit, "of", period, "ms"] => [lit, period].map(|t| t.parse().unwrap()),
                ["on"] => [1, 1],
                _ => continue,
            };
            assert_eq!(on, 2000 / period * lit, "{state:?}");
        }
        assert_eq!(led(Node::Lead, OperatingState::Active, 0), Led::default());
    }
}
