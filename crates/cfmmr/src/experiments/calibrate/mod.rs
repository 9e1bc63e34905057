//! Calibration of wheels, strain gauges and gyros. All procedures calibrate one simulated robot. Only the report reads
//! the robot's true errors.

pub mod gauges;
pub mod procedures;
pub mod real;
pub mod turns;
pub mod wheels;

use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{self, CanFrame, Message};
use core_algos::math::{Posture, Steering};
use core_algos::params::Settings;
use core_algos::time::EPOCH;
use core_algos::topology::{FrameId, Role};
use gauges::CalibrationPoint;
use host_sim::base::error::Error;
use host_sim::base::statistics;
use host_sim::paths::{Path, Waypoint};
use host_sim::run::bit_compare::Trace;
use host_sim::run::final_error::wrap;
use host_sim::run::path_run;
use host_sim::run::path_run::{PathMode, Route};
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::Target;
use host_sim::world::drawn::Drawn;
use host_sim::world::random::{Stream, generator, normal};
use host_sim::world::sensors::{AxleTruth, Sensors, Truth};
use std::f64::consts::TAU;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use turns::{Sum, Turn};
use wheels::{Lap, Return};

/// Standard deviation of an end position measured with tape and floor marks, m, along each axis.
pub const TAPE_SIGMA_M: f64 = 1e-3;
/// Relative standard deviation of a former's curvature.
pub const FORMER_SIGMA: f64 = 1e-3;
/// Standard deviation of the angle at which a turn by hand stops, rad.
pub const MARK_SIGMA_RAD: f64 = 2e-3;

/// Half side of the square that is driven to calibrate wheels, m.
const HALF_SIDE_M: f64 = 1.0;
/// Radius of the square's corners, m.
const CORNER_M: f64 = 0.6;

/// Simulated robot under calibration, with its boards.
pub struct CalibrationBench {
    robot: Drawn,
    seed: u64,
    /// True if the boards are outside of this process.
    remote: bool,
    boards: Option<Vec<Box<dyn Target>>>,
    /// Ends a drive with an error if true.
    pub interrupt: Arc<AtomicBool>,
}

/// Result of one drive along a calibration path.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationRun {
    /// Odometry and measured end of each axle, front first.
    pub axles: Vec<Return>,
    /// True less odometric change of heading of each axle, rad.
    pub heading: Vec<f64>,
    /// Measured less estimated end position of the robot, m.
    pub robot: [f64; 2],
    /// Root mean square error of the relative posture measured by the first frame: m, m, rad.
    pub beam: [f64; 3],
}

impl CalibrationBench {
    /// Bench with a robot drawn with `seed`. `boards` are the robot's boards; `None`: boards in this process.
    pub fn new(scenario: &Scenario, seed: u64, boards: Option<Vec<Box<dyn Target>>>) -> Self {
        Self {
            robot: scenario.world.draw(scenario.robot.topology(), seed, 0),
            seed,
            remote: boards.is_some(),
            boards,
            interrupt: Arc::default(),
        }
    }

    /// True errors of the drawn robot.
    pub fn robot(&self) -> &Drawn {
        &self.robot
    }

