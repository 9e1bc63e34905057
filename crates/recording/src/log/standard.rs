//! Messages in Foxglove's own schemas.

use crate::entry::Pose as Planar;
use foxglove::messages::{
    Color, CubePrimitive, FrameTransform, FrameTransforms, LinePrimitive, Point3, Pose,
    PoseInFrame, PosesInFrame, Quaternion, SceneEntity, SceneUpdate, Timestamp, Vector3,
    line_primitive,
};
use host_sim::run::robot::Record;
use host_sim::world::body::Body;

/// Name of the coordinate frame in which all messages are given.
const WORLD: &str = "world";
/// Height of the frame's drawing above the ground, m.
const FRAME_HEIGHT_M: f64 = 0.06;

/// Time stamp of a message at a simulated time, ns.
pub fn stamp(nanos: u64) -> Timestamp {
    Timestamp::new(
        (nanos / 1_000_000_000) as u32,
        (nanos % 1_000_000_000) as u32,
    )
}

fn translation(pose: &Planar) -> Vector3 {
    Vector3 {
        x: pose.x_m,
        y: pose.y_m,
        z: 0.0,
    }
}

fn rotation(phi: f64) -> Quaternion {
    let (z, w) = libm::sincos(0.5 * phi);
    Quaternion {
        x: 0.0,
        y: 0.0,
        z,
        w,
    }
}

fn pose(planar: &Planar) -> Pose {
    Pose {
        position: Some(translation(planar)),
        orientation: Some(rotation(planar.phi_rad)),
    }
}

/// Message with a posture in world coordinates.
pub fn in_world(nanos: u64, planar: &Planar) -> PoseInFrame {
    PoseInFrame {
        timestamp: Some(stamp(nanos)),
        frame_id: WORLD.to_owned(),
        pose: Some(pose(planar)),
    }
}

/// Message with several postures in world coordinates.
pub fn path<'a>(nanos: u64, postures: impl IntoIterator<Item = &'a Planar>) -> PosesInFrame {
    PosesInFrame {
        timestamp: Some(stamp(nanos)),
        frame_id: WORLD.to_owned(),
        poses: postures.into_iter().map(pose).collect(),
    }
}

/// Transforms from world coordinates to the true and the estimated frames of the robot.
pub fn transforms(nanos: u64, frames: &[(&str, Planar)]) -> FrameTransforms {
    let one = |(name, planar): &(&str, Planar)| FrameTransform {
        timestamp: Some(stamp(nanos)),
        parent_frame_id: WORLD.to_owned(),
        child_frame_id: (*name).to_owned(),
        translation: Some(translation(planar)),
        rotation: Some(rotation(planar.phi_rad)),
    };
    FrameTransforms {
        transforms: frames.iter().map(one).collect(),
    }
}

const fn color(r: f64, g: f64, b: f64) -> Color {
    Color { r, g, b, a: 1.0 }
}

/// Message with the 3D scene: wheels, axles and bent frames.
pub fn scene(nanos: u64, record: &Record, body: &Body) -> SceneUpdate {
    let mut cubes = Vec::new();
    let mut lines = Vec::new();
    let line = |points: Vec<Point3>, thickness, color| LinePrimitive {
        r#type: line_primitive::Type::LineStrip as i32,
        pose: None,
        thickness,
        scale_invariant: false,
        points,
        color: Some(color),
        colors: Vec::new(),
        indices: Vec::new(),
    };
    for axle in &record.axles {
        let [x, y, phi] = axle.posture;
        let (s, c) = libm::sincos(phi);
        let wheels = [body.half_track_m, -body.half_track_m].map(|d| (x - d * s, y + d * c));
        for (x_m, y_m) in wheels {
            let mut place = pose(&[x_m, y_m, phi].into());
            if let Some(position) = &mut place.position {
                position.z = body.wheel_radius_m;
            }
            cubes.push(CubePrimitive {
                pose: Some(place),
                size: Some(Vector3 {
                    x: 2.0 * body.wheel_radius_m,
                    y: body.wheel_width_m,
                    z: 2.0 * body.wheel_radius_m,
                }),
                color: Some(color(0.2, 0.2, 0.2)),
            });
        }
        let z = body.wheel_radius_m;
        let ends = wheels.map(|(x, y)| Point3 { x, y, z });
        lines.push(line(ends.to_vec(), 0.02, color(0.4, 0.4, 0.45)));
    }
    for frame in &record.frames {
        let points = frame.points.map(|[x, y]| Point3 {
            x: x.into(),
            y: y.into(),
            z: FRAME_HEIGHT_M,
        });
        lines.push(line(points.to_vec(), 0.01, color(0.85, 0.35, 0.1)));
    }
    let entity = SceneEntity {
        timestamp: Some(stamp(nanos)),
        frame_id: WORLD.to_owned(),
        id: "robot".to_owned(),
        cubes,
        lines,
        ..SceneEntity::default()
    };
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}
