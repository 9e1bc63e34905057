//! The frames `odom` and `map` (REP 105).
//!
//! Goals, paths and uncertainties are in `map`, the frame of the fused estimate. The estimate in `map` jumps: the
//! filter learns constants of the robot late, and each of them shifts the whole path driven so far. A controller that
//! followed would swerve. The controller therefore drives by `odom`, which moves by the corrected odometry and is
//! drawn towards `map` by a bounded share of the distance. At rest `odom` is `map`.

use crate::math::Posture;
use crate::math::trig::{clamp, sin_cos, sqrt, wrap_angle};

/// Largest correction of `odom` towards `map` per metre driven: m and rad.
const DRAWN_M_PER_M: f32 = 0.02;
const DRAWN_RAD_PER_M: f32 = 0.02;

/// Next posture of O in `odom`. `last` is the posture before (`None` at the start). `heading` and `moved` are the
/// heading of O before the motion and the motion by odometry, along the axes of `map`; `map` is the estimate.
/// `moving` is false for a robot at rest.
pub(super) fn step(
    last: Option<Posture>,
    (heading, moved): (f32, Posture),
    map: Posture,
    moving: bool,
) -> Posture {
    let (Some(last), true) = (last, moving) else {
        return map;
    };
    let (sin, cos) = sin_cos(last.phi - heading);
    let odom = Posture::new(
        last.x + cos * moved.x - sin * moved.y,
        last.y + sin * moved.x + cos * moved.y,
        last.phi + moved.phi,
    );
    let distance_m = sqrt(moved.x * moved.x + moved.y * moved.y);
    let [x, y, turn] = map.minus(odom);
    let share = (DRAWN_M_PER_M * distance_m / sqrt(x * x + y * y).max(1e-9)).min(1.0);
    let most = DRAWN_RAD_PER_M * distance_m;
    let turn = clamp(turn, -most, most);
    Posture::new(
        odom.x + share * x,
        odom.y + share * y,
        wrap_angle(odom.phi + turn),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Over a distance that allows a larger correction, `odom` moves by the whole difference and no further.
    #[test]
    fn odom_never_goes_beyond_map() {
        let last = Posture::new(0.0, 0.0, 0.0);
        for distance_m in [1.0f32, 100.0] {
            let map = Posture::new(distance_m + 1e-3, -2e-3, 1e-3);
            let odom = step(
                Some(last),
                (0.0, Posture::new(distance_m, 0.0, 0.0)),
                map,
                true,
            );
            assert!(odom.distance(map) < 1e-5 * distance_m, "{odom:?} {map:?}");
        }
        // No motion and no difference.
        let still = step(Some(last), (0.0, Posture::ORIGIN), last, true);
        assert_eq!(still, last);
    }

    /// 10 cm ahead per epoch in both frames; `map` jumps once.
    #[test]
    fn jump_of_map_reaches_odom_gradually_on_the_move_and_at_once_at_rest() {
        let ahead = Posture::new(0.1, 0.0, 0.0);
        let moved = |map: Posture| {
            let [x, y, phi] = map.compose(ahead).minus(map);
            (map.phi, Posture::new(x, y, phi))
        };
        let (mut odom, mut map) = (Posture::ORIGIN, Posture::new(0.0, 0.05, -0.1));
        assert_eq!(step(None, moved(map), map, true), map);
        for number in 1..=50u8 {
            let before = odom;
            let movement = moved(map);
            map = map.compose(ahead);
            odom = step(Some(before), movement, map, true);
            let [x, y, turn] = odom.minus(before.compose(ahead));
            assert!(
                sqrt(x * x + y * y) < 0.002 + 1e-5 && turn.abs() < 0.002 + 1e-6,
                "{number}"
            );
            // 0.02 rad/m of 5 m.
            let [_, _, left] = map.minus(odom);
            assert!(
                (left + 0.1 - 0.002 * f32::from(number)).abs() < 1e-4,
                "{number}: {left}"
            );
        }
        let map = map.compose(Posture::new(0.0, 0.3, 0.2));
        let at = |moving| step(Some(odom), (0.0, Posture::ORIGIN), map, moving);
        assert_eq!([at(true), at(false)], [odom, map]);
    }
}
