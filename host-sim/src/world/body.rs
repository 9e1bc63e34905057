//! Outline of the robot for pictures and 3D scenes.

use plant::PlantConfig;

/// Outline of the robot seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Half the distance between the wheels of an axle, m.
    pub half_track_m: f64,
    /// Radius of a wheel, m.
    pub wheel_radius_m: f64,
    /// Width of a wheel, m.
    pub wheel_width_m: f64,
}

impl Body {
    /// Outline of the robot with these constants of the plant.
    pub fn of(plant: &PlantConfig) -> Self {
        Self {
            half_track_m: plant.half_track_m[0],
            wheel_radius_m: plant.wheel_radius_m[0][0],
            wheel_width_m: 0.03,
        }
    }
}
