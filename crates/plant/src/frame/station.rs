//! Prepared places along the strip, for repeated queries of position and curvature.

use super::super::lanes::{Lanes, Narrow, Twelve};
use super::super::legendre::{LANES, MODE, MODES, NODES, ORDER, POINTS, Strand, WEIGHTS};
use super::super::legendre::{polynomial, slope};
use super::{Equilibrium, Strip};

/// Prepared place along the strip. Integrals from the root to the place are sums over the twelve quadrature nodes, with
/// the weights of the polynomial through the nodes.
#[derive(Clone, Copy, Debug)]
pub struct Station {
    weights: Strand,
    /// Curvature polynomials at the place, in the order of [`MODE`].
    curvature: [f64; MODES],
}

/// Tangents of the strip at the nodes, each as long as the stretch of the strip there.
pub struct Tangents {
    x: Twelve<Narrow>,
    y: Twelve<Narrow>,
}

impl Strip {
    /// Prepares the place at arc length `s` (m, clamped to the strip).
    pub fn station(&self, s: f64) -> Station {
        let xi = 2.0 * (s / self.length).clamp(0.0, 1.0) - 1.0;
        let mut weights = [[0.0; 4]; 3];
        for n in 0..POINTS {
            let (pair, side) = LANES[n / 4][n % 4];
            let node = side * NODES[pair];
            // The discrete transform of the nodes to Legendre orders, each integrated up to ξ.
            weights[n / 4][n % 4] = WEIGHTS[pair]
                * (0..POINTS)
                    .map(|k| (2 * k + 1) as f64 * polynomial(k, node) * slope(k, xi))
                    .sum::<f64>();
        }
        Station {
            weights,
            curvature: MODE.map(|order| polynomial(order, xi)),
        }
    }

    /// Tangents of an equilibrium, from which positions along the strip follow.
    pub fn tangents(&self, e: &Equilibrium) -> Tangents {
        let p = self.points::<Narrow>(&e.unknowns, e.end[2]);
        let stretch = Twelve([Narrow::splat(1.0); 3]) + p.tension * Narrow::splat(self.stretch);
        Tangents {
            x: p.cos * stretch,
            y: p.sin * stretch,
        }
    }

    /// Position of a place (m) in the root frame.
    #[inline]
    pub fn position(&self, tangents: &Tangents, station: &Station) -> [f64; 2] {
        let weights = Twelve::load(&station.weights);
        [tangents.x, tangents.y].map(|t| self.length * (weights * t).folded().sum())
    }

    /// [`Strip::elastic_curvature`] at a prepared place, 1/m.
    #[inline]
    pub fn curvature_at(&self, e: &Equilibrium, tangents: &Tangents, station: &Station) -> f64 {
        let [x, y] = self.position(tangents, station);
        let [fx, fy, _] = self.wrench(e);
        (self.root_moment(e) + fx * y - fy * x) / self.bending
    }

    /// [`Strip::series_curvature`] at a prepared place, 1/m.
    pub fn series_curvature_at(&self, e: &Equilibrium, station: &Station) -> f64 {
        let mut k = e.end[2];
        for i in 0..ORDER - 1 {
            k += (e.unknowns[i] - self.natural[i]) * station.curvature[i];
        }
        k / self.length
    }
}
