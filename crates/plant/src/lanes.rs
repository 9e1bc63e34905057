//! Arithmetic on four numbers at once.
//!
//! [`Lanes`] has two implementations with identical bits: each lane performs the same operations
//! in the same order, none of them fused. [`Narrow`] is plain Rust for any machine; [`Wide`] is one
//! vector register of a processor with AVX2. Hot code is generic over lanes and inlined into one function
//! per implementation; [`super::Plant::step`] chooses the function.

#![allow(unsafe_code)]

use std::ops::{Add, Div, Mul, Sub};

/// Vector of four `f64`.
pub trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Vector with the number `x` in every lane.
    fn splat(x: f64) -> Self;
    /// Loads the four lanes from memory.
    fn load(x: &[f64; 4]) -> Self;
    /// Stores the four lanes to memory.
    fn store(self) -> [f64; 4];
    /// Square root of each lane.
    fn sqrt(self) -> Self;
    /// Magnitude of each lane.
    fn abs(self) -> Self;
    /// True if every lane is at most `bound` (NaN is not).
    fn all_at_most(self, bound: f64) -> bool;
    /// The smaller, or `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger, or `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// The lane where `a` equals `b`, zero elsewhere.
    fn where_equal(self, a: Self, b: Self) -> Self;
    /// Lanes [a, b, c, d] in the order [c, d, a, b].
    fn halves_swapped(self) -> Self;
    /// Lane `i` (0 to 3) four times.
    fn spread(self, i: usize) -> Self;
    /// Columns of the 4 × 4 matrix with these rows.
    fn transposed(rows: [Self; 4]) -> [Self; 4];

    /// Lane `i` (0 to 3).
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        self.store()[i]
    }

    /// Sum of the lanes of each: [Σ v₀, Σ v₁, Σ v₂, Σ v₃].
    #[inline(always)]
    fn sums(v: [Self; 4]) -> Self {
        let [a, b, c, d] = Self::transposed(v);
        (a + c) + (b + d)
    }

    /// Sum of the lanes, as in [`Self::sums`].
    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d] = self.store();
        (a + c) + (b + d)
    }
}

/// Twelve numbers in three groups of four lanes.
#[derive(Clone, Copy, Debug)]
pub struct Twelve<V>(pub [V; 3]);

// No closures here and in other code generic over lanes: a closure is compiled as a separate function,
// without the vector instructions, and is then not inlined.
macro_rules! twelve {
    ($($operator:ident $name:ident $sign:tt),+) => {
        $(impl<V: Lanes> $operator for Twelve<V> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, b: Self) -> Self {
                let (a, b) = (self.0, b.0);
                Self([a[0] $sign b[0], a[1] $sign b[1], a[2] $sign b[2]])
            }
        })+
    };
}
twelve!(Add add +, Sub sub -, Mul mul *);

impl<V: Lanes> Mul<V> for Twelve<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: V) -> Self {
        let a = self.0;
        Self([a[0] * b, a[1] * b, a[2] * b])
    }
}

impl<V: Lanes> Twelve<V> {
    /// Loads the twelve numbers from memory.
    #[inline(always)]
    pub fn load(x: &[[f64; 4]; 3]) -> Self {
        Self([V::load(&x[0]), V::load(&x[1]), V::load(&x[2])])
    }

    /// Stores the twelve numbers to memory.
    #[inline(always)]
    pub fn store(self) -> [[f64; 4]; 3] {
        let [a, b, c] = self.0;
        [a.store(), b.store(), c.store()]
    }

    /// Sum of the three groups, lane by lane.
    #[inline(always)]
    pub fn folded(self) -> V {
        let [a, b, c] = self.0;
        a + b + c
    }
}

/// Four numbers on any machine.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct Narrow([f64; 4]);

