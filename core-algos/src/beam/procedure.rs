//! Calibration on request: average at standstill, then zeros or gains, as a state machine of the
//! beam board.
//!
//! A request is rejected while the motors are on: the strip is then not held at the requested shape.
//! [`Procedure::sample`] takes every conversion and returns an [`Event`] if the board must act. Nothing here can
//! fail.

use super::calibration::{self, Standstill, StandstillError, StandstillLimits};
use super::strip::{GaugeMask, MAX_GAUGES};
use crate::bus::field::{Calibrate, CalibrationResult};

/// Action of the beam board at the end of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// Reply that the request `sequence` is rejected.
    Refused {
        /// Sequence number of the request.
        sequence: u8,
        /// Reason of the rejection.
        result: CalibrationResult,
        /// Gauge at fault, counted from the root; 0 if the reason is not a gauge.
        gauge: u8,
    },
    /// Use and store this calibration, then reply to the request `sequence`.
    Adopt {
        /// Sequence number of the request.
        sequence: u8,
        /// The new calibration, already validated.
        config: calibration::Config,
    },
}

/// Calibration procedure of the beam board, idle until a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Procedure {
    limits: StandstillLimits,
    half_thickness: f32,
    running: Option<Running>,
}

/// A calibration in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Running {
    /// Sequence number of the request.
    sequence: u8,
    wanted: Calibrate,
    standstill: Standstill,
}

impl Procedure {
    /// A procedure within `limits`, for a strip of this half thickness, m.
    pub fn new(limits: StandstillLimits, half_thickness_m: f32) -> Self {
        Self {
            limits,
            half_thickness: half_thickness_m,
            running: None,
        }
    }

    /// Begins a calibration; a running calibration is aborted.
    pub fn request(&mut self, sequence: u8, calibrate: Calibrate) {
        self.running = Some(Running {
            sequence,
            wanted: calibrate,
            standstill: Standstill::default(),
        });
    }

