//! Frames of the bus: a decoded message is encoded to an equivalent frame; the error of a message that cannot be
//! encoded names the signal.
#![no_main]

use cfmmr_fuzz::numbers::Bytes;
use core_algos::bus::layout::{self, MESSAGES};
use core_algos::bus::{CanFrame, DecodeError, Message, decode, encode};
use core_algos::math::Posture;
use libfuzzer_sys::fuzz_target;
use std::f64::consts::TAU;

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    match bytes.byte() % 4 {
        0 => received(&CanFrame {
            id: u16::from_le_bytes(bytes.array()),
            length: bytes.byte(),
            data: bytes.array(),
        }),
        1 | 2 => {
            let layout = &MESSAGES[usize::from(bytes.byte()) % MESSAGES.len()];
            received(&CanFrame {
                id: layout.id,
                length: layout.bytes(),
                data: bytes.array(),
            });
        }
        _ => {
            if let Ok(message) = postcard::from_bytes(bytes.0) {
                sent(&message);
            }
        }
    }
});

fn received(frame: &CanFrame) {
    let known = layout::find(frame.id);
    let message = match decode(frame) {
        Ok(message) => message,
        Err(DecodeError::UnknownId(id)) => return assert!(id == frame.id && known.is_none()),
        Err(DecodeError::Length {
            id,
            found,
            expected,
        }) => {
            let right = known.map(|layout| layout.bytes());
            assert!(id == frame.id && found == frame.length && right == Some(expected));
            return assert_ne!(found, expected);
        }
        Err(DecodeError::Value { id }) => {
            let signals = known.map_or(&[][..], |layout| layout.signals);
            return assert!(
                id == frame.id && signals.iter().any(|signal| !signal.labels.is_empty())
            );
        }
    };
    let again = encode(&message).expect("what was received can be sent");
    assert_eq!((again.id, again.length), (frame.id, frame.length));
    settles(message, again);
}

/// Checks that rounding happens once: decoding and encoding a rounded message changes nothing.
fn settles(message: Message, frame: CanFrame) {
    let back = decode(&frame).expect("what was sent can be received");
    let uncertain = |m: &Message| {
        matches!(
            m,
            Message::AxleUncertainty { .. } | Message::BeamUncertainty { .. }
        )
    };
    if uncertain(&message) {
        // Standard deviations are sent as logarithms, and correlations are reduced until the matrix is definite, so
        // values may change.
        assert!(uncertain(&back));
        assert_eq!(encode(&back).map(|again| again.id), Ok(frame.id));
    } else if let (Some(sent), Some(read)) = (posture(&message), posture(&back)) {
        // Headings beyond half a turn are wrapped.
        assert_eq!((sent.x, sent.y), (read.x, read.y));
        let turned = f64::from(sent.phi - read.phi).rem_euclid(TAU);
        assert!(turned.min(TAU - turned) <= 1e-4, "{sent:?} {read:?}");
    } else {
        assert_eq!(back, message);
        assert_eq!(encode(&back), Ok(frame));
    }
}

fn posture(message: &Message) -> Option<Posture> {
    match *message {
        Message::AxlePosture { posture, .. }
        | Message::ReferencePosture { posture, .. }
        | Message::BeamPosture { posture, .. } => Some(posture),
        _ => None,
    }
}

fn sent(message: &Message) {
    match encode(message) {
        Ok(frame) => {
            let layout = layout::find(frame.id).expect("an identifier of the table");
            assert_eq!(frame.length, layout.bytes());
            assert!(
                frame.data[usize::from(frame.length)..]
                    .iter()
                    .all(|&byte| byte == 0)
            );
            let rounded = decode(&frame).expect("what was sent can be received");
            settles(
                rounded,
                encode(&rounded).expect("what was received can be sent"),
            );
        }
        Err(error) => {
            if (error.message, error.signal) == ("Message", "sender") {
                // The sender is an axle or frame that no robot has, or a status is from a service tool.
                return;
            }
            let layout = MESSAGES.iter().find(|layout| layout.name == error.message);
            let layout = layout.expect("the error names a message");
            let signal = layout
                .signals
                .iter()
                .find(|signal| signal.name == error.signal);
            let (low, high) = signal.expect("the error names a signal").range();
            let within = error.value > low && error.value < high;
            assert!(!within, "{error}: from {low} to {high} is representable");
        }
    }
}
