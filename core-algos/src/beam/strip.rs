//! The strip and its gauges: geometry, stiffness, and uncertainty of strain readings.

use crate::config::{Allowed, Checked, ConfigError, declare, in_range, require};
use crate::math::Posture;
use crate::math::matrix::{self, Mat3};
use crate::math::trig::sqrt;

/// Largest number of gauges on a strip.
pub const MAX_GAUGES: usize = 8;
/// Fewest gauges for an estimate.
pub const MIN_GAUGES: u32 = 2;
/// Least spacing of gauges as a fraction of the length; closer gauges cost the interpolation all precision.
const MIN_SPACING: f32 = 1e-3;
/// Fractions of the length of the five Gauss–Legendre nodes: the placement that makes the end
/// angle of the interpolating polynomial exact to the ninth degree.
pub const GAUSS_5: [f32; 5] = [0.046_910_077, 0.230_765_34, 0.5, 0.769_234_66, 0.953_089_9];

/// List of one number for each gauge, from root to tip; at most [`MAX_GAUGES`]. A plain list in a configuration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PerGauge {
    values: [f32; MAX_GAUGES],
    count: usize,
}

impl PerGauge {
    /// The list of `values`; `None` if there are more than [`MAX_GAUGES`].
    pub fn new(values: &[f32]) -> Option<Self> {
        let mut list = Self {
            values: [0.0; MAX_GAUGES],
            count: values.len(),
        };
        if values.len() > MAX_GAUGES {
            return None;
        }
        for (slot, value) in list.values.iter_mut().zip(values) {
            *slot = *value;
        }
        Some(list)
    }

    /// A list of `count` (at most [`MAX_GAUGES`]) times `value`.
    pub fn uniform(count: usize, value: f32) -> Self {
        let count = count.min(MAX_GAUGES);
        let mut values = [0.0; MAX_GAUGES];
        for slot in values.iter_mut().take(count) {
            *slot = value;
        }
        Self { values, count }
    }

    /// Number of gauges in the list.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Replaces the value of gauge `i`; nothing happens beyond the last gauge.
    pub fn set(&mut self, i: usize, value: f32) {
        if let Some(slot) = self.values.get_mut(..self.count).and_then(|v| v.get_mut(i)) {
            *slot = value;
        }
    }

    /// Values, padded with zeros to [`MAX_GAUGES`].
    pub fn padded(&self) -> [f32; MAX_GAUGES] {
        self.values
    }

    /// Values from root to tip.
    pub fn iter(&self) -> impl Iterator<Item = f32> + '_ {
        self.values.iter().copied().take(self.count)
    }
}

impl Checked for PerGauge {
    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.values
            .get(..self.count())
            .unwrap_or_default()
            .check(field, allowed)
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for PerGauge {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for PerGauge {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> serde::de::Visitor<'de> for List {
            type Value = PerGauge;

            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, "a list of at most {MAX_GAUGES} numbers")
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(
                self,
                mut list: A,
            ) -> Result<PerGauge, A::Error> {
                let mut values = [0.0; MAX_GAUGES];
                let mut count = 0;
                while let Some(value) = list.next_element::<f32>()? {
                    match values.get_mut(count) {
                        Some(slot) => *slot = value,
                        None => return Err(serde::de::Error::invalid_length(count + 1, &self)),
                    }
                    count += 1;
                }
                Ok(PerGauge { values, count })
            }
        }
        deserializer.deserialize_seq(List)
    }
}

/// A set of gauges, bit `i` for gauge `i` counted from the root.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GaugeMask(pub u8);

impl GaugeMask {
    /// No gauge.
    pub const NONE: Self = Self(0);

    /// The first `count` gauges.
    pub fn first(count: usize) -> Self {
        let mut bits = 0;
        for i in 0..MAX_GAUGES {
            if i < count {
                bits |= 1 << i;
            }
        }
        Self(bits)
    }

    /// True if gauge `i` is in the set.
    pub fn contains(self, i: usize) -> bool {
        i < MAX_GAUGES && self.0 & (1 << i) != 0
    }

    /// The gauges in the set, from the root on.
    pub fn iter(self) -> impl DoubleEndedIterator<Item = usize> {
        (0..MAX_GAUGES).filter(move |&i| self.contains(i))
    }

    /// The set with gauge `i`.
    pub fn with(self, i: usize) -> Self {
        if i < MAX_GAUGES {
            Self(self.0 | 1 << i)
        } else {
            self
        }
    }

    /// The set without gauge `i`.
    pub fn without(self, i: usize) -> Self {
        if i < MAX_GAUGES {
            Self(self.0 & !(1 << i))
        } else {
            self
        }
    }

