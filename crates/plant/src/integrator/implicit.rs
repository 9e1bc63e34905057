//! Linear equations that each stage of a step solves.

use super::{Group, pair};
use crate::geometry::{Geometry, Mat3, Vec3, add, inverse, product, scaled, times};
use crate::integrator::frame::Frame;
use crate::lanes::Lanes;
use crate::loads::Body;
use crate::wheel::{Contact, Eliminated};

/// The linear equations of a stage of length `h` (s), of `N` axles, `F` frames and `G` groups of wheels.
///
/// With A the axles' compliance, K the frames' response and J the derivative of the rates of the frames' ends with
/// respect to the axles' velocities, the change of the velocities is A·b − A·Jᵀ·K·r, where (I + J·A·Jᵀ·K)·r = J·A·b.
/// The matrix I + J·A·Jᵀ·K has blocks of 3 × 3 on and beside its diagonal, since a frame acts on two axles. The blocks
/// are eliminated from the first frame to the last.
pub struct Implicit<V, const N: usize, const F: usize, const G: usize> {
    h: f64,
    pub wheels: [Eliminated<V>; G],
    axle: [Mat3; N],
    /// Change of each frame's wrench for a unit change of its end's rate.
    frame: [Mat3; F],
    /// Inverse of each block on the diagonal, after elimination.
    pivot: [Mat3; F],
    /// Block before the diagonal, times the pivot of the frame ahead; unused for the first frame.
    before: [Mat3; F],
    /// Block behind the diagonal; unused for the last frame.
    behind: [Mat3; F],
}

impl<V: Lanes, const N: usize, const F: usize, const G: usize> Implicit<V, N, F, G> {
    #[inline(always)]
    pub fn new(
        (groups, bodies, frames): (&[Group; G], &[Body; N], &[Frame; F]),
        at: &[Contact<V>; G],
        h: f64,
    ) -> Self {
        let mut wheels = [groups[0].wheels.eliminate(&at[0], h); G];
        for g in 1..G {
            wheels[g] = groups[g].wheels.eliminate(&at[g], h);
        }
        let mut axle = [[[0.0; 3]; 3]; N];
        for g in 0..G {
            let damping = groups[g].wheels.damping(&wheels[g]);
            for (i, d) in (2 * g..N).zip(damping) {
                let [xx, xy, xt, yy, yt, tt] = d;
                let damping = [h * xx, h * xy, h * xt, h * yy, h * yt, h * tt];
                axle[i] = inverse(&bodies[i].with_damping(&damping));
            }
        }
        let mut frame = [[[0.0; 3]; 3]; F];
        let (mut pivot, mut before, mut behind) = (frame, frame, frame);
        for f in 0..F {
            frame[f] = frames[f].response(h);
            let geometry = &frames[f].geometry;
            // I + (compliance of the axles) · frame, column by column.
            let mut system = [[0.0; 3]; 3];
            for n in 0..3 {
                let column = [frame[f][0][n], frame[f][1][n], frame[f][2][n]];
                let [tip, root] = geometry.transpose(&column);
                let moved = [times(&axle[f], &tip), times(&axle[f + 1], &root)];
                let rate = geometry.rate(&moved);
                for m in 0..3 {
                    system[m][n] = rate[m];
                }
                system[n][n] += 1.0;
                if f > 0 {
                    // The axle ahead is at the root of the frame ahead.
                    let ahead = &frames[f - 1].geometry;
                    let rate = ahead.rate(&[[0.0; 3], moved[0]]);
                    let column = [frame[f - 1][0][n], frame[f - 1][1][n], frame[f - 1][2][n]];
                    let [_, root] = ahead.transpose(&column);
                    let back = geometry.rate(&[times(&axle[f], &root), [0.0; 3]]);
                    for m in 0..3 {
                        behind[f - 1][m][n] = rate[m];
                        before[f][m][n] = back[m];
                    }
                }
            }
            if f > 0 {
                before[f] = product(&before[f], &pivot[f - 1]);
                let eliminated = product(&before[f], &behind[f - 1]);
                for m in 0..3 {
                    system[m] = add(&system[m], -1.0, &eliminated[m]);
                }
            }
            pivot[f] = inverse(&system);
        }
        Self {
            h,
            wheels,
            axle,
            frame,
            pivot,
            before,
            behind,
        }
    }

    /// Change of the axles' velocities for the loads `b`, which include the frames' wrenches.
    #[inline(always)]
    pub fn solve(&self, geometry: &[Geometry; F], b: &[Vec3; N]) -> [Vec3; N] {
        let mut change = *b;
        for i in 0..N {
            change[i] = times(&self.axle[i], &scaled(self.h, &b[i]));
        }
        let mut rate = [[0.0; 3]; F];
        for f in 0..F {
            rate[f] = geometry[f].rate(&pair(&change, f));
            if f > 0 {
                rate[f] = add(&rate[f], -1.0, &times(&self.before[f], &rate[f - 1]));
            }
        }
        let mut wrench = rate;
        for f in (0..F).rev() {
            if f + 1 < F {
                rate[f] = add(&rate[f], -1.0, &times(&self.behind[f], &rate[f + 1]));
            }
            rate[f] = times(&self.pivot[f], &rate[f]);
            wrench[f] = times(&self.frame[f], &rate[f]);
        }
        let load: [Vec3; N] = on_axles(geometry, &wrench);
        for i in 0..N {
            change[i] = add(&change[i], -1.0, &times(&self.axle[i], &load[i]));
        }
        change
    }
}

/// The wrenches of the frames in the axles' coordinates.
#[inline(always)]
pub fn on_axles<const N: usize, const F: usize>(
    geometry: &[Geometry; F],
    wrench: &[Vec3; F],
) -> [Vec3; N] {
    let mut load = [[0.0; 3]; N];
    for f in 0..F {
        let [tip, root] = geometry[f].transpose(&wrench[f]);
        load[f] = if f == 0 {
            tip
        } else {
            add(&load[f], 1.0, &tip)
        };
        load[f + 1] = root;
    }
    load
}
