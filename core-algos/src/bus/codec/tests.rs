use super::*;
use crate::bus::field::{POSITION_SPAN_M, wrap_position};
use crate::math::matrix::cholesky;
use crate::math::matrix::is_finite;
use crate::math::{Posture, Wrench};
use crate::topology::{AxleId, FrameId, Topology};
use proptest::prelude::*;

/// Signals that are not enumerations, each with its message.
fn quantities() -> impl Iterator<Item = (&'static Signal, &'static layout::Layout)> {
    layout::MESSAGES.iter().flat_map(|layout| {
        let signals = layout.signals.iter();
        signals
            .filter(|signal| signal.labels.is_empty())
            .map(move |signal| (signal, layout))
    })
}

/// Bounds of the values that are rounded into the range: half a unit beyond the range, in double precision.
fn bounds(signal: &Signal) -> [f64; 2] {
    let (low, high) = signal.raw_range();
    let (scale, offset) = (f64::from(signal.scale), f64::from(signal.offset));
    [f64::from(low) - 0.5, f64::from(high) + 0.5].map(|raw| raw * scale + offset)
}

fn range_holds(signal: &Signal, value: f32) -> bool {
    let [low, high] = bounds(signal);
    (low..high).contains(&f64::from(value))
}

/// True if the value is so close to a bound that single precision may decide either way.
fn at_a_bound(signal: &Signal, value: f32) -> bool {
    bounds(signal)
        .iter()
        .any(|bound| (f64::from(value) - bound).abs() <= 1e-6 * bound.abs())
}

fn round_trip(message: Message) -> Message {
    decode(&encode(&message).unwrap()).unwrap()
}

