//! The frames `odom` and `map` (REP 105).
//!
//! Goals, paths and uncertainties are in `map`, the frame of the fused estimate. The estimate in `map` jumps: the
//! filter learns constants of the robot late, and each of them shifts the whole path driven so far. A controller that
//! followed would swerve. The controller therefore drives by `odom`, which moves by the corrected odometry and is
//! drawn towards `map`: a difference of less than 2 cm or 20 mrad by 2 cm and 20 mrad per metre, a larger one so that
//! it decays over 1 m. At rest `odom` is `map`.

use crate::math::trig::{clamp, sin_cos, sqrt, wrap_angle};
use crate::math::{Posture, greater};

/// Least correction of `odom` towards `map` per metre driven, if they differ by as much: m and rad.
const DRAWN_M_PER_M: f32 = 0.02;
const DRAWN_RAD_PER_M: f32 = 0.02;
/// Share of a larger difference that is corrected per metre driven. Uneven ground turns the odometry faster than
/// 20 mrad/m.
const DRAWN_SHARE_PER_M: f32 = 1.0;

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
    let gap_m = sqrt(x * x + y * y);
    let most_m = distance_m * greater(DRAWN_SHARE_PER_M * gap_m, DRAWN_M_PER_M);
    let share = (most_m / gap_m.max(1e-9)).min(1.0);
    let most = distance_m * greater(DRAWN_SHARE_PER_M * turn.abs(), DRAWN_RAD_PER_M);
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
        // Larger differences decay over 1 m; smaller ones by 2 cm and 20 mrad per metre.
        let next = |gap: f32| match gap > 0.02 {
            true => 0.9 * gap,
            false => (gap - 0.002).max(0.0),
        };
        let (mut turn_left, mut left_m) = (0.1, 0.0);
        for number in 1..=40u8 {
            let before = odom;
            let movement = moved(map);
            map = map.compose(ahead);
            odom = step(Some(before), movement, map, true);
            let [x, y, _] = odom.minus(before.compose(ahead));
            let drawn_m = sqrt(x * x + y * y);
            let [x, y, turn] = map.minus(odom);
            left_m = sqrt(x * x + y * y);
            turn_left = next(turn_left);
            assert!((turn.abs() - turn_left).abs() < 1e-4, "{number}: {turn}");
            let most_m = 0.1 * (left_m + drawn_m).max(0.02);
            assert!(drawn_m < most_m + 1e-5, "{number}: {drawn_m}");
        }
        assert!(left_m < 1e-4 && turn_left < 1e-4, "{left_m} {turn_left}");
        let map = map.compose(Posture::new(0.0, 0.3, 0.2));
        let at = |moving| step(Some(odom), (0.0, Posture::ORIGIN), map, moving);
        assert_eq!([at(true), at(false)], [odom, map]);
    }
}