macro_rules! narrow {
    ($($operator:ident $name:ident $sign:tt),+) => {
        $(impl $operator for Narrow {
            type Output = Self;
            #[inline(always)]
            fn $name(self, b: Self) -> Self {
                let (a, b) = (self.0, b.0);
                Self([a[0] $sign b[0], a[1] $sign b[1], a[2] $sign b[2], a[3] $sign b[3]])
            }
        })+
    };
}
narrow!(Add add +, Sub sub -, Mul mul *, Div div /);

impl Narrow {
    /// The lane where `taken` is true, the lane of `others` elsewhere.
    #[inline(always)]
    fn or_where(self, others: &[f64; 4], taken: impl Fn(usize) -> bool) -> Self {
        Self([0, 1, 2, 3].map(|i| if taken(i) { self.0[i] } else { others[i] }))
    }
}

impl Lanes for Narrow {
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; 4])
    }
    #[inline(always)]
    fn load(x: &[f64; 4]) -> Self {
        Self(*x)
    }
    #[inline(always)]
    fn store(self) -> [f64; 4] {
        self.0
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([a.sqrt(), b.sqrt(), c.sqrt(), d.sqrt()])
    }
    #[inline(always)]
    fn abs(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([a.abs(), b.abs(), c.abs(), d.abs()])
    }
    #[inline(always)]
    fn all_at_most(self, bound: f64) -> bool {
        let [a, b, c, d] = self.0;
        a <= bound && b <= bound && c <= bound && d <= bound
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.or_where(&other.0, |i| self.0[i] < other.0[i])
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.or_where(&other.0, |i| self.0[i] > other.0[i])
    }
    #[inline(always)]
    fn where_equal(self, a: Self, b: Self) -> Self {
        self.or_where(&[0.0; 4], |i| a.0[i] == b.0[i])
    }
    #[inline(always)]
    fn halves_swapped(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([c, d, a, b])
    }
    #[inline(always)]
    fn spread(self, i: usize) -> Self {
        Self([self.0[i]; 4])
    }
    #[inline(always)]
    fn transposed(rows: [Self; 4]) -> [Self; 4] {
        [0, 1, 2, 3].map(|i| Self(rows.map(|row| row.0[i])))
    }
}

#[cfg(target_arch = "x86_64")]
pub use wide::Wide;

#[cfg(target_arch = "x86_64")]
mod wide {
    use super::{Add, Div, Lanes, Mul, Sub};
    use std::arch::x86_64::*;

    /// Four numbers in a register of a processor with AVX2. Use only inside functions compiled for AVX2: there the
    /// operations are single instructions. On other processors they are undefined behaviour.
    #[derive(Clone, Copy, Debug)]
    pub struct Wide(__m256d);

    macro_rules! wide {
        ($($operator:ident $name:ident $instruction:ident),+) => {
            $(impl $operator for Wide {
                type Output = Self;
                #[inline(always)]
                fn $name(self, b: Self) -> Self {
                    // SAFETY: a value of this type exists only on a processor with AVX2.
                    Self(unsafe { $instruction(self.0, b.0) })
                }
            })+
        };
    }
    wide!(Add add _mm256_add_pd, Sub sub _mm256_sub_pd, Mul mul _mm256_mul_pd, Div div _mm256_div_pd);