    /// Drives a path. Noise, placement and encoder phases are of random draw `run`; all other errors of the robot are
    /// of draw 0.
    pub fn drive(
        &mut self,
        scenario: &Scenario,
        path: &Path,
        run: u64,
    ) -> Result<CalibrationRun, Error> {
        let mut scenario = scenario.clone();
        let route = Route::new(path, 1, &scenario);
        let route = route.map_err(|error| Error::input(format!("path: {error}")))?;
        scenario.mission.start = route.start();
        let topology = scenario.robot.topology();
        let drawn = scenario.world.draw(topology, self.seed, run);
        let robot = Drawn {
            placement: drawn.placement,
            encoder_phase: drawn.encoder_phase,
            ..self.robot.clone()
        };
        let boards = self.boards.take();
        let targets = boards.unwrap_or_else(|| targets::in_process(topology));
        let mut simulation = Simulation::with(targets, &scenario, &robot, self.seed, run)?;
        simulation.record_trace();
        simulation.control_mut().interrupt = Some(self.interrupt.clone());
        let mut bus_postures = BusPostures::new(&simulation, &scenario);
        let mut relative = Vec::new();
        let mut estimate = Posture::ORIGIN;
        let outcome =
            path_run::drive_on(&mut simulation, &scenario, &route, PathMode::Follow, |m| {
                relative.push(m.record.frames[0].relative);
                estimate = m.record.lead.fused.robot.posture;
            })?;
        if self.interrupt.load(Relaxed) {
            return Err(Error::Interrupted(
                "interrupted: nothing is saved".to_owned(),
            ));
        }
        if let Some(why) = outcome.end.failure() {
            return Err(Error::Failure(format!("the robot did not return: {why}")));
        }
        let trace = simulation.take_trace();
        let frames = trace.iter().flat_map(Trace::frames);
        frames.for_each(|frame| bus_postures.receive(frame));
        let mut random = generator(self.seed, run, Stream::Other(77));
        let mut tape = || normal(&mut random, TAPE_SIGMA_M);
        let axles = simulation.plant().axles().iter().enumerate();
        let mut heading = Vec::new();
        let axles = axles.map(|(i, axle)| {
            let [x, y, phi] = between(bus_postures.axles[i], axle.posture);
            heading.push(wrap(phi - bus_postures.laps[i].end()[2]));
            Return {
                lap: bus_postures.laps[i].clone(),
                // The heading is computed from the marks of both wheels, which are one track apart.
                end: [
                    x + tape(),
                    y + tape(),
                    phi + (tape() - tape()) / bus_postures.track_m[i],
                ],
            }
        });
        let axles = axles.collect();
        let truth = between(bus_postures.midpoint, simulation.plant().midpoint());
        let estimate = [estimate.x, estimate.y, estimate.phi].map(f64::from);
        let estimate = between(route.start(), estimate);
        let robot = [0, 1].map(|k| truth[k] + tape() - estimate[k]);
        let settled = (scenario.mission.settle_s * 1e6) as u64 / EPOCH;
        let beam = bus_postures.beam_error(&relative, settled as usize + 1);
        if self.remote {
            self.boards = Some(simulation.release());
        }
        Ok(CalibrationRun {
            axles,
            heading,
            robot,
            beam,
        })
    }

    /// Mean counts of the gauges with the strip straight, then on formers of the given curvatures, 1/m.
    pub fn hold(
        &self,
        scenario: &Scenario,
        curvatures: &[f64],
    ) -> Result<Vec<CalibrationPoint>, Error> {
        const SAMPLES: usize = 3000;
        let bridge = &scenario.world.sensors.bridge;
        let configured_half_thickness = f64::from(scenario.robot.geometry.half_thickness_m);
        let mut random = generator(self.seed, 1, Stream::Other(78));
        // The straight edge is not exactly straight, which adds one strain to all gauges. Drift is 0 at zeroing.
        let edge = normal(&mut random, bridge.common_sigma_strain);
        let mut robot = self.robot.clone();
        robot.frames[0].bridge_drift = [0.0; MAX_GAUGES];
        let mut sensors = Sensors::new(&scenario.world.sensors, &robot, self.seed, 1)?;
        let middle = f64::from(bridge.full_scale_counts());
        let mut points = Vec::new();
        for curvature in [0.0].iter().chain(curvatures) {
            let strain = configured_half_thickness * curvature;
            let former = normal(&mut random, FORMER_SIGMA);
            let bent = bridge.half_thickness_m * curvature * (1.0 + former);
            let truth = Truth {
                strains: vec![vec![bent + edge; MAX_GAUGES]],
                ..Truth::default()
            };
            let mut sums = [0.0; MAX_GAUGES];
            for k in 0..SAMPLES + SETTLE_SAMPLES {
                let counts = sensors.sample(&truth).frames[0];
                for (sum, count) in sums.iter_mut().zip(counts) {
                    *sum += if k < SETTLE_SAMPLES {
                        0.0
                    } else {
                        f64::from(count)
                    };
                }
            }
            let counts = sums.map(|sum| middle + sum / SAMPLES as f64);
            points.push(CalibrationPoint { strain, counts });
        }
        Ok(points)
    }

