//! The square root of an `f32`, correctly rounded, without `std`.
//!
//! Stable Rust has no square root in `core`. On a Cortex-M4F `libm` computes it bit by bit in sixty instructions,
//! although the processor has one instruction for it. That instruction needs assembly, so this is a separate crate: the
//! algorithms are free of `unsafe`.
#![no_std]

/// √x, rounded to nearest, ties to even (IEEE 754): the same bits on every processor.
///
/// NaN below zero and for NaN; ±0 and +∞ are their own roots.
#[inline(always)]
pub fn sqrt(x: f32) -> f32 {
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    {
        vsqrt(x)
    }
    #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
    libm::sqrtf(x)
}

/// A separate function, because inline assembly cannot name single-precision registers on a processor without
/// double-precision registers.
#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
// SAFETY: in this ABI the argument arrives and the result leaves in s0; nothing else is touched.
#[unsafe(naked)]
extern "C" fn vsqrt(x: f32) -> f32 {
    core::arch::naked_asm!(".fpu fpv4-sp-d16", "vsqrt.f32 s0, s0", "bx lr")
}

#[cfg(test)]
mod tests {
    use super::sqrt;

    /// True if `root` is the `f32` nearest to √x: no midpoint to a neighbour lies between them.
    fn is_rounded(x: f32, root: f32) -> bool {
        // The midpoint of two neighbours has 25 bits, its square 50: exact in f64.
        let (below, above) = (root.next_down() as f64, root.next_up() as f64);
        let (low, high) = (0.5 * (below + root as f64), 0.5 * (root as f64 + above));
        low * low <= x as f64 && x as f64 <= high * high
    }

    #[test]
    fn is_correctly_rounded() {
        // Subnormal to largest, an odd stride so that significands differ.
        for bits in (1..0x7f80_0000u32).step_by(1009) {
            let x = f32::from_bits(bits);
            assert!(is_rounded(x, sqrt(x)), "{x:e}");
        }
    }

    #[test]
    fn special_values() {
        assert_eq!(sqrt(0.0).to_bits(), 0.0f32.to_bits());
        assert_eq!(sqrt(-0.0).to_bits(), (-0.0f32).to_bits());
        assert_eq!(sqrt(f32::INFINITY), f32::INFINITY);
        assert!(sqrt(-1e-45).is_nan() && sqrt(f32::NAN).is_nan());
    }
}