    /// The gauges in both sets.
    pub fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Number of gauges in the set.
    pub fn count(self) -> u32 {
        self.0.count_ones()
    }
}

/// A posture with its covariance (m, m, rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePosture {
    /// Front axle midpoint in the rear axle's coordinates.
    pub posture: Posture,
    /// Covariance of (x, y, phi) in that frame.
    pub covariance: Mat3,
    /// Covariance of the errors that are independent between estimates, without the lasting errors of zeros and
    /// gains.
    pub noise: Mat3,
}

impl RelativePosture {
    /// True if every number is finite and every variance positive.
    pub fn is_sound(&self) -> bool {
        // One number that is not finite makes the sum not finite. Finite numbers of this size do not overflow the
        // sum.
        let Posture { x, y, phi } = self.posture;
        let [covariance, noise] = [&self.covariance, &self.noise].map(|rows| rows.as_flattened());
        let sum: f32 = [x, y, phi].iter().chain(covariance).chain(noise).sum();
        let p = &self.covariance;
        sum.is_finite() && p[0][0] > 0.0 && p[1][1] > 0.0 && p[2][2] > 0.0
    }
}

declare! {
    /// Standard deviations of the errors of a strain reading.
    ///
    /// Default: Values of ordinary foil gauges in full bridges, zeroed on the robot with the frame released. The zero
    /// of a matched bridge drifts by 0.5 to 1 µε/K, and a held strain creeps by up to 1 %. A foil gauge drifts by 5
    /// to 20 µε in months. Clamps that are not square bend the zeroed strip by milliradians. The foil, on its glue,
    /// is 40 to 60 µm above the surface of the strip.
    pub struct Uncertainty {
        /// Noise of one reading as used for one posture (after averaging).
        pub noise_strain: f32 = 1e-6, "strain": Range(1e-9, 1e-2);
        /// Zero error of each gauge, independent of the others.
        pub offset_strain: f32 = 20e-6, "strain": Range(0.0, 1e-2);
        /// Random walk of the zero of each gauge, independent of the others. It begins at the start of the node, and
        /// enters the elastica fit and the joint filter only.
        pub zero_walk_strain_per_sqrt_s: f32 = 0.05e-6, "strain/√s": Range(0.0, 1e-4);
        /// Zero error that all gauges share (temperature, a zeroing posture not quite straight). The error acts like
        /// a bend: 1 µε is about 0.7 mrad on the default strip.
        pub common_offset_strain: f32 = 7e-6, "strain": Range(0.0, 1e-2);
        /// Relative gain error of each gauge, independent of the others.
        pub gain: f32 = 1e-2, "": Range(0.0, 1.0);
        /// Relative gain error that all gauges share (thickness of the strip, batch of the gauges).
        pub common_gain: f32 = 2e-2, "": Range(0.0, 1.0);
        /// Error of the polynomial between the gauges, as a share of its highest Legendre
        /// coefficients; enters the covariance of the polynomial methods only.
        pub interpolation: f32 = 0.3, "": Range(0.0, 100.0);
        /// Error of x and of y that strains do not show (length of the strip, backlash of its clamps). It also keeps
        /// the covariance regular on a straight strip, where x does not depend on the strains.
        pub position_m: f32 = 5e-5, "m": Range(1e-6, 1.0);
        /// Error of the heading that strains do not show.
        pub heading_rad: f32 = 1e-4, "rad": Range(1e-6, 1.0);
        /// Scale of the elastica fit's prior for the end force, in units of EI/L² (6.1 N on the default strip). The
        /// prior has heavy tails: a far larger force is estimated without bias if the strains determine it. Otherwise
        /// (straight strip) the force stays near zero.
        pub load_prior: f32 = 4.0, "": Range(1e-2, 1e3);
    }
}

impl Uncertainty {
    /// Values of gauges with calibrated gains and new zeros.
    #[cfg(test)]
    pub(super) fn calibrated() -> Self {
        Self {
            offset_strain: 1e-6,
            common_offset_strain: 1e-6,
            gain: 3e-3,
            common_gain: 1e-3,
            ..Self::default()
        }
    }
}

/// Standard deviations of the posture's errors due to lasting errors of the gauges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PostureSigmas {
    /// Error of the bend due to the zeros, rad.
    pub zero_rad: f32,
    /// Tilt of the zeros from root to tip: first moment, about the middle, of their curvature error, m.
    pub zero_tilt_m: f32,
    /// Random walk of the bend error due to the zeros, rad/√s.
    pub walk_rad_per_sqrt_s: f32,
    /// Random walk of the tilt of the zeros, m/√s.
    pub walk_tilt_m_per_sqrt_s: f32,
    /// Relative error of the bend due to the gains.
    pub gain: f32,
    /// Tilt of the gains from root to tip, m per radian of bend.
    pub gain_tilt_m: f32,
}