    /// Gyro readings of each axle while the robot is turned by hand on the spot: three turns to the left, then three to
    /// the right, each between two rests.
    pub fn turn(&self, scenario: &Scenario) -> Result<Vec<Vec<Turn>>, Error> {
        const REST_SAMPLES: usize = 3000;
        const TURN_SAMPLES: usize = 18_000;
        let mut config = scenario.world.sensors.clone();
        config.gyro.fitted = true;
        let mut sensors = Sensors::new(&config, &self.robot, self.seed, 1)?;
        let mut random = generator(self.seed, 1, Stream::Other(79));
        let mut truth = Truth {
            axles: vec![AxleTruth::default(); self.robot.gyro_bias.len()],
            ..Truth::default()
        };
        let mut all = vec![Vec::new(); truth.axles.len()];
        for angle in [3.0 * TAU, -3.0 * TAU] {
            let turned = angle + normal(&mut random, MARK_SIGMA_RAD);
            let mut sums = vec![[Sum::default(); 3]; all.len()];
            for k in 0..REST_SAMPLES + TURN_SAMPLES + REST_SAMPLES {
                let part =
                    usize::from(k >= REST_SAMPLES) + usize::from(k >= REST_SAMPLES + TURN_SAMPLES);
                // The rate rises and falls smoothly, and is zero in the first and the last percent of the turn's
                // readings.
                let share = (k as f64 - REST_SAMPLES as f64) / TURN_SAMPLES as f64;
                let rate = match (part, (0.01..0.99).contains(&share)) {
                    (1, true) => {
                        let phase = (share - 0.01) / 0.98;
                        turned / (0.98 * TURN_SAMPLES as f64 * 1e-3)
                            * (1.0 - libm::cos(TAU * phase))
                    }
                    _ => 0.0,
                };
                for axle in &mut truth.axles {
                    axle.yaw_rate = rate;
                }
                let samples = sensors.sample(&truth);
                for (sums, axle) in sums.iter_mut().zip(&samples.axles) {
                    sums[part].add(axle.gyro.map_or(0.0, f64::from));
                }
            }
            for (turns, [before, turning, after]) in all.iter_mut().zip(sums) {
                turns.push(Turn {
                    rests: [before, after],
                    turning,
                    angle,
                });
            }
        }
        Ok(all)
    }
}

/// Samples discarded after a change, while filters and delays settle.
const SETTLE_SAMPLES: usize = 500;

/// Square with round corners, from the middle of a side along x; `direction` is 1 for a left turn, −1 for a right turn.
pub fn square(direction: f64) -> Result<Path, Error> {
    let (side, inner) = (2.0 * HALF_SIDE_M, HALF_SIDE_M - CORNER_M);
    let mut points = Vec::new();
    for quarter in 0..4 {
        let (s, c) = libm::sincos(f64::from(quarter) * TAU / 4.0);
        let mut add = |x: f64, y: f64| {
            // Rotates the first side about the middle of the square.
            let y = y - HALF_SIDE_M;
            let at = (c * x - s * y, direction * (s * x + c * y + HALF_SIDE_M));
            points.push(Waypoint::from(at));
        };
        add(0.0, 0.0);
        add(0.5 * inner, 0.0);
        for k in 0..6 {
            let (s, c) = libm::sincos(f64::from(k) * TAU / 24.0);
            add(inner + CORNER_M * s, CORNER_M * (1.0 - c));
        }
        add(HALF_SIDE_M, CORNER_M);
        add(HALF_SIDE_M, 0.5 * side - 0.5 * inner);
    }
    points.push(Waypoint::from((0.0, 0.0)));
    Path::through(&points).map_err(|error| Error::Failure(error.to_string()))
}

