//! Digital low-pass filters of sensors.

use std::f64::consts::PI;

/// Second-order section `(b₀ + b₁z⁻¹ + b₂z⁻²)/(1 + a₁z⁻¹ + a₂z⁻²)`; with b₂ = a₂ = 0 of first order.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

/// A Butterworth low-pass filter of order 1 to 3 by the bilinear transform, with prewarped cut-off frequency. With a
/// cut-off of 0.45 of the sampling rate or more, the filter passes its input unchanged.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LowPass {
    sections: Vec<Section>,
}

/// State of a [`LowPass`] for one channel (transposed direct form II).
pub(super) type Memory = [[f64; 2]; 2];

impl LowPass {
    pub fn new(order: u32, corner_hz: f64, rate_hz: f64) -> Self {
        let mut sections = Vec::new();
        if corner_hz < 0.45 * rate_hz {
            let k = libm::tan(PI * corner_hz / rate_hz);
            if order >= 2 {
                // Quality factor of the pole pair: 1/√2 at order 2, 1 at order 3.
                let quality = if order == 2 { 0.5f64.sqrt() } else { 1.0 };
                let norm = 1.0 / (1.0 + k / quality + k * k);
                let b0 = k * k * norm;
                sections.push(Section {
                    b: [b0, 2.0 * b0, b0],
                    a: [
                        2.0 * (k * k - 1.0) * norm,
                        (1.0 - k / quality + k * k) * norm,
                    ],
                });
            }
            if order % 2 == 1 {
                let norm = 1.0 / (1.0 + k);
                sections.push(Section {
                    b: [k * norm, k * norm, 0.0],
                    a: [(k - 1.0) * norm, 0.0],
                });
            }
        }
        Self { sections }
    }

    /// State of a channel whose input has always been `value`.
    pub fn settled(&self, value: f64) -> Memory {
        let mut memory = Memory::default();
        for (m, s) in memory.iter_mut().zip(&self.sections) {
            m[1] = (s.b[2] - s.a[1]) * value;
            m[0] = (s.b[1] - s.a[0]) * value + m[1];
        }
        memory
    }

    /// Filters one sample of the channel with this memory.
    pub fn step(&self, memory: &mut Memory, input: f64) -> f64 {
        let mut x = input;
        for (m, s) in memory.iter_mut().zip(&self.sections) {
            let y = s.b[0] * x + m[0];
            m[0] = s.b[1] * x - s.a[0] * y + m[1];
            m[1] = s.b[2] * x - s.a[1] * y;
            x = y;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Amplitude of the response to a sine, by correlation over whole periods.
    fn gain(filter: &LowPass, hz: f64, rate: f64) -> f64 {
        let mut memory = filter.settled(0.0);
        let (mut re, mut im) = (0.0, 0.0);
        let n = rate as usize;
        for k in 0..2 * n {
            let phase = 2.0 * PI * hz * k as f64 / rate;
            let y = filter.step(&mut memory, phase.sin());
            if k >= n {
                re += y * phase.sin();
                im += y * phase.cos();
            }
        }
        2.0 * re.hypot(im) / n as f64
    }

    #[test]
    fn gain_is_minus_3_db_at_the_cut_off_and_butterworth_beyond() {
        for order in 1..=3 {
            let filter = LowPass::new(order, 400.0, 8000.0);
            let corner = gain(&filter, 400.0, 8000.0);
            assert!((corner - 0.5f64.sqrt()).abs() < 1e-6, "{order} {corner}");
            assert!((gain(&filter, 4.0, 8000.0) - 1.0).abs() < 1e-3);
            // |H|² of a Butterworth filter at twice the cut-off, in the warped frequency.
            let warped = (PI / 10.0).tan() / (PI / 20.0).tan();
            let expected = 1.0 / (1.0 + warped.powi(2 * order as i32)).sqrt();
            let found = gain(&filter, 800.0, 8000.0);
            let error = found - expected;
            assert!(error.abs() < 1e-6, "{order} {found} {expected}");
        }
    }

    #[test]
    fn settled_state_is_stationary_and_high_cut_off_passes_through() {
        for order in 1..=3 {
            let filter = LowPass::new(order, 100.0, 8000.0);
            let mut memory = filter.settled(3.0);
            for _ in 0..10 {
                assert!((filter.step(&mut memory, 3.0) - 3.0).abs() < 1e-12);
            }
        }
        let wire = LowPass::new(2, 500.0, 1000.0);
        assert_eq!(wire.step(&mut wire.settled(0.0), 5.0), 5.0);
    }
}