properties! {
    #[test]
    fn posture_survives_to_half_a_unit(
        x in -5.2f32..5.2, y in -5.2f32..5.2, phi in -3.1f32..3.1, sequence: u8,
    ) {
        for axle in [AxleId(0), AxleId(1)] {
            let sent = Posture::new(x, y, phi);
            let received = round_trip(Message::AxlePosture { axle, sequence, posture: sent });
            let Message::AxlePosture { axle: a, sequence: s, posture } = received else {
                panic!("{received:?}");
            };
            prop_assert_eq!((a, s), (axle, sequence));
            let [dx, dy, dphi] = posture.minus(sent);
            prop_assert!(dx.abs() < 6e-6 && dy.abs() < 6e-6 && dphi.abs() < 5.1e-5);
        }
    }

    #[test]
    fn position_differences_survive_wrapping(x in -40.0f32..40.0, step in -0.01f32..0.01) {
        let sent = |x| match round_trip(Message::AxlePosture {
            axle: AxleId(1), sequence: 0, posture: Posture::new(x, 0.0, 0.0),
        }) {
            Message::AxlePosture { posture, .. } => posture.x,
            _ => f32::NAN,
        };
        let difference = wrap_position(sent(x + step) - sent(x));
        prop_assert!((difference - step).abs() < 1.6e-5);
    }

    #[test]
    fn covariance_stays_positive_definite_and_within_2_percent(
        l in proptest::array::uniform3(proptest::array::uniform3(-1.0f32..1.0)),
        exponent in -7.0f32..-1.0,
    ) {
        let size = exponent.exp2() * 1e-3;
        let mut m = crate::math::matrix::propagate(&l, &crate::math::matrix::identity());
        for i in 0..3 {
            m[i][i] += 1e-3;
            for j in 0..3 {
                m[i][j] *= size * size;
            }
        }
        for i in 0..3 {
            m[i][i] *= 1.0001;
        }
        let Message::BeamUncertainty { covariance, .. } =
            round_trip(Message::BeamUncertainty { frame: FrameId(0), sequence: 1, covariance: m }) else {
            panic!("another message");
        };
        prop_assert!(cholesky(&covariance).is_some());
        for i in 0..3 {
            let ratio = covariance[i][i] / m[i][i];
            prop_assert!((0.975..1.025).contains(&ratio), "{}", ratio);
        }
    }

    #[test]
    fn positions_around_the_end_of_the_span_are_sent(turns in -3i32..3, step in -2e-5f32..2e-5) {
        let x = (turns as f32 + 0.5) * POSITION_SPAN_M + step;
        let Message::AxlePosture { posture, .. } = round_trip(Message::AxlePosture {
            axle: AxleId(0), sequence: 0, posture: Posture::new(x, -x, 0.0),
        }) else {
            panic!("another message");
        };
        // Far from the origin an f32 position has a coarser resolution.
        let resolution = 1e-5 + x.abs() * f32::EPSILON;
        prop_assert!(wrap_position(posture.x - wrap_position(x)).abs() <= resolution);
        prop_assert!(wrap_position(posture.y - wrap_position(-x)).abs() <= resolution);
    }

    #[test]
    fn value_of_any_signal_is_refused_or_rounded_to_the_nearest_unit(bits: u32, small in -40.0f32..40.0) {
        for value in [f32::from_bits(bits), small] {
            for (signal, layout) in quantities() {
                match (to_raw(signal, value), range_holds(signal, value)) {
                    (Some(raw), true) => {
                        let off = f64::from(raw) * f64::from(signal.scale)
                            + f64::from(signal.offset) - f64::from(value);
                        let unit = f64::from(signal.scale);
                        // Half a unit, and the rounding of the quotient in single precision.
                        let slack = 0.5 * unit + 1e-6 * f64::from(value.abs() + signal.offset.abs());
                        prop_assert!(off.abs() <= slack, "{} {}", layout.name, signal.name);
                    }
                    (None, false) => {}
                    (raw, _) => prop_assert!(
                        at_a_bound(signal, value), "{} {} {value} {raw:?}", layout.name, signal.name
                    ),
                }
            }
        }
    }

    /// Decoded and encoded again, every valid frame is the same frame.
    #[test]
    fn frames_survive_decoding_and_encoding(draws: [u32; crate::bus::field::MAX_SIGNALS]) {
        for layout::OnBus { id, layout, .. } in layout::messages(Topology::new(5).unwrap()) {
            let mut bits = 0u64;
            let mut position = 0;
            for (signal, draw) in layout.signals.iter().zip(draws) {
                let (low, high) = if signal.name == "phi" {
                    // The bus carries headings within half a turn.
                    (-31_415, 31_415)
                } else {
                    signal.raw_range()
                };
                let raw = i64::from(low) + i64::from(draw) % (i64::from(high) - i64::from(low) + 1);
                bits |= (raw as u64 & ((1 << signal.bits) - 1)) << position;
                position += u32::from(signal.bits);
            }
            let frame = CanFrame { id, length: layout.bytes(), data: bits.to_le_bytes() };
            let message = decode(&frame);
            prop_assert!(message.is_ok(), "{message:?}");
            // A covariance is rebuilt positive definite, so its correlations may change.
            if layout.signals.last().is_some_and(|signal| signal.name != "correlation_yphi") {
                prop_assert_eq!(encode(&message.unwrap()), Ok(frame));
            }
        }
    }
}

properties! {
    cases 20_000;

    /// Half of the drawn frames have an identifier of the table.
    #[test]
    fn any_frame_decodes_or_is_refused(
        id in prop_oneof![
            any::<u16>(),
            (0..layout::MESSAGES.len()).prop_map(|k| layout::MESSAGES[k].id),
        ],
        length in 0u8..10,
        data: [u8; 8],
    ) {
        let known = layout::find(id);
        match decode(&CanFrame { id, length, data }) {
            // A decoded message is finite and can be encoded.
            Ok(message) => {
                prop_assert_eq!(known.map(|layout| layout.bytes()), Some(length));
                match message {
                    Message::AxleUncertainty { covariance, .. }
                    | Message::BeamUncertainty { covariance, .. } => {
                        prop_assert!(is_finite(&covariance));
                    }
                    other => prop_assert!(encode(&other).is_ok()),
                }
            }
            Err(DecodeError::UnknownId(_)) => prop_assert!(known.is_none()),
            Err(DecodeError::Length { expected, .. }) => prop_assert_ne!(expected, length),
            Err(DecodeError::Value { .. }) => {
                let signals = known.map_or(&[][..], |layout| layout.signals);
                prop_assert!(signals.iter().any(|signal| !signal.labels.is_empty()));
            }
        }
    }
}

