//! A robot without its plant: sensors, boards and bus in lockstep at 1 kHz.
//!
//! [`Rig::step`] takes the true state and gives the torques of the motors. Any model of the plant can supply the true
//! state.

use crate::base::error::Error;
use crate::bus::virtual_bus::VirtualBus;
use crate::run::bit_compare::Trace;
use crate::run::recovery::Monitor;
use crate::scenario::Scenario;
use crate::targets::{Boards, Failure, FailureMode, Outgoing, Target};
use crate::world::drawn::Drawn;
use crate::world::faults::{Fault, Injector, Readings};
use crate::world::sensors::{Sensors, Truth};
use core_algos::beam::calibration::Calibration;
use core_algos::beam::{MAX_GAUGES, PerGauge};
use core_algos::math::Posture;
use core_algos::node::axle;
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::params::{Inertial, Settings};
use core_algos::safety::Conditions;
use core_algos::time::{EPOCH, Micros, TICK};
use core_algos::topology::{FrameId, Role, Topology};

/// Sensors, boards and bus of one robot.
pub struct Rig {
    sensors: Sensors,
    topology: Topology,
    /// Inertial sensor drivers of the axle boards.
    inertial: Vec<Inertial>,
    /// Boards of the robot.
    pub boards: Boards,
    /// Bus between the boards.
    pub bus: VirtualBus,
    /// Monitor of the nodes' heartbeats.
    pub monitor: Monitor,
    /// Torques that the boards commanded at the latest tick, `[axle][left, right]`, N m.
    torque: Vec<[f64; 2]>,
    /// Torques of the motors at the latest tick, `[axle][left, right]`, N m.
    given: Vec<[f64; 2]>,
    tick: u64,
    /// Latest output of the lead node.
    lead: lead::Output,
    /// Trace of the boards, if recorded.
    pub(super) trace: Option<Trace>,
    injectors: Vec<Injector>,
    /// Calibration in the board of each frame.
    calibrations: Vec<Calibration>,
    /// Number of gauges of each frame; 0 without the relative position sensor.
    gauges: usize,
    /// Readings of the boards at the latest tick.
    readings: Readings,
    /// Count of the beam's converter at half of its range.
    converter_middle: i32,
    /// Largest count of the beam's converter.
    full_scale: i32,
}

impl Rig {
    /// Robot at rest at its start, with the errors `imperfections`. Random draws depend on `seed` and `trial` alone.
    pub fn new(
        targets: Vec<Box<dyn Target>>,
        scenario: &Scenario,
        imperfections: &Drawn,
        (seed, trial): (u64, u64),
    ) -> Result<Self, Error> {
        let settings = settings_of(scenario, imperfections)?;
        let configs = settings.iter().map(|board| board.robot).collect();
        let topology = scenario.robot.topology();
        let start = Posture::from(scenario.mission.start.map(|value| value as f32));
        let config = board_config(scenario, imperfections);
        let place = config.placement(start, &scenario.mission.configured_placement());
        let calibration = |board: &Settings| {
            let believed = &board.robot.beam;
            believed.calibration.build(believed.strip.gauges_m.count())
        };
        let frames = settings.iter().skip(topology.axle_count());
        let calibrations = frames.map(calibration).collect::<Result<_, _>>()?;
        let bridge = &scenario.world.sensors.bridge;
        let rps = scenario.mission.rps;
        let axles = topology.axle_count();
        Ok(Self {
            sensors: Sensors::new(&scenario.world.sensors, imperfections, seed, trial)?,
            topology,
            inertial: settings.iter().map(|board| board.inertial).collect(),
            boards: Boards::start(topology, targets, configs, &place, rps)?,
            bus: VirtualBus::new(
                topology,
                &scenario.world.bus,
                seed ^ trial.wrapping_mul(0x9e37_79b9_7f4a_7c15),
            ),
            monitor: Monitor::new(topology),
            torque: vec![[0.0; 2]; axles],
            given: vec![[0.0; 2]; axles],
            tick: 0,
            lead: lead::Output::default(),
            trace: None,
            injectors: Vec::new(),
            calibrations,
            gauges: if rps { bridge.gauges_m.len() } else { 0 },
            readings: Readings {
                axles: vec![axle::Samples::default(); axles],
                frames: vec![[0; MAX_GAUGES]; topology.frame_count()],
            },
            converter_middle: bridge.full_scale_counts(),
            full_scale: 2 * bridge.full_scale_counts() - 1,
        })
    }