    // SAFETY of all that follows: `Plant::step` reaches this code only on a processor with AVX2;
    // loads and stores are of whole arrays, at any alignment.
    impl Lanes for Wide {
        #[inline(always)]
        fn splat(x: f64) -> Self {
            Self(unsafe { _mm256_set1_pd(x) })
        }
        #[inline(always)]
        fn load(x: &[f64; 4]) -> Self {
            Self(unsafe { _mm256_loadu_pd(x.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> [f64; 4] {
            let mut out = [0.0; 4];
            unsafe { _mm256_storeu_pd(out.as_mut_ptr(), self.0) };
            out
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm256_sqrt_pd(self.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), self.0) })
        }
        #[inline(always)]
        fn all_at_most(self, bound: f64) -> bool {
            unsafe {
                let mask = _mm256_cmp_pd::<_CMP_LE_OQ>(self.0, _mm256_set1_pd(bound));
                _mm256_movemask_pd(mask) == 0b1111
            }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(unsafe { _mm256_min_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(unsafe { _mm256_max_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn where_equal(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm256_and_pd(self.0, _mm256_cmp_pd::<_CMP_EQ_OQ>(a.0, b.0)) })
        }
        #[inline(always)]
        fn halves_swapped(self) -> Self {
            Self(unsafe { _mm256_permute2f128_pd::<1>(self.0, self.0) })
        }
        #[inline(always)]
        fn spread(self, i: usize) -> Self {
            Self(unsafe {
                match i {
                    0 => _mm256_permute4x64_pd::<0x00>(self.0),
                    1 => _mm256_permute4x64_pd::<0x55>(self.0),
                    2 => _mm256_permute4x64_pd::<0xaa>(self.0),
                    _ => _mm256_permute4x64_pd::<0xff>(self.0),
                }
            })
        }
        #[inline(always)]
        fn transposed([a, b, c, d]: [Self; 4]) -> [Self; 4] {
            unsafe {
                let (ab0, ab1) = (_mm256_unpacklo_pd(a.0, b.0), _mm256_unpackhi_pd(a.0, b.0));
                let (cd0, cd1) = (_mm256_unpacklo_pd(c.0, d.0), _mm256_unpackhi_pd(c.0, d.0));
                [
                    Self(_mm256_permute2f128_pd::<0x20>(ab0, cd0)),
                    Self(_mm256_permute2f128_pd::<0x20>(ab1, cd1)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab0, cd0)),
                    Self(_mm256_permute2f128_pd::<0x31>(ab1, cd1)),
                ]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Results of every operation on the same numbers, as bits.
    fn all<V: Lanes>(rows: &[[f64; 4]; 4]) -> Vec<u64> {
        let v: [V; 4] = std::array::from_fn(|i| V::load(&rows[i]));
        let [a, b, c, _] = v;
        let mut out = vec![
            a + b,
            a - b,
            a * b,
            a / b,
            a.abs().sqrt(),
            b.abs(),
            a.min(b),
            a.max(b),
            c.min(a),
            c.max(a),
            a.halves_swapped(),
            a.where_equal(b, c),
            a.where_equal(b, b),
            V::sums(v),
            V::splat(a.sum()),
        ];
        out.extend((0..4).map(|i| b.spread(i)));
        out.extend((0..4).map(|i| V::splat(b.lane(i))));
        out.extend(V::transposed(v));
        let small = v.map(|x| f64::from(x.all_at_most(400.0)));
        out.push(V::load(&small));
        out.iter().flat_map(|x| x.store().map(canonical)).collect()
    }

    /// Bits of a number; every NaN has the same bits.
    fn canonical(x: f64) -> u64 {
        if x.is_nan() { u64::MAX } else { x.to_bits() }
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn both_implementations_give_identical_bits() {
        #[target_feature(enable = "avx2")]
        fn wide(rows: &[[f64; 4]; 4]) -> Vec<u64> {
            all::<Wide>(rows)
        }
        if !std::arch::is_x86_feature_detected!("avx2") {
            return;
        }
        let special = [
            0.0,
            -0.0,
            f64::NAN,
            f64::INFINITY,
            -1.5,
            1e-310,
            7.25,
            -3e200,
        ];
        let mut seed = 1u64;
        for _ in 0..20_000 {
            let rows: [[f64; 4]; 4] = std::array::from_fn(|_| {
                std::array::from_fn(|_| {
                    seed = seed
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    match seed >> 60 {
                        0 => special[(seed >> 32) as usize % special.len()],
                        _ => ((seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 1e3,
                    }
                })
            });
            // SAFETY: the processor has AVX2.
            assert_eq!(all::<Narrow>(&rows), unsafe { wide(&rows) });
        }
    }
}
