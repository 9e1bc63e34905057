//! A 16-bit encoder counter extended to 32 bits.
//!
//! The difference of two readings, modulo 2^16, is the motion between them if the motion is below 2^15 counts. With
//! 8192 counts per revolution and readings at 1 kHz, this limit is 4000 revolutions per second.

/// Count of 32 bits, built from a counter of 16 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extended {
    last: u16,
    total: i32,
}

impl Extended {
    /// Begins at zero with the counter at `counter`.
    pub const fn starting_at(counter: u16) -> Self {
        Self {
            last: counter,
            total: 0,
        }
    }

    /// Takes the counter; returns the count since [`Self::starting_at`], which wraps as an `i32`.
    pub fn step(&mut self, counter: u16) -> i32 {
        let moved = counter.wrapping_sub(self.last) as i16;
        self.last = counter;
        self.total = self.total.wrapping_add(i32::from(moved));
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    properties! {
        /// The reference is a position of 64 bits, whose low bits are the counter.
        #[test]
        fn no_count_is_lost(
            start in any::<i64>().prop_map(|x| x >> 8),
            steps in proptest::collection::vec(-32_768i64..=32_767, 1..200),
        ) {
            let mut position = start;
            let mut extended = Extended::starting_at(position as u16);
            for step in steps {
                position += step;
                prop_assert_eq!(extended.step(position as u16), (position - start) as i32);
            }
        }
    }

    #[test]
    fn count_survives_wraps_of_16_and_32_bits() {
        // 2^33 counts forward in steps of 30 000, past the wrap of 16 and of 32 bits.
        let (mut position, mut extended) = (0i64, Extended::starting_at(0));
        while position < 1 << 33 {
            position += 30_000;
            assert_eq!(extended.step(position as u16), position as i32);
        }
    }
}