#[test]
fn nan_infinity_and_value_out_of_range_are_refused_by_name() {
    for bad in [f32::NAN, f32::INFINITY, 9.0] {
        let (sequence, mut wrench) = (0, Wrench::ZERO);
        wrench.moment_root = bad;
        let error = encode(&Message::BeamWrench {
            frame: FrameId(0),
            sequence,
            wrench,
        })
        .unwrap_err();
        assert_eq!((error.message, error.signal), ("BeamWrench", "moment_root"));
    }
    let mut covariance = [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, f32::NAN]];
    let send = |covariance| {
        encode(&Message::BeamUncertainty {
            frame: FrameId(0),
            sequence: 0,
            covariance,
        })
    };
    assert!(send(covariance).is_err());
    covariance[2][2] = -1.0;
    assert!(send(covariance).is_err());
}

/// Rounding may produce correlations that no valid covariance has. They shrink no further than necessary.
#[test]
fn impossible_correlations_shrink_by_3_percent_or_vanish() {
    for (sent, share) in [
        ([1.0, 1.0, 1.0], 0.97),
        ([0.81, 0.6, 0.0], 0.97),
        ([1.0, 1.0, -1.0], 0.0),
    ] {
        let [xy, xp, yp] = sent;
        let unit = [[1.0, xy, xp], [xy, 1.0, yp], [xp, yp, 1.0]];
        let received = round_trip(Message::BeamUncertainty {
            frame: FrameId(0),
            sequence: 1,
            covariance: unit.map(|row| row.map(|c| 1e-6 * c)),
        });
        let Message::BeamUncertainty { covariance: m, .. } = received else {
            panic!("another message");
        };
        for (sent, (i, j)) in sent.into_iter().zip([(0, 1), (0, 2), (1, 2)]) {
            let correlation = m[i][j] / (m[i][i] * m[j][j]).sqrt();
            assert!((correlation - share * sent).abs() < 0.01, "{correlation}");
        }
    }
}

#[test]
fn signal_range_ends_at_the_extreme_raw_values() {
    for (signal, layout) in quantities() {
        let ((low, high), (least, most)) = (signal.range(), signal.raw_range());
        let raw = [to_raw(signal, low), to_raw(signal, high)];
        assert_eq!(raw, [Some(least), Some(most)], "{}", layout.name);
    }
}

/// Tests a temperature, because its unit is 1 °C and halves are exact.
#[test]
fn halves_are_rounded_away_from_zero() {
    let temperature = quantities().map(|(signal, _)| signal);
    let temperature = temperature
        .filter(|signal| signal.unit == "degC")
        .last()
        .unwrap();
    for (value, raw) in [
        (0.5, Some(1)),
        (-0.5, Some(-1)),
        (0.5f32.next_down(), Some(0)),
        (-0.5f32.next_down(), Some(0)),
        (1.5, Some(2)),
        (-2.5, Some(-3)),
        (127.5f32.next_down(), Some(127)),
        (127.5, None),
        (128.0, None),
        (-128.5, None),
        (-129.0, None),
    ] {
        assert_eq!(to_raw(temperature, value), raw, "{value}");
    }
}

/// Both ends of the span are the same position and wrap to the lower end.
#[test]
fn positions_lie_in_the_half_open_span() {
    const HALF: f32 = 0.5 * POSITION_SPAN_M;
    for (x, wrapped) in [
        (HALF, -HALF),
        (-HALF, -HALF),
        (HALF.next_down(), HALF.next_down()),
        (3.0 * HALF, -HALF),
        (-3.0 * HALF, -HALF),
        (1.5 * HALF, -0.5 * HALF),
        (-1.5 * HALF, 0.5 * HALF),
    ] {
        assert_eq!(wrap_position(x), wrapped, "{x}");
    }
    // Up to 0.6 steps below the upper end a position is rounded to the last step; beyond, the lower end is sent.
    let last = HALF - 0.6 * crate::bus::field::POSITION_STEP_M;
    for (x, sent) in [(last, HALF - 1e-5), (last.next_up(), -HALF)] {
        let posture = Posture::new(x, x, 0.0);
        let message = Message::AxlePosture {
            axle: AxleId(0),
            sequence: 0,
            posture,
        };
        let Message::AxlePosture { posture, .. } = round_trip(message) else {
            panic!("another message");
        };
        assert!(
            (posture.x - sent).abs() < 1e-6 && (posture.y - sent).abs() < 1e-6,
            "{x}"
        );
    }
}

