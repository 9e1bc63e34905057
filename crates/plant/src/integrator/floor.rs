//! Effects of the floor on the axles: drift of a carpet, gravity along a slope.

use crate::geometry::{Geometry, rotate, small_turn, unrotate};
use crate::state::AxleState;

/// Directions (cos, sin) of the axles.
#[inline(always)]
pub fn directions_of<const N: usize, const F: usize>(geometry: &[Geometry; F]) -> [[f64; 2]; N] {
    let mut directions = [geometry[F - 1].rear; N];
    for f in 0..F {
        directions[f] = geometry[f].front;
    }
    directions
}

/// Displacement by the floor per distance rolled, forward and left at the wheels of two axles, in the middle of a
/// part `h` (s) of a step. `directions` are the axles' directions at the start of the part; `carpet` is the
/// displacement per distance rolled in global coordinates.
#[inline(always)]
pub fn drift(
    carpet: [f64; 2],
    axles: &[AxleState],
    directions: [[f64; 2]; 2],
    h: f64,
) -> [[f64; 4]; 2] {
    let mut drift = [[0.0; 4]; 2];
    for (i, axle) in axles.iter().enumerate() {
        let ahead = rotate(&directions[i], small_turn(0.5 * h * axle.velocity[2]));
        let displacement = unrotate(&carpet, ahead);
        for n in 0..2 {
            drift[n][2 * i] = displacement[n];
            drift[n][2 * i + 1] = displacement[n];
        }
    }
    drift
}

/// Gravity along the floor (global, m/s²) in the axles' coordinates.
#[inline(always)]
pub fn downhill<const N: usize, const F: usize>(
    gravity: [f64; 2],
    geometry: &[Geometry; F],
) -> [[f64; 2]; N] {
    let mut local = directions_of(geometry);
    for local in &mut local {
        *local = unrotate(&gravity, *local);
    }
    local
}