/// Postures that the axle and beam boards sent on the bus, and the true postures at the start.
struct BusPostures {
    axles: Vec<[f64; 3]>,
    midpoint: [f64; 3],
    laps: Vec<Lap>,
    /// Track configured in each axle's board, m.
    track_m: Vec<f64>,
    relative_heading: f64,
    beam: Vec<[f64; 3]>,
}

impl BusPostures {
    fn new(simulation: &Simulation, scenario: &Scenario) -> Self {
        let configured_track =
            |role| configured_axle(scenario, role).map_or(0.324, |axle| 2.0 * axle.half_track_m);
        let axles = simulation.plant().axles();
        let roles = scenario.robot.topology().axles().map(Role::Axle);
        Self {
            axles: axles.iter().map(|axle| axle.posture).collect(),
            midpoint: simulation.plant().midpoint(),
            laps: vec![Lap::default(); axles.len()],
            track_m: roles.map(configured_track).collect(),
            relative_heading: 0.0,
            beam: Vec::new(),
        }
    }

    fn receive(&mut self, frame: &CanFrame) {
        match bus::decode(frame) {
            Ok(Message::AxlePosture { axle, posture, .. }) => {
                let odometry = [posture.x, posture.y, posture.phi].map(f64::from);
                let axle = (
                    self.laps.get_mut(axle.index()),
                    self.track_m.get(axle.index()),
                );
                if let (Some(lap), Some(track)) = axle {
                    let epoch = EPOCH as f64 * 1e-6;
                    lap.add(odometry, *track, self.relative_heading, epoch);
                }
            }
            Ok(Message::BeamPosture {
                frame: FrameId(0),
                posture,
                gauges,
                ..
            }) => {
                let bad = if gauges > 0 { 0.0 } else { f64::NAN };
                let relative = [posture.x, posture.y, posture.phi].map(|v| f64::from(v) + bad);
                self.beam.push(relative);
            }
            // The relative heading is that of the commanded steering, which has no sensor errors.
            Ok(Message::LeadStatus { steering_rad, .. }) => {
                self.relative_heading = f64::from(Steering(steering_rad).relative_heading().0)
            }
            _ => {}
        }
    }

    /// Root mean square error of the beam board's postures from number `first` on: m, m, rad.
    fn beam_error(&self, truth: &[[f64; 3]], first: usize) -> [f64; 3] {
        let pairs = self.beam.iter().skip(first).zip(truth);
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for (measured, truth) in pairs {
            for k in 0..3 {
                sums[k] += statistics::square(measured[k] - truth[k]);
            }
            count += 1.0;
        }
        sums.map(|sum: f64| (sum / count).sqrt())
    }
}

/// Constants of an axle as configured in its board.
pub fn configured_axle(scenario: &Scenario, role: Role) -> Result<wheels::AxleConstants, Error> {
    let mut settings = Settings::new(scenario.robot);
    scenario.boards.apply(role, &mut settings)?;
    let geometry = &settings.robot.geometry;
    Ok(wheels::AxleConstants {
        radius_m: geometry.wheel_radius_m.into(),
        ratio: geometry.wheel_ratio.into(),
        half_track_m: geometry.half_track_m.into(),
    })
}

/// Posture `to` in the frame of posture `from`.
fn between(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    let (s, c) = libm::sincos(from[2]);
    let (x, y) = (to[0] - from[0], to[1] - from[1]);
    [c * x + s * y, c * y - s * x, wrap(to[2] - from[2])]
}
