//! The frames `odom` and `map` (REP 105).
//!
//! Goals, paths and claims are in `map`, the frame of the fused estimate. That jumps: the filter learns constants of the
//! robot late, and with each the way that lies behind moves. A controller that followed would swerve.
//! It drives by `odom`: moved by odometry, corrected as it is by what was learnt, and drawn towards `map` by a
//! bounded share of the way. At rest nothing swerves, and `odom` is `map`.

use crate::math::Posture;
use crate::math::trig::{clamp, sin_cos, sqrt, wrap_angle};

/// Most that `odom` is drawn towards `map` on the move: m and rad over a metre.
const DRAWN_M_PER_M: f32 = 0.02;
const DRAWN_RAD_PER_M: f32 = 0.02;

/// The next posture of O in `odom`, from the `last` one (`None` at the start), the motion by odometry along the axes of
/// `map`, in which O had that heading before, and the estimate in `map`. `moving` is false for a robot at rest.
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
    let way = sqrt(moved.x * moved.x + moved.y * moved.y);
    let [x, y, turn] = map.minus(odom);
    let share = (DRAWN_M_PER_M * way / sqrt(x * x + y * y).max(1e-9)).min(1.0);
    let most = DRAWN_RAD_PER_M * way;
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

    /// A way long enough for the whole difference draws it, and no more.
    #[test]
    fn odom_never_goes_beyond_map() {
        let last = Posture::new(0.0, 0.0, 0.0);
        for way in [1.0f32, 100.0] {
            let map = Posture::new(way + 1e-3, -2e-3, 1e-3);
            let odom = step(Some(last), (0.0, Posture::new(way, 0.0, 0.0)), map, true);
            assert!(odom.distance(map) < 1e-5 * way, "{odom:?} {map:?}");
        }
        // Nothing moved, and nothing to draw.
        let still = step(Some(last), (0.0, Posture::ORIGIN), last, true);
        assert_eq!(still, last);
    }

    /// 10 cm ahead an epoch in both frames; `map` jumps once.
    #[test]
    fn a_jump_of_map_reaches_odom_by_a_share_of_the_way_and_whole_at_rest() {
        let ahead = Posture::new(0.1, 0.0, 0.0);
        let moved = |map: Posture| {
            let [x, y, phi] = map.compose(ahead).minus(map);
            (map.phi, Posture::new(x, y, phi))
        };
        let (mut odom, mut map) = (Posture::ORIGIN, Posture::new(0.0, 0.05, -0.1));
        assert_eq!(step(None, moved(map), map, true), map);
        for number in 1..=50u8 {
            let before = odom;
            let way = moved(map);
            map = map.compose(ahead);
            odom = step(Some(before), way, map, true);
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
