//! Fields of messages: types of the bus only, and the conversion of each field to signal values.

use crate::math::matrix::{Mat3, cholesky};
use crate::math::trig::{exp, ln, sqrt, wrap_angle};
use crate::math::{Posture, Wrench};
use crate::safety::{Conditions, OperatingState};
use core::slice::{Iter, IterMut};

/// Resolution of a transmitted odometric position, m.
pub const POSITION_STEP_M: f32 = 1e-5;
/// Width of a transmitted odometric position, bits.
pub const POSITION_BITS: u8 = 20;
/// Span of transmitted odometric positions, which are sent modulo this span, m.
pub const POSITION_SPAN_M: f32 = POSITION_STEP_M * (1 << POSITION_BITS) as f32;

/// Raw value of an unknown delay in a `TimeSync`.
const UNKNOWN_DELAY: u16 = u16::MAX;
/// Largest number of signals in a message.
pub(super) const MAX_SIGNALS: usize = 7;
/// Values of the signals of a message.
pub(super) type Values = [f32; MAX_SIGNALS];

wire_enum! {
    /// Result of a calibration.
    CalibrationResult {
        /// The new calibration is in use and stored.
        #[default]
        Stored = "stored",
        /// Refused: the motors are on.
        MotorsOn = "motors_on",
        /// Refused: a sample was saturated or missing.
        BadSample = "bad_sample",
        /// Refused: samples scatter too much.
        Noisy = "noisy",
        /// Refused: the average drifted between the two halves of the samples.
        Drifting = "drifting",
        /// Refused: the new calibration is out of range.
        OutOfRange = "out_of_range",
        /// The new calibration is in use, but storing it failed.
        NotStored = "not_stored",
    }
}

/// Calibration that the beam board carries out on request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Calibrate {
    /// Calibrate the zeros; the strip has this curvature (0 for straight), 1/m.
    Zero(f32),
    /// Calibrate the gains; the strip has this curvature, 1/m.
    Gain(f32),
}

wire_enum! {
    /// Mode that the lead node commands to the axles.
    LeadMode {
        /// Brake, then motors off.
        #[default]
        Idle = "idle",
        /// Follow the references.
        Active = "active",
        /// Standstill before a drive or at the end of a task: hold the references.
        Hold = "hold",
        /// Brake, then motors off; clear latched faults.
        Clear = "clear",
    }
}

/// A hash of 24 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Hash24(pub u32);

impl Hash24 {
    /// Hash (FNV-1a) of bytes.
    pub fn of(bytes: &[u8]) -> Self {
        let fold = |sum: u32, byte: &u8| (sum ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
        let sum = bytes.iter().fold(0x811c_9dc5, fold);
        Self((sum ^ sum >> 24) & 0xff_ffff)
    }

    /// First six hexadecimal digits of the hash at the end of a build identification; zero without a hash.
    pub fn of_build(text: &str) -> Self {
        let hash = text.rsplit(' ').next().unwrap_or_default();
        let digits = hash.get(..6).unwrap_or_default();
        Self(u32::from_str_radix(digits, 16).unwrap_or_default())
    }
}

/// Wraps a position or position difference to half a span around zero.
pub fn wrap_position(x: f32) -> f32 {
    const HALF: f32 = 0.5 * POSITION_SPAN_M;
    if x.abs() < HALF {
        return x;
    }
    let reduced = x % POSITION_SPAN_M;
    if reduced >= HALF {
        reduced - POSITION_SPAN_M
    } else if reduced < -HALF {
        reduced + POSITION_SPAN_M
    } else {
        reduced
    }
}

/// Smallest transmitted standard deviation, m or rad; smaller standard deviations are raised to this value.
const SIGMA_FLOOR: f32 = 2e-9;

/// Covariance from logarithms of standard deviations and correlations.
fn covariance_from(logs: [f32; 3], mut correlation: [f32; 3]) -> Mat3 {
    let sigma = logs.map(exp);
    let mut m = [[0.0; 3]; 3];
    // Rounded correlations near one can make the matrix indefinite: pull them toward zero. The
    // scaled matrix is checked, because scaling rounds as well.
    for _ in 0..8 {
        let [xy, xp, yp] = correlation;
        let unit = [[1.0, xy, xp], [xy, 1.0, yp], [xp, yp, 1.0]];
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] = unit[i][j] * (sigma[i] * sigma[j]);
            }
        }
        if cholesky(&m).is_some() {
            return m;
        }
        correlation = correlation.map(|c| 0.97 * c);
    }
    for i in 0..3 {
        for j in 0..3 {
            if i != j {
                m[i][j] = 0.0;
            }
        }
    }
    m
}

/// Conversion of a message field to one or more signal values, in the order of the signals.
pub(super) trait Field: Sized {
    /// Writes the field's signal values.
    fn write(self, to: &mut IterMut<f32>);
    /// Reads the field from its signal values; `None` if they are invalid for this type.
    fn read(from: &mut Iter<f32>) -> Option<Self>;
}