    /// Simulated time, µs.
    pub fn now(&self) -> Micros {
        self.tick * TICK
    }

    /// Torques that the boards commanded at the latest tick, `[axle][left, right]`, N m.
    pub fn torque(&self) -> &[[f64; 2]] {
        &self.torque
    }

    /// Latest output of the lead node.
    pub fn lead(&self) -> &lead::Output {
        &self.lead
    }

    /// Injectors of the faults, in the order of [`Self::inject`].
    pub fn injectors(&self) -> &[Injector] {
        &self.injectors
    }

    /// Adds `strain` to the zeros of all gauges from now on.
    pub fn drift_gauges(&mut self, strain: f64) {
        self.sensors.drift_gauges(strain);
    }

    /// Injects a fault from `tick` on, beside those already injected. Losses and resets of boards need a tick each. The
    /// owner of the plant applies faults of the plant.
    pub fn inject(&mut self, fault: Fault, tick: u32) {
        let held = self.readings.clone();
        let injector = Injector::new(fault, tick, self.full_scale, held);
        self.injectors.push(injector);
    }

    /// One tick of the boards with the true state at the beginning of the tick; gives the torques of the motors until
    /// the next tick, `[axle][left, right]`, N m. As on hardware, a command takes effect one tick late.
    pub fn step(&mut self, truth: &Truth) -> Result<&[[f64; 2]], Error> {
        self.read(truth);
        self.step_boards()
    }

    /// As [`Self::step`], with given readings in place of the sensors.
    pub fn step_with(&mut self, readings: &Readings) -> Result<&[[f64; 2]], Error> {
        self.readings.clone_from(readings);
        self.step_boards()
    }

    /// One tick of the boards with the latest readings.
    fn step_boards(&mut self) -> Result<&[[f64; 2]], Error> {
        let (now, tick) = (self.now(), self.tick as u32);
        self.disturb(tick)?;
        let Self {
            boards,
            bus,
            trace,
            monitor,
            ..
        } = self;
        bus.deliver(now, |role, frame, message| {
            boards.receive(role, now, frame, message);
        });
        let outputs = boards.tick(tick, self.readings.samples(), &mut |outgoing| {
            let frame = match outgoing {
                Outgoing::Message(message) => bus.send(now, message),
                Outgoing::Frame(frame) => bus.send_frame(now, frame),
            };
            let Some(frame) = frame else {
                return;
            };
            monitor.receive(tick, &frame);
            if let Some(trace) = trace.as_mut() {
                trace.frame(tick, frame);
            }
        })?;
        if let Some(lead) = outputs[0].lead {
            self.lead = lead;
        }
        self.given.copy_from_slice(&self.torque);
        for injector in &self.injectors {
            injector.torque(tick, &mut self.given);
        }
        let axles = self.torque.len();
        let commanded = outputs.iter().take(axles).map(|it| it.torque_nm.list());
        for (torque, commanded) in self.torque.iter_mut().zip(commanded.clone()) {
            *torque = commanded.map(f64::from);
        }
        self.tick += 1;
        if let Some(trace) = &mut self.trace {
            trace.torque(commanded);
            if (self.tick * TICK).is_multiple_of(EPOCH) {
                trace.lead(&self.lead);
            }
        }
        Ok(&self.given)
    }