declare! {
    /// Geometry, stiffness and gauges of the strip.
    ///
    /// Default: the 0.37 m steel strip of 50 × 1 mm with five gauges at the Gauss–Legendre nodes.
    pub struct Config {
        /// Position of each of the 2 to 8 gauges from the flexible root, ascending (the paper's l_i).
        pub gauges_m: PerGauge = at_gauss_nodes(0.37), "m": Range(0.0, 5.0);
        /// Standard deviations of the strain readings.
        pub uncertainty: Uncertainty = Uncertainty::default();
        derived {
            /// Flexible length (the paper's L; rigid ends are not part of it).
            pub length_m: f32 = 0.37, "m": Range(1e-3, 100.0);
            /// Distance of the gauges from the neutral axis: half the thickness (the paper's y in
            /// eq. 13).
            pub half_thickness_m: f32 = 0.5e-3, "m": Positive;
            /// Rigid length between the rear axle's midpoint and the flexible root.
            pub rigid_root_m: f32 = 0.0, "m": Range(0.0, 100.0);
            /// Rigid length between the flexible tip and the front axle's midpoint.
            pub rigid_tip_m: f32 = 0.0, "m": Range(0.0, 100.0);
            /// Bending stiffness EI; scales the wrench, not the posture.
            pub bending_stiffness_n_m2: f32 = 0.833, "N m²": Range(1e-6, 1e6);
        }
    }
}

/// Positions of five gauges on a strip of this length, m.
fn at_gauss_nodes(length_m: f32) -> PerGauge {
    let mut gauges_m = PerGauge::uniform(5, 0.0);
    for (slot, fraction) in gauges_m.values.iter_mut().zip(GAUSS_5) {
        *slot = length_m * fraction;
    }
    gauges_m
}

impl Config {
    /// Standard deviations of the posture's errors due to independent and common errors of the gauges. The strain
    /// errors are fitted by a line over the position. The correlation of bend and tilt, zero for gauges symmetric about
    /// the middle, is neglected.
    pub fn sigmas(&self) -> PostureSigmas {
        let count = self.gauges_m.count() as f32;
        let place = |at: f32| (2.0 * at - self.length_m) / self.length_m;
        let mean = self.gauges_m.iter().map(place).sum::<f32>() / count;
        let moment: f32 = self
            .gauges_m
            .iter()
            .map(|at| (place(at) - mean) * (place(at) - mean))
            .sum();
        // Bend and tilt for independent errors of 1 in curvature × length.
        let own_bend = sqrt(1.0 / count + mean * mean / moment);
        let own_tilt = self.length_m / (6.0 * sqrt(moment));
        let bend = |own: f32, common: f32| {
            let own = own_bend * own;
            sqrt(own * own + common * common)
        };
        let per_strain = self.length_m / self.half_thickness_m;
        let u = &self.uncertainty;
        let walk = u.zero_walk_strain_per_sqrt_s;
        PostureSigmas {
            zero_rad: per_strain * bend(u.offset_strain, u.common_offset_strain),
            zero_tilt_m: per_strain * own_tilt * u.offset_strain,
            walk_rad_per_sqrt_s: per_strain * bend(walk, 0.0),
            walk_tilt_m_per_sqrt_s: per_strain * own_tilt * walk,
            gain: bend(u.gain, u.common_gain),
            gain_tilt_m: own_tilt * u.gain,
        }
    }

    /// Builds the validated strip; the error names the invalid field.
    pub fn build(&self) -> Result<Strip, ConfigError> {
        self.check_ranges()?;
        let length = self.length_m;
        in_range("half_thickness_m", self.half_thickness_m, 1e-6, length)?;
        let count = self.gauges_m.count();
        require(
            count >= MIN_GAUGES as usize,
            "gauges_m",
            count as f32,
            Allowed::Condition("2 to 8 positions"),
        )?;
        let mut previous = None;
        let mut u = [0.0; MAX_GAUGES];
        for (i, (slot, position)) in u.iter_mut().zip(self.gauges_m.iter()).enumerate() {
            in_range("gauges_m", position, 0.0, length).map_err(|error| error.at(i))?;
            if let Some(previous) = previous {
                require(
                    position - previous >= MIN_SPACING * length,
                    "gauges_m",
                    position,
                    Allowed::Condition(
                        "greater than the previous position by at least 0.001 of length_m",
                    ),
                )
                .map_err(|error| error.at(i))?;
            }
            previous = Some(position);
            *slot = (2.0 * position - length) / length;
        }
        self.uncertainty.check_ranges()?;
        let uncertainty = self.uncertainty;
        let still = |strain: f32| strain / self.half_thickness_m;
        let (noise, offset) = (
            still(uncertainty.noise_strain),
            still(uncertainty.offset_strain),
        );
        Ok(Strip {
            length,
            half_thickness: self.half_thickness_m,
            rigid_root: self.rigid_root_m,
            rigid_tip: self.rigid_tip_m,
            stiffness: self.bending_stiffness_n_m2,
            noise_variance: noise * noise,
            still_variance: noise * noise + offset * offset,
            common_offset: still(uncertainty.common_offset_strain),
            uncertainty,
            gauges: GaugeMask::first(count),
            u,
        })
    }
}