impl Field for f32 {
    fn write(self, to: &mut IterMut<f32>) {
        if let Some(value) = to.next() {
            *value = self;
        }
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        from.next().copied()
    }
}

impl<const N: usize> Field for [f32; N] {
    fn write(self, to: &mut IterMut<f32>) {
        self.into_iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f32::read(from)?;
        }
        Some(values)
    }
}

/// A field of one value: `write` and `read` as functions of `f32`.
macro_rules! single {
    ($($kind:ty: |$field:ident| $write:expr, |$value:ident| $read:expr;)+) => {$(
        impl Field for $kind {
            fn write(self, to: &mut IterMut<f32>) {
                let $field = self;
                f32::write($write, to);
            }

            fn read(from: &mut Iter<f32>) -> Option<Self> {
                let $value = f32::read(from)?;
                $read
            }
        }
    )+};
}

single! {
    u8: |number| number.into(), |value| Some(value as u8);
    u16: |number| number.into(), |value| Some(value as u16);
    bool: |flag| u8::from(flag).into(), |value| Some(value != 0.0);
    Option<u16>: |delay| delay.unwrap_or(UNKNOWN_DELAY).into(),
        |value| Some(Some(value as u16).filter(|&delay| delay != UNKNOWN_DELAY));
    Hash24: |hash| hash.0 as f32, |value| Some(Self(value as u32));
    LeadMode: |mode| f32::from(mode as u8), |value| Self::from_number(value as u8);
    OperatingState: |state| f32::from(state as u8), |value| Self::from_number(value as u8);
    CalibrationResult: |result| f32::from(result as u8), |value| Self::from_number(value as u8);
}

/// Epoch number as two signals: lowest byte, then the upper 24 bits.
impl Field for u32 {
    fn write(self, to: &mut IterMut<f32>) {
        (self as u8).write(to);
        ((self >> 8) as f32).write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let sequence = u8::read(from)?;
        Some((f32::read(from)? as u32) << 8 | u32::from(sequence))
    }
}

/// Set of conditions as two signals: the lowest 24 bits, then the upper bits.
impl Field for Conditions {
    fn write(self, to: &mut IterMut<f32>) {
        let bits = self.bits();
        [(bits & 0xff_ffff) as f32, (bits >> 24) as f32].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let [low, high]: [f32; 2] = Field::read(from)?;
        Some(Self::from_bits(low as u64 | (high as u64) << 24))
    }
}

impl Field for Posture {
    fn write(self, to: &mut IterMut<f32>) {
        [self.x, self.y, wrap_angle(self.phi)].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        <[f32; 3]>::read(from).map(|[x, y, phi]| Self::new(x, y, phi))
    }
}

/// A posture whose position is sent modulo [`POSITION_SPAN_M`].
pub(super) struct Odometric(pub Posture);

impl Field for Odometric {
    fn write(self, to: &mut IterMut<f32>) {
        // A position that would round up to half a span is sent as the other end of the span.
        const LAST: f32 = 0.5 * POSITION_SPAN_M - 0.6 * POSITION_STEP_M;
        let position = |x: f32| match wrap_position(x) {
            wrapped if wrapped > LAST => -0.5 * POSITION_SPAN_M,
            wrapped => wrapped,
        };
        let Posture { x, y, phi } = self.0;
        Posture::new(position(x), position(y), phi).write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        Posture::read(from).map(Self)
    }
}

/// Covariance as six signals: logarithms of the standard deviations, then the correlations.
impl Field for Mat3 {
    fn write(self, to: &mut IterMut<f32>) {
        let sigma = [0, 1, 2].map(|i| sqrt(self[i][i]).max(SIGMA_FLOOR));
        for i in 0..3 {
            // `max` would turn NaN into the floor; a covariance that is not finite must not be sent.
            let log = if self[i][i] >= 0.0 {
                ln(sigma[i])
            } else {
                f32::NAN
            };
            log.write(to);
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            (self[i][j] / (sigma[i] * sigma[j])).write(to);
        }
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        Some(covariance_from(Field::read(from)?, Field::read(from)?))
    }
}

impl Field for Wrench {
    fn write(self, to: &mut IterMut<f32>) {
        [
            self.force_x,
            self.force_y,
            self.moment_root,
            self.moment_end,
        ]
        .write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let [force_x, force_y, moment_root, moment_end] = Field::read(from)?;
        Some(Self {
            force_x,
            force_y,
            moment_root,
            moment_end,
        })
    }
}

impl Field for Calibrate {
    fn write(self, to: &mut IterMut<f32>) {
        let (command, curvature) = match self {
            Self::Zero(curvature) => (0.0, curvature),
            Self::Gain(curvature) => (1.0, curvature),
        };
        [command, curvature].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        match (u8::read(from)?, f32::read(from)?) {
            (0, curvature) => Some(Self::Zero(curvature)),
            (1, curvature) => Some(Self::Gain(curvature)),
            _ => None,
        }
    }
}