/// The smallest transmitted standard deviation is 2e-9.
#[test]
fn a_covariance_of_zero_is_sent() {
    let Message::BeamUncertainty { covariance, .. } = round_trip(Message::BeamUncertainty {
        frame: FrameId(0),
        sequence: 1,
        covariance: [[0.0; 3]; 3],
    }) else {
        panic!("another message");
    };
    for i in 0..3 {
        let sigma = covariance[i][i].sqrt();
        assert!((sigma / 2e-9 - 1.0).abs() < 0.011, "{sigma:e}");
    }
}

/// Published vectors of FNV-1a (0x811c9dc5, 0xe40c292c, 0xbf9cf968), folded to 24 bits.
#[test]
fn hashes_have_their_published_values() {
    use crate::bus::field::Hash24;
    for (text, hash) in [("", 0x1c9d44), ("a", 0x0c29c8), ("foobar", 0x9cf9d7)] {
        assert_eq!(Hash24::of(text.as_bytes()), Hash24(hash), "{text}");
    }
    for (text, hash) in [("axle 0.1.0 1a2b3c4d", 0x1a2b3c), ("axle", 0), ("", 0)] {
        assert_eq!(Hash24::of_build(text), Hash24(hash), "{text}");
    }
}

#[test]
fn unknown_and_short_frames_are_refused() {
    let frame = |id, length| CanFrame {
        id,
        length,
        data: [0; 8],
    };
    assert_eq!(decode(&frame(0x125, 8)), Err(DecodeError::UnknownId(0x125)));
    let (id, found, expected) = (0x100, 7, 8);
    let short = DecodeError::Length {
        id,
        found,
        expected,
    };
    assert_eq!(decode(&frame(id, found)), Err(short));
    // Each enumeration: the last label is decoded, the next number is refused.
    for layout in &layout::MESSAGES {
        let mut at = 0;
        for signal in layout.signals {
            for k in [0, 1].into_iter().filter(|_| !signal.labels.is_empty()) {
                let mut frame = frame(layout.id, layout.bytes());
                frame.data = ((signal.labels.len() as u64 - 1 + k) << at).to_le_bytes();
                let refused = Err(DecodeError::Value { id: layout.id });
                assert_eq!(decode(&frame) == refused, k == 1, "{}", layout.name);
            }
            at += signal.bits;
        }
    }
}

/// Frames of five axles and four strips exist; the identifier after the last of them is unknown.
#[test]
fn identifiers_end_with_the_last_axle_and_the_last_frame() {
    use crate::topology::{MAX_AXLES, MAX_FRAMES};
    let posture = |axle: usize| Message::AxlePosture {
        axle: AxleId(axle as u8),
        sequence: 0,
        posture: Posture::ORIGIN,
    };
    let wrench = |frame: usize| Message::BeamWrench {
        frame: FrameId(frame as u8),
        sequence: 0,
        wrench: Wrench::ZERO,
    };
    for (message, count) in [
        (&posture as &dyn Fn(usize) -> Message, MAX_AXLES),
        (&wrench, MAX_FRAMES),
    ] {
        let last = encode(&message(count - 1)).unwrap();
        assert_eq!(decode(&last), Ok(message(count - 1)));
        assert!(encode(&message(count)).is_err());
        let beyond = CanFrame {
            id: last.id + 1,
            ..last
        };
        assert_eq!(decode(&beyond), Err(DecodeError::UnknownId(beyond.id)));
    }
}

#[test]
fn known_message_has_expected_bytes() {
    // sequence 7, force_x 1 N = 20 units, force_y −0.05 N = −1 unit, moments 0.002 and 0.
    let wrench = Wrench {
        force_x: 1.0,
        force_y: -0.05,
        moment_root: 0.002,
        moment_end: 0.0,
    };
    let sequence = 7;
    let frame = encode(&Message::BeamWrench {
        frame: FrameId(0),
        sequence,
        wrench,
    })
    .unwrap();
    assert_eq!((frame.id, frame.length), (0x220, 8));
    let expected: u64 = 7 | 20 << 8 | 0x3fff << 22 | 2 << 36;
    assert_eq!(frame.data, expected.to_le_bytes());
}