    /// Takes a conversion of every gauge; `config` is the calibration in use.
    pub fn sample(
        &mut self,
        config: &calibration::Config,
        counts: &[i32; MAX_GAUGES],
        motors_off: bool,
    ) -> Option<Event> {
        let Running {
            sequence,
            wanted,
            ref mut standstill,
        } = *self.running.as_mut()?;
        let refused = |result, gauge| Event::Refused {
            sequence,
            result,
            gauge,
        };
        let gauges = config.zero_counts.count();
        let event = if !motors_off {
            refused(CalibrationResult::MotorsOn, 0)
        } else {
            let Ok(calibration) = config.build(gauges) else {
                self.running = None;
                return Some(refused(CalibrationResult::OutOfRange, 0));
            };
            standstill.add(&calibration, &self.limits, counts);
            let mask = GaugeMask::first(gauges);
            let average = match standstill.average(&calibration, &self.limits, mask) {
                Ok(average) => average,
                Err(StandstillError::TooFewSamples(_)) => return None,
                Err(error) => {
                    self.running = None;
                    return Some(match error {
                        StandstillError::Noisy(gauge) => refused(CalibrationResult::Noisy, gauge),
                        StandstillError::Drifting(gauge) => {
                            refused(CalibrationResult::Drifting, gauge)
                        }
                        StandstillError::BadSample(gauge)
                        | StandstillError::TooFewSamples(gauge) => {
                            refused(CalibrationResult::BadSample, gauge)
                        }
                    });
                }
            };
            let strain = |curvature: f32| [curvature * self.half_thickness; MAX_GAUGES];
            let found = match wanted {
                Calibrate::Zero(curvature) => config.zeroed(&average, &strain(curvature)),
                Calibrate::Gain(curvature) => config.with_gain(&average, &strain(curvature)),
            };
            match found.build(gauges) {
                Ok(_) => Event::Adopt {
                    sequence,
                    config: found,
                },
                Err(_) => refused(CalibrationResult::OutOfRange, 0),
            }
        };
        self.running = None;
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use super::super::strip::PerGauge;
    use super::*;
    use crate::fusion::testing::Random;

    const HALF_THICKNESS: f32 = 0.5e-3;

    /// Offset in counts and true gain of each gauge.
    const REAL: [(f64, f64); 5] = [
        (120.0, 1.02),
        (-80.0, 0.99),
        (5.0, 1.0),
        (300.0, 0.95),
        (-33.0, 1.05),
    ];

    fn counts(random: &mut Random, curvature: f64) -> [i32; MAX_GAUGES] {
        let per_count = f64::from(calibration::Config::default().strain_per_count);
        let mut counts = [0; MAX_GAUGES];
        for (count, (offset, gain)) in counts.iter_mut().zip(REAL) {
            let strain = curvature * f64::from(HALF_THICKNESS);
            let exact = 2048.0 + offset + strain / gain / per_count;
            *count = (exact + 0.7 * random.normal()).round() as i32;
        }
        counts
    }

    /// Runs a request to its end; `curvature(k)` is the true curvature at sample k, 1/m.
    fn run(
        config: &calibration::Config,
        calibrate: Calibrate,
        motors_off: bool,
        curvature: impl Fn(usize) -> f64,
    ) -> Event {
        let mut procedure = Procedure::new(StandstillLimits::default(), HALF_THICKNESS);
        let mut random = Random::new(4);
        procedure.request(9, calibrate);
        let mut events = (0..2000).filter_map(|k| {
            let counts = counts(&mut random, curvature(k));
            procedure.sample(config, &counts, motors_off)
        });
        let event = events.next().unwrap();
        assert_eq!(events.next(), None, "one answer a request");
        event
    }

    #[test]
    fn zeros_and_gains_are_found() {
        let Event::Adopt {
            sequence: 9,
            config,
        } = run(
            &calibration::Config::default(),
            Calibrate::Zero(0.0),
            true,
            |_| 0.0,
        )
        else {
            panic!("not adopted");
        };
        let Event::Adopt { config, .. } = run(&config, Calibrate::Gain(1.5), true, |_| 1.5) else {
            panic!("not adopted");
        };
        for (i, (offset, gain)) in REAL.into_iter().enumerate() {
            let zero = f64::from(config.zero_counts.padded()[i]);
            assert!((zero - 2048.0 - offset).abs() < 0.2, "{i} {zero}");
            let found = f64::from(config.gain.padded()[i]);
            assert!((found - gain).abs() < 1e-3, "{i} {found}");
        }
    }

    #[test]
    fn calibration_with_motors_on_motion_or_wrong_bend_is_rejected() {
        let config = calibration::Config::default();
        type Motion = fn(usize) -> f64;
        let cases: [(Calibrate, bool, Motion, CalibrationResult); 4] = [
            (
                Calibrate::Zero(0.0),
                false,
                |_| 0.0,
                CalibrationResult::MotorsOn,
            ),
            (
                Calibrate::Zero(0.0),
                true,
                |k| 0.01 * (k / 250) as f64,
                CalibrationResult::Drifting,
            ),
            (
                Calibrate::Zero(0.0),
                true,
                |k| 0.1 * (k % 2) as f64,
                CalibrationResult::Noisy,
            ),
            // The request says bent, the strip is straight: gains out of range.
            (
                Calibrate::Gain(1.5),
                true,
                |_| 0.0,
                CalibrationResult::OutOfRange,
            ),
        ];
        // A list of gains that does not match the zeros.
        let mut broken = config;
        broken.gain = PerGauge::uniform(4, 1.0);
        let out_of_range = (
            &broken,
            (
                Calibrate::Zero(0.0),
                true,
                cases[1].2,
                CalibrationResult::OutOfRange,
            ),
        );
        for (config, (calibrate, off, motion, expected)) in cases
            .into_iter()
            .map(|case| (&config, case))
            .chain([out_of_range])
        {
            match run(config, calibrate, off, motion) {
                Event::Refused {
                    sequence: 9,
                    result,
                    ..
                } => assert_eq!(result, expected),
                other => panic!("{other:?}"),
            }
        }
    }
}