    /// Applies the injected fault to the readings, the boards and the bus.
    fn disturb(&mut self, tick: u32) -> Result<(), Error> {
        for injector in &mut self.injectors {
            injector.readings(tick, &mut self.readings);
            let off = |role| {
                vec![Failure {
                    role,
                    at: tick,
                    mode: FailureMode::Off,
                }]
            };
            match injector.fault() {
                (_, at) if at != tick => {}
                (Fault::Bus(config), _) => self.bus.set_config(config),
                (&Fault::Reset { board, off_ms }, _) => self.boards.plan(off(board), Some(off_ms)),
                (&Fault::Loss(role), _) => self.boards.plan(off(role), None),
                _ => {}
            }
        }
        if self.injectors.is_empty() {
            return Ok(());
        }
        for role in self.topology.boards() {
            let injectors = self.injectors.iter();
            let frozen = injectors.clone().any(|it| it.frozen(role, tick));
            let clock_lag = injectors.map(|it| it.clock_lag(role, tick)).sum();
            self.boards.hold(role, frozen, clock_lag)?;
        }
        Ok(())
    }

    /// Converts the sensors' samples to the boards' readings.
    fn read(&mut self, truth: &Truth) {
        let samples = self.sensors.sample(truth);
        let axles = samples.axles.iter().zip(&self.inertial);
        for (reading, (samples, inertial)) in self.readings.axles.iter_mut().zip(axles) {
            let accelerometer = samples.accelerometer;
            *reading = axle::Samples {
                encoder: samples.encoder_counts.into(),
                gyro_rad_s: samples.gyro.map(|rate| inertial.gyro_gain * rate),
                acceleration_m_s2: accelerometer.map(|value| inertial.accelerometer_gain * value),
                conditions: Conditions::NONE,
            };
        }
        // The board's converter counts from the lower rail; an entry without a gauge reads 0.
        let frames = samples.frames.iter().zip(&truth.strains);
        for (reading, (counts, strains)) in self.readings.frames.iter_mut().zip(frames) {
            *reading = *counts;
            for count in reading.iter_mut().take(strains.len()) {
                *count += self.converter_middle;
            }
        }
    }

    /// Strains of a frame at the latest sample; zero where there is no gauge, and without the relative position sensor.
    pub fn strain(&self, frame: usize) -> [f32; MAX_GAUGES] {
        let counts = self.sensors.samples().frames[frame];
        let counts = counts.map(|count| (count + self.converter_middle) as f32);
        let mut strain = self.calibrations[frame].strain(&counts);
        strain[self.gauges..].fill(0.0);
        strain
    }

    /// Sensors and bus as text, for comparisons in tests.
    #[cfg(test)]
    pub(crate) fn truth(&self) -> String {
        format!("{:?} {:?}", self.sensors, self.bus)
    }
}

/// Configuration of a drawn robot's boards: the scenario's configuration with the constants of the converter, and with
/// the bridge zeros of the first frame, measured with the frame held against a straight edge.
pub fn board_config(scenario: &Scenario, imperfections: &Drawn) -> RobotConfig {
    config_of(scenario, imperfections, FrameId(0))
}

/// As [`board_config`], with the bridge zeros of a frame.
fn config_of(scenario: &Scenario, imperfections: &Drawn, frame: FrameId) -> RobotConfig {
    let bridge = &scenario.world.sensors.bridge;
    let mut config = scenario.completed_robot();
    let middle = f64::from(bridge.full_scale_counts());
    let calibration = &mut config.beam.calibration;
    calibration.full_scale_counts = 2 * bridge.full_scale_counts() - 1;
    calibration.strain_per_count = bridge.strain_per_count() as f32;
    let gauges = config.beam.strip.gauges_m.count();
    let zeros = bridge.zero_counts(&imperfections.frames[frame.index()]);
    let zeros = zeros.map(|count| (count + middle) as f32);
    if let Some(zeros) = zeros.get(..gauges).and_then(PerGauge::new) {
        calibration.zero_counts = zeros;
    }
    config
}

/// Settings of each board of a drawn robot: [`board_config`] with the bridge zeros of the board's own frame, and with
/// the board's own parameters, such as the gains of its inertial sensors.
pub fn settings_of(scenario: &Scenario, imperfections: &Drawn) -> Result<Vec<Settings>, Error> {
    let settings = |role| {
        let frame = match role {
            Role::Axle(_) => FrameId(0),
            Role::Beam(frame) => frame,
        };
        let mut settings = Settings::new(config_of(scenario, imperfections, frame));
        scenario.boards.apply(role, &mut settings)?;
        Ok(settings)
    };
    scenario.robot.topology().boards().map(settings).collect()
}