/// Strip with its gauges and their uncertainty, with checked parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// Flexible length, m.
    pub(super) length: f32,
    /// Distance of the gauges from the neutral axis, m.
    pub(super) half_thickness: f32,
    /// Rigid length at the root, m.
    pub(super) rigid_root: f32,
    /// Rigid length at the tip, m.
    pub(super) rigid_tip: f32,
    /// Bending stiffness, N m².
    pub(super) stiffness: f32,
    /// Standard deviations of the errors of the readings.
    pub(super) uncertainty: Uncertainty,
    /// Variance of the noise of a gauge's curvature, 1/m².
    pub(super) noise_variance: f32,
    /// Variance of a gauge's curvature on a straight strip, without the errors shared by all gauges, 1/m².
    pub(super) still_variance: f32,
    /// Standard deviation of the offset shared by all gauges, 1/m.
    pub(super) common_offset: f32,
    /// Gauges of the strip.
    pub(super) gauges: GaugeMask,
    /// Gauge positions on [−1, 1], root to tip; 0 beyond the last gauge.
    pub(super) u: [f32; MAX_GAUGES],
}

impl Strip {
    /// All gauges fitted to the strip.
    pub fn gauges(&self) -> GaugeMask {
        self.gauges
    }

    /// Flexible length, m.
    pub fn length(&self) -> f32 {
        self.length
    }

    /// Curvature (1/m) for each strain; paper eq. 13.
    pub fn curvature(&self, strain: &[f32; MAX_GAUGES]) -> [f32; MAX_GAUGES] {
        strain.map(|strain| strain / self.half_thickness)
    }

    /// The gauges of `mask` whose curvature is finite and within [`MAX_TURN`], the domain of all computations.
    pub(super) fn usable(&self, curvature: &[f32; MAX_GAUGES], mask: GaugeMask) -> GaugeMask {
        let mut usable = mask.and(self.gauges);
        for i in 0..MAX_GAUGES {
            if !((curvature[i] * self.length).abs() <= MAX_TURN) {
                usable = usable.without(i);
            }
        }
        usable
    }

    /// The posture of the front axle from that of the flexible tip in the frame of the flexible
    /// root.
    pub(super) fn with_rigid_ends(&self, flexible: Posture) -> Posture {
        let (s, c) = crate::math::trig::sin_cos(flexible.phi);
        Posture::new(
            self.rigid_root + flexible.x + self.rigid_tip * c,
            flexible.y + self.rigid_tip * s,
            flexible.phi,
        )
    }

    /// Adds the errors that strains do not show to the covariance of a posture.
    pub(super) fn with_unseen_error(&self, mut covariance: Mat3) -> Mat3 {
        let position = self.uncertainty.position_m * self.uncertainty.position_m;
        covariance[0][0] += position;
        covariance[1][1] += position;
        covariance[2][2] += self.uncertainty.heading_rad * self.uncertainty.heading_rad;
        covariance
    }

    /// Adds `excess` (strain²) to the covariances of a posture: the noise variance of the readings less the configured
    /// variance.
    pub(super) fn with_excess_noise(
        &self,
        mut relative: RelativePosture,
        excess: f32,
    ) -> RelativePosture {
        let sigma = self.uncertainty.noise_strain;
        let ratio = excess / (sigma * sigma);
        let unseen = self.with_unseen_error([[0.0; 3]; 3]);
        let of_readings = matrix::subtract(&relative.noise, &unseen);
        let more = matrix::scale(&of_readings, ratio);
        if excess > 0.0 && matrix::is_finite(&more) {
            relative.covariance = matrix::add(&relative.covariance, &more);
            relative.noise = matrix::add(&relative.noise, &more);
        }
        relative
    }

    /// Derivatives of x and y of [`Self::with_rigid_ends`] by the heading of the tip.
    pub(super) fn rigid_tip_lever(&self, phi: f32) -> (f32, f32) {
        let (s, c) = crate::math::trig::sin_cos(phi);
        (-self.rigid_tip * s, self.rigid_tip * c)
    }
}

/// Largest |curvature| × length of a plausible reading, rad: eight turns.
pub const MAX_TURN: f32 = 50.0;

#[cfg(test)]
mod tests;
