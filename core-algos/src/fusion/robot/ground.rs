//! Uneven ground.
//!
//! A wheel that climbs rolls further than it gets: 3 mm more over a ridge of 10 mm. The other wheel and the other axle
//! climb a moment later, so the beam contradicts the wheels for some centimetres. An axle that rolls to its side also
//! moves sideways, and its gyro measures part of its pitch rate. None of this is an error of a sensor, and none of it
//! happens on a floor.
//!
//! *Unevenness* u ≥ 0 scales variances of the odometric increments, per metre, that are zero on a floor. It follows from
//! the beam's normalised innovation squared (NIS): per metre driven it changes by [`Config::rate_per_m`] times NIS less
//! [`Config::usual_nis`]. On a floor the NIS is below its usual value and u is 0. Where wheels climb, u rises within
//! millimetres, the increments lose weight against the beam, and the constant errors learn little. After the climb u
//! falls to 0 again within a metre.
//!
//! A wrong wheel, gauge or gyro raises the NIS too, until the joint filter has learnt the constant error. This error
//! lasts while the climbs go, so the filter learns it later and still names the sensor.
//!
//! A wheel in the air contradicts the beam all the way, even with this noise. So there is a budget of contradiction: a
//! distance with a large NIS spends it, a distance without refills it. While it is spent the beam is refused.

use crate::config::{ConfigError, declare};
use crate::math::lesser;

declare! {
    /// Noise of the increments on uneven ground.
    pub struct Config {
        /// Change of the unevenness per metre driven and NIS beyond the usual one. 0: the ground counts as a floor.
        pub rate_per_m: f32 = 60.0, "1/m": NonNegative;
        /// NIS of the beam, three degrees of freedom, from which the ground counts as uneven.
        // On floors the mean is 0.1 to 0.5 where wheels and tyres are unknown, and below 0.1 later.
        pub usual_nis: f32 = 0.25, "": Positive;
        /// Largest unevenness.
        pub most: f32 = 0.2, "": NonNegative;
        /// NIS of the beam that spends the budget.
        // Over ridges of 10 mm 2 % of the way has more; with a wheel in the air nearly all of it.
        pub contrary_nis: f32 = 1.5, "": Positive;
        /// Budget of contradiction.
        pub budget_m: f32 = 0.08, "m": NonNegative;
        /// Share of the way with such an NIS that leaves the budget as it is.
        pub usual_share: f32 = 0.3, "": Range(0.0, 1.0);
        /// Noise along the heading at an unevenness of 1.
        pub along_m_per_sqrt_m: f32 = 6e-3, "m/√m": NonNegative;
        /// Noise across the heading at an unevenness of 1.
        pub across_m_per_sqrt_m: f32 = 8e-3, "m/√m": NonNegative;
        /// Noise of the heading by wheels at an unevenness of 1.
        // Of two wheels 0.32 m apart that climb independently.
        pub wheels_rad_per_sqrt_m: f32 = 3e-2, "rad/√m": NonNegative;
        /// Noise of the heading by a gyro at an unevenness of 1.
        pub gyro_rad_per_sqrt_m: f32 = 4e-3, "rad/√m": NonNegative;
    }
}

impl Config {
    /// Builds the model; an error names the parameter out of range.
    pub(super) fn build(&self) -> Result<Ground, ConfigError> {
        self.check_ranges()?;
        let square = |x: f32| x * x;
        Ok(Ground {
            rate_per_m: self.rate_per_m,
            usual_nis: self.usual_nis,
            most: self.most,
            contrary_nis: self.contrary_nis,
            budget_m: self.budget_m,
            usual_share: self.usual_share,
            along: square(self.along_m_per_sqrt_m),
            across: square(self.across_m_per_sqrt_m),
            wheels: square(self.wheels_rad_per_sqrt_m),
            gyro: square(self.gyro_rad_per_sqrt_m),
        })
    }
}

/// Model of uneven ground with checked parameters; variances per metre at an unevenness of 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ground {
    rate_per_m: f32,
    usual_nis: f32,
    most: f32,
    contrary_nis: f32,
    budget_m: f32,
    usual_share: f32,
    along: f32,
    across: f32,
    wheels: f32,
    gyro: f32,
}

/// Unevenness, and the spent part of the budget.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Unevenness {
    pub(super) value: f32,
    pub(super) spent_m: f32,
}

impl Ground {
    /// True if the beam contradicts the wheels longer than uneven ground does.
    pub(super) fn is_spent(&self, state: &Unevenness) -> bool {
        state.spent_m > self.budget_m
    }

    /// Variances along and across the heading and in heading over a distance `driven`, m.
    pub(super) fn variances(&self, unevenness: f32, driven: f32, gyro_share: f32) -> [f32; 3] {
        let heading = (1.0 - gyro_share) * self.wheels + gyro_share * self.gyro;
        [self.along, self.across, heading].map(|variance| unevenness * driven * variance)
    }

    /// Moves on by a distance `driven`, m, at the end of which the beam had this NIS; `most_nis` bounds the effect of a
    /// single measurement.
    pub(super) fn step(&self, state: &mut Unevenness, driven: f32, nis: f32, most_nis: f32) {
        let beyond = lesser(nis, most_nis) - self.usual_nis;
        let value = state.value + self.rate_per_m * driven * beyond;
        state.value = between(value, self.most);
        let contrary = if nis <= self.contrary_nis { 0.0 } else { 1.0 };
        let spent = state.spent_m + driven * (contrary - self.usual_share);
        state.spent_m = between(spent, 2.0 * self.budget_m);
    }
}

/// `x` limited to 0 and `most`; NaN becomes `most`.
fn between(x: f32, most: f32) -> f32 {
    let x = lesser(x, most);
    if x > 0.0 { x } else { 0.0 }
}
