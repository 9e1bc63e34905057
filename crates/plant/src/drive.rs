//! Open-loop drives on which speed and accuracy of the plant are measured: `examples/drives.rs`.

use crate::reference::Reference;
use crate::{Brush, Creep, PlantConfig, TICK_S, Tyre};
use declare::ConfigError;

/// An open-loop drive: a plant and wheel torques over time.
#[derive(Clone, Copy, Debug)]
pub struct Drive {
    /// Name, printed with the results.
    pub name: &'static str,
    /// Writes the drive's tyre and imperfections into the constants of the configured robot.
    pub robot: fn(&mut PlantConfig),
    /// Amplitude (N m) and rate (rad/s) of the torque common to all wheels.
    pub base: [f64; 2],
    /// Amplitude (N m) and rate (rad/s) of the torque that turns the axles against each other.
    pub steer: [f64; 2],
}

/// Speeds up to 0.9 m/s with the frame bent to 50°: beyond the commands of the controllers.
pub const NORMAL: Drive = Drive {
    name: "normal",
    robot: |c| c.tyre = Tyre::Creep(Creep { velocity_m_s: 0.01 }),
    base: [0.15, 1.3],
    steer: [0.4, 0.9],
};

/// Wheels spinning on stiff tyres, the frame bent to 130° and pulled taut with hundreds of newtons.
pub const HARSH: Drive = Drive {
    name: "harsh",
    robot: |c| {
        c.tyre = Tyre::Creep(Creep {
            velocity_m_s: 0.003,
        })
    },
    base: [1.2, 2.0],
    steer: [1.0, 3.1],
};

/// Normal and harsh drive with both tyre laws, then the normal drive with every imperfection of the plant.
pub const DRIVES: [Drive; 5] = [
    NORMAL,
    HARSH,
    Drive {
        name: "normal, brush tyre",
        robot: |c| c.tyre = Tyre::Brush(Brush::default()),
        ..NORMAL
    },
    Drive {
        name: "harsh, brush tyre",
        robot: |c| c.tyre = Tyre::Brush(Brush::default()),
        ..HARSH
    },
    Drive {
        name: "normal, every imperfection",
        robot: |c| {
            *c = PlantConfig {
                tyre: Tyre::Brush(Brush {
                    slip_stiffness: [[15.0, 20.0], [26.0, 18.0]].into(),
                    ..Brush::default()
                }),
                friction: 0.6,
                static_excess: 0.2,
                rolling_resistance: 0.03,
                side_slip: [0.002, -0.002].into(),
                carpet_drift: [0.005, -0.005],
                radius_load_sensitivity: 1e-3,
                payload_kg: [0.5, 0.3].into(),
                payload_position_m: [[0.02, 0.05], [-0.03, 0.02]].into(),
                center_of_mass_height_m: 0.08,
                backlash_rad: [[5e-3; 2]; 1].into(),
                cogging_torque_n_m: 0.01,
                rigid_root_m: 5e-3,
                rigid_tip_m: 5e-3,
                clamp_angle_root_rad: 0.01,
                clamp_angle_tip_rad: -0.01,
                ..c.clone()
            }
        },
        ..NORMAL
    },
];

impl Drive {
    /// The constants in `config` with the drive's tyre and imperfections.
    pub fn config(&self, config: &PlantConfig) -> PlantConfig {
        let mut config = config.clone();
        (self.robot)(&mut config);
        config
    }

    /// Wheel torques of `axles` axles at time `t` (s), N m. The outer axles are turned against each other, the inner
    /// axles by values in between.
    pub fn torque(&self, t: f64, axles: usize) -> Vec<[f64; 2]> {
        let wave = |[amplitude, rate]: [f64; 2]| amplitude * libm::sin(rate * t);
        let (base, steer) = (wave(self.base), wave(self.steer));
        let of = |axle: usize| {
            let steer = steer * (1.0 - 2.0 * axle as f64 / (axles - 1) as f64);
            [base - steer, base + steer]
        };
        (0..axles).map(of).collect()
    }

    /// Largest difference in position (m) and heading (rad) of an axle between the plant and a reference with steps of
    /// 20 µs (8 µs with the brush tyre, which is stiffer at rest). NaN if the reference lost the equilibrium of a
    /// frame.
    pub fn error(
        &self,
        config: &PlantConfig,
        axles: usize,
        seconds: f64,
    ) -> Result<[f64; 2], ConfigError> {
        let mut plant = config.build(axles)?;
        let start: Vec<_> = plant.axles().iter().map(|axle| axle.posture).collect();
        let mut reference = Reference::new(config, &start)?;
        let finest = match config.tyre {
            Tyre::Creep(_) => 20e-6,
            Tyre::Brush(_) => 8e-6,
        };
        let fine = (TICK_S / finest).ceil() as usize;
        let mut worst = [0.0f64; 2];
        for k in 0..(seconds / TICK_S).round() as usize {
            let torque = self.torque(k as f64 * TICK_S, axles);
            plant.step(&torque);
            reference.advance(TICK_S, fine, &torque);
            for (axle, q) in plant.axles().iter().zip(reference.postures()) {
                let p = axle.posture;
                worst[0] = worst[0].max(libm::hypot(p[0] - q[0], p[1] - q[1]));
                worst[1] = worst[1].max((p[2] - q[2]).abs());
            }
        }
        Ok(if reference.lost { [f64::NAN; 2] } else { worst })
    }
}
