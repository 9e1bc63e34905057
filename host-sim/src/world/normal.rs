//! Standard normal distribution with identical draws on every machine: logarithm and exponential are from `libm`.
//!
//! The ziggurat of Marsaglia and Tsang, "The Ziggurat Method for Generating Random Variables", Journal of Statistical
//! Software 5 (2000), with 256 layers, as in Doornik, "An Improved Ziggurat Method to Generate Normal Random Samples"
//! (2005).

use rand::{Rng, RngExt};
use std::sync::LazyLock;

/// Edge of the lowest layer, where the tail begins.
const EDGE: f64 = 3.654_152_885_361_009;
/// Area of a layer.
const AREA: f64 = 0.004_928_673_233_99;
const LAYERS: usize = 256;

/// Right edges of the layers from the lowest to the highest, and the density at each edge. The first edge is the edge
/// of a rectangle with the area of the lowest layer and its tail.
struct Layers {
    edge: [f64; LAYERS + 1],
    density: [f64; LAYERS + 1],
}

static TABLE: LazyLock<Layers> = LazyLock::new(|| {
    let mut edge = [0.0; LAYERS + 1];
    edge[0] = AREA / density(EDGE);
    edge[1] = EDGE;
    for i in 2..LAYERS {
        edge[i] = (-2.0 * libm::log(AREA / edge[i - 1] + density(edge[i - 1]))).sqrt();
    }
    Layers {
        density: edge.map(density),
        edge,
    }
});

/// Normal density at `x`, without its constant factor.
fn density(x: f64) -> f64 {
    libm::exp(-x * x / 2.0)
}

/// A number from 0 to 1, both excluded.
fn open(random: &mut impl Rng) -> f64 {
    const STEPS: f64 = (1u64 << 52) as f64;
    ((random.next_u64() >> 12) as f64 + 0.5) / STEPS
}

/// A draw of the tail beyond [`EDGE`].
fn tail(random: &mut impl Rng) -> f64 {
    loop {
        let beyond = libm::log(open(random)) / EDGE;
        if -2.0 * libm::log(open(random)) >= beyond * beyond {
            return EDGE - beyond;
        }
    }
}

/// A draw of mean 0 and standard deviation 1.
pub fn standard_normal(random: &mut impl Rng) -> f64 {
    const HALF: f64 = (1u64 << 51) as f64;
    let Layers { edge, density } = &*TABLE;
    loop {
        let bits = random.next_u64();
        let layer = (bits & 0xff) as usize;
        // Uniform from −1 to 1.
        let share = (bits >> 12) as f64 / HALF - 1.0;
        let x = share * edge[layer];
        if x.abs() < edge[layer + 1] {
            return x;
        }
        if layer == 0 {
            return tail(random).copysign(share);
        }
        let [low, high] = [density[layer], density[layer + 1]];
        if high + (low - high) * random.random::<f64>() < self::density(x) {
            return x;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::random::{Stream, generator};
    use rand_distr::{Distribution, StandardNormal};

    /// `rand_distr` has printed tables, so the last digits of a draw may differ.
    #[test]
    fn draws_match_rand_distr() {
        let [mut ours, mut theirs] = [0; 2].map(|_| generator(3, 0, Stream::Other(0)));
        let mut beyond = 0;
        for _ in 0..2_000_000 {
            let (x, y) = (
                standard_normal(&mut ours),
                StandardNormal.sample(&mut theirs),
            );
            let y: f64 = y;
            assert!((x - y).abs() <= 1e-15 * y.abs(), "{x} {y}");
            beyond += usize::from(x.abs() > EDGE);
        }
        // Expected beyond the edge: 516 draws, from two tails of probability 1.29e-4.
        assert!((400..650).contains(&beyond), "{beyond}");
    }
}
