//! One trial: plant, sensors, nodes and bus in lockstep at 1 kHz.

use crate::base::error::Error;
use crate::bus::virtual_bus::{BusStatistics, VirtualBus};
use crate::run::bit_compare::Trace;
use crate::run::recovery::Recovery;
use crate::run::robot::{FRAME_POINTS, Record, Robot, RunControl};
use crate::scenario::Scenario;
use crate::targets;
use crate::targets::{
    BoardTraffic, Boards, Failure, FailureMode, HostCommand, Posted, Room, Target, What,
};
use crate::world::drawn::Drawn;
use crate::world::faults::{Fault, Injector, Readings};
use crate::world::sensors::{Sensors, Truth};
use core_algos::beam::calibration::Calibration;
use core_algos::beam::{MAX_GAUGES, PerGauge};
use core_algos::math::Posture;
use core_algos::node::axle;
use core_algos::node::lead::{self, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::params::{Inertial, Settings};
use core_algos::safety::Conditions;
use core_algos::time::{EPOCH, Micros, TICK};
use core_algos::topology::{Node, Role};
use plant::{Outline, Plant, Station};

/// Time a run goes on after the lead node's fault, ticks: what follows from it can be seen.
const GRACE: u64 = 1000;

/// A trial in progress.
pub struct Simulation {
    plant: Plant,
    sensors: Sensors,
    truth: Truth,
    gauges: Vec<Station>,
    outline: Outline,
    half_thickness: f64,
    converter_middle: i32,
    /// Inertial sensor drivers of the axle boards.
    inertial: [Inertial; 2],
    boards: Boards,
    bus: VirtualBus,
    torque: [[f64; 2]; 2],
    tick: u64,
    last_lead: lead::Output,
    trace: Option<Trace>,
    calibration: Calibration,
    /// True if the relative position sensor is fitted.
    sensed: bool,
    /// Latest counts of the strain bridges.
    counts: [i32; MAX_GAUGES],
    control: RunControl,
    recovery: Option<Recovery>,
    injector: Option<Injector>,
    full_scale: i32,
    /// Latest commanded task.
    task: Task,
}

impl Simulation {
    /// A robot at rest on its start, with the imperfections of this trial; its boards run in this
    /// process.
    pub fn new(scenario: &Scenario, seed: u64, trial: u64) -> Result<Self, Error> {
        Self::on(targets::in_process(), scenario, seed, trial)
    }

    /// The same with boards that run wherever they do.
    pub fn on(
        targets: [Box<dyn Target>; 3],
        scenario: &Scenario,
        seed: u64,
        trial: u64,
    ) -> Result<Self, Error> {
        let imperfections = scenario.world.draw(seed, trial);
        Self::with(targets, scenario, &imperfections, seed, trial)
    }

    /// The same of a robot with these imperfections.
    pub fn with(
        targets: [Box<dyn Target>; 3],
        scenario: &Scenario,
        imperfections: &Drawn,
        seed: u64,
        trial: u64,
    ) -> Result<Self, Error> {
        let plant = scenario.world.plant_of(imperfections, scenario.mission.rps);
        let mut plant = plant
            .build()
            .map_err(|error| Error::input(format!("plant.{error}")))?;
        let start = scenario.mission.start;
        plant.place(std::array::from_fn(|i| {
            start[i] + imperfections.placement[i]
        }));
        let config = calibrated(scenario, imperfections);
        let mut settings = [Settings::new(config); 3];
        for role in Role::ALL {
            scenario.boards.apply(role, &mut settings[role as usize])?;
        }
        let [front, rear, beam] = &settings;
        let at = Posture::from(start.map(|v| v as f32));
        let place = config.put_down(at, &scenario.mission.told());
        let gauges = scenario.world.gauges_of(imperfections, &plant);
        let believed = &beam.robot.beam;
        let calibration = believed
            .calibration
            .build(believed.strip.gauges_m.count())?;
        Ok(Self {
            sensors: Sensors::new(&scenario.world.sensors, imperfections, seed, trial)?,
            truth: Truth {
                gauge_count: gauges.len(),
                ..Truth::default()
            },
            converter_middle: scenario.world.sensors.bridge.full_scale_counts(),
            half_thickness: scenario.world.sensors.bridge.half_thickness_m,
            gauges,
            outline: plant.outline(FRAME_POINTS),
            inertial: [front.inertial, rear.inertial],
            boards: {
                let configs = settings.map(|settings| settings.robot);
                Boards::start(targets, configs, &place, scenario.mission.rps)?
            },
            bus: VirtualBus::new(
                &scenario.world.bus,
                seed ^ trial.wrapping_mul(0x9e37_79b9_7f4a_7c15),
            ),
            torque: [[0.0; 2]; 2],
            tick: 0,
            last_lead: lead::Output::default(),
            trace: None,
            calibration,
            sensed: scenario.mission.rps,
            counts: [0; MAX_GAUGES],
            control: RunControl::default(),
            recovery: None,
            injector: None,
            full_scale: 2 * scenario.world.sensors.bridge.full_scale_counts() - 1,
            task: Task::Idle,
            plant,
        })
    }

    /// All of it that is not boards.
    #[cfg(test)]
    pub(crate) fn truth(&self) -> String {
        let parts = (&self.plant, &self.sensors, &self.gauges, &self.bus);
        format!("{parts:?} {}", self.half_thickness)
    }

    /// The boards.
    pub fn boards(&mut self) -> &mut Boards {
        &mut self.boards
    }

    /// Gives the boards back, for another simulation.
    pub fn release(self) -> [Box<dyn Target>; 3] {
        self.boards.release()
    }

    /// Has the host clear the faults and give the task again after an axle board was restarted.
    pub fn recover(&mut self) {
        self.recovery = Some(Recovery::default());
    }

    /// From `tick` on, this goes wrong.
    pub fn inject(&mut self, fault: Fault, tick: u32) {
        let failure = |role| Failure {
            role,
            at: tick,
            mode: FailureMode::Off,
        };
        match fault {
            Fault::Reset(role, after) => self.boards.plan(vec![failure(role)], Some(after)),
            Fault::Loss(role) => self.boards.plan(vec![failure(role)], None),
            _ => {}
        }
        self.injector = Some(Injector::new(fault, tick, self.full_scale));
    }

    /// The torques that the boards commanded last, `[axle][left, right]`, N m.
    pub fn torque(&self) -> [[f64; 2]; 2] {
        self.torque
    }

    /// From now on, keeps what the boards do.
    pub fn record_trace(&mut self) {
        self.trace = Some(Trace::default());
    }

    /// Trace of the boards since [`Self::record_trace`].
    pub fn take_trace(&mut self) -> Option<Trace> {
        self.trace.take()
    }

    /// The robot as it is.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Latest output of the lead node.
    pub fn lead_output(&self) -> &lead::Output {
        &self.last_lead
    }

    /// Puts the fault in.
    fn disturb(&mut self, tick: u32, readings: &mut Readings) -> Result<(), Error> {
        let Some(injector) = &mut self.injector else {
            return Ok(());
        };
        injector.readings(tick, readings);
        if let Some((axle, side)) = injector.lifts(tick) {
            self.plant.lift_wheel(axle, side);
        }
        if injector.snaps(tick) {
            self.plant.snap_frame();
        }
        for role in Role::ALL {
            let frozen = injector.frozen(role, tick);
            let behind = injector.behind(role, tick);
            self.boards.hold(role, frozen, behind)?;
        }
        match injector.fault() {
            (Fault::Bus(config), at) if at == tick => self.bus.turn_into(&config),
            _ => {}
        }
        Ok(())
    }

    /// Recovery by the host after the restart of a board.
    fn step_recovery(&mut self, tick: u32) -> Result<(), Error> {
        let (restart, monitor) = (self.boards.last_restart(), &self.control.monitor);
        let recovery = self.recovery.as_mut();
        let Some(act) = recovery.and_then(|it| it.step(tick, restart, monitor)) else {
            return Ok(());
        };
        let task = if act == What::Cleared {
            Task::Clear
        } else {
            self.task
        };
        self.boards.note(tick, act);
        self.boards.command(&HostCommand::Task(task))
    }

    /// Samples of each board.
    fn sample(&mut self) -> Readings {
        let state = self.plant.state();
        for i in 0..2 {
            let axle = &state.axle[i];
            self.truth.wheel_angle[i] = axle.motor_angle;
            self.truth.yaw_rate[i] = axle.velocity[2];
            self.truth.forward_acceleration[i] = axle.acceleration[0];
        }
        let (strain, half) = (&mut self.truth.gauge_strain, self.half_thickness);
        self.plant.gauges(&self.gauges, |i, curvature| {
            if let Some(strain) = strain.get_mut(i) {
                *strain = half * curvature;
            }
        });
        let samples = self.sensors.sample(&self.truth);
        let axle = |i: usize| axle::Samples {
            encoder: samples.encoder_counts[i].map(Some),
            gyro_rad_s: samples.gyro[i].map(|rate| self.inertial[i].gyro_gain * rate),
            acceleration_m_s2: samples.accelerometer[i]
                .map(|value| self.inertial[i].accelerometer_gain * value),
            conditions: Conditions::NONE,
        };
        // The board's converter counts from the lower rail; where there is no gauge it reads none.
        let mut counts = samples.bridge_counts;
        for count in counts.iter_mut().take(self.gauges.len()) {
            *count += self.converter_middle;
        }
        self.counts = counts;
        Readings {
            axles: [axle(0), axle(1)],
            counts,
        }
    }

    /// Strains of the latest sample; zero where there is no gauge, and of all without the sensor.
    fn strain(&self) -> [f32; MAX_GAUGES] {
        let mut strain = self
            .calibration
            .strain(&self.counts.map(|count| count as f32));
        let gauges = if self.sensed { self.gauges.len() } else { 0 };
        strain
            .iter_mut()
            .skip(gauges)
            .for_each(|strain| *strain = 0.0);
        strain
    }
}

impl Robot for Simulation {
    fn now(&self) -> Micros {
        self.tick * TICK
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        if let HostCommand::Task(task) = command {
            self.task = *task;
        }
        self.boards.command(command)
    }

    fn is_settled(&self) -> bool {
        true
    }

    fn room(&mut self) -> Room {
        self.boards.room()
    }

    /// A board is lost, or the lead node has been in fault for a while and nobody is about to clear it.
    fn failure(&self) -> Option<String> {
        if let Some(why) = self.boards.end(self.tick as u32) {
            return Some(why.to_owned());
        }
        let fault = self.control.monitor.fault_since(Node::Lead)?;
        let over = self.tick.saturating_sub(fault) >= GRACE;
        if !over || self.recovery.as_ref().is_some_and(Recovery::is_pending) {
            return None;
        }
        self.control.monitor.why_stopped()
    }

    /// Sample, deliver, run the nodes, move the plant. Torques take effect one tick late, as on the boards.
    fn step(&mut self) -> Result<(), Error> {
        if let Some(pace) = &mut self.control.pace {
            pace.wait();
        }
        let (now, tick) = (self.now(), self.tick as u32);
        self.step_recovery(tick)?;
        let mut readings = self.sample();
        self.disturb(tick, &mut readings)?;
        let samples = readings.samples();
        let Self {
            boards,
            bus,
            trace,
            control,
            ..
        } = self;
        bus.deliver(now, |role, frame, message| {
            boards.receive(role, now, frame, message);
        });
        let outputs = boards.tick(tick, &samples, &mut |posted| {
            let frame = match posted {
                Posted::Message(message) => bus.send(now, message),
                Posted::Frame(frame) => bus.send_frame(now, frame),
            };
            let Some(frame) = frame else {
                return;
            };
            control.monitor.see(tick, &frame);
            if let Some(trace) = trace.as_mut() {
                trace.frame(tick, frame);
            }
        })?;
        let [front, rear, _] = &outputs;
        if let Some(lead) = front.lead {
            self.last_lead = lead;
        }
        let torque = [front.torque_nm, rear.torque_nm];
        let mut given = self.torque;
        if let Some(injector) = &self.injector {
            injector.torque(tick, &mut given);
        }
        self.plant.step(given);
        self.torque = torque.map(|axle| axle.map(f64::from));
        self.tick += 1;
        if let Some(trace) = &mut self.trace {
            trace.torque(torque);
            if (self.tick * TICK).is_multiple_of(EPOCH) {
                trace.lead(&self.last_lead);
            }
        }
        self.show()
    }

    fn record(&self) -> Record {
        let seen = (self.last_lead, self.strain());
        Record::of(self.now(), &self.plant, &self.outline, seen)
    }

    fn plant(&self) -> Option<&Plant> {
        Some(self.plant())
    }

    fn control(&self) -> &RunControl {
        &self.control
    }

    fn control_mut(&mut self) -> &mut RunControl {
        &mut self.control
    }

    fn traffic(&self) -> Vec<BoardTraffic> {
        self.boards.traffic()
    }

    fn bus(&self) -> BusStatistics {
        self.bus.statistics()
    }
}

/// The configuration of this robot's boards: with the zero of its bridges, as found on a straight
/// edge, and its converter's constants.
pub(crate) fn calibrated(scenario: &Scenario, imperfections: &Drawn) -> RobotConfig {
    let bridge = &scenario.world.sensors.bridge;
    let mut config = scenario.completed_robot();
    let middle = f64::from(bridge.full_scale_counts());
    let calibration = &mut config.beam.calibration;
    calibration.full_scale_counts = 2 * bridge.full_scale_counts() - 1;
    calibration.strain_per_count = bridge.strain_per_count() as f32;
    let gauges = config.beam.strip.gauges_m.count();
    let zeros = bridge.zero_counts(imperfections);
    let zeros = zeros.map(|count| (count + middle) as f32);
    if let Some(zeros) = zeros.get(..gauges).and_then(PerGauge::new) {
        calibration.zero_counts = zeros;
    }
    config
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::bus::LeadMode;

    #[test]
    fn torques_take_effect_one_tick_late_and_only_when_asked_for() {
        let mut simulation = Simulation::new(&Scenario::default(), 1, 0).unwrap();
        let start = simulation.plant().midpoint();
        for _ in 0..500 {
            simulation.step().unwrap();
        }
        let rest = simulation.plant().midpoint();
        assert!(
            (0..3).all(|i| (rest[i] - start[i]).abs() < 1e-6),
            "no task, no motion"
        );
        simulation
            .command(&HostCommand::Task(Task::regulate(Posture::ORIGIN)))
            .unwrap();
        let moving = |simulation: &Simulation| {
            let axles = simulation.plant().state().axle;
            axles.iter().any(|axle| axle.torque != [0.0; 2])
        };
        let mut ticks = 0;
        while !moving(&simulation) {
            simulation.step().unwrap();
            ticks += 1;
            assert!(ticks < 500, "the task never reached the motors");
        }
        // The lead's epoch and the bus come before the axle, and the motors a tick after it.
        let bus = u64::from(Scenario::default().world.bus.latency_ms);
        assert!(ticks > bus + 1, "{ticks}");
    }

    #[test]
    fn without_messages_the_motors_go_off() {
        let mut simulation = Simulation::new(&Scenario::default(), 1, 0).unwrap();
        // A task is for a robot at rest whose boards have heard each other.
        for _ in 0..100 {
            simulation.step().unwrap();
        }
        let task = HostCommand::Task(Task::regulate(Posture::ORIGIN));
        simulation.command(&task).unwrap();
        for _ in 0..3000 {
            simulation.step().unwrap();
        }
        let front = simulation.plant().state().axle[0];
        assert!(front.torque != [0.0; 2], "under way");
        assert!(simulation.lead_output().motion.v.abs() > 0.05, "under way");
        simulation.bus.cut();
        // 50 ms until it is noticed, 250 to slow down, 100 at rest, 750 to let the frame go.
        for _ in 0..1200 {
            simulation.step().unwrap();
        }
        let axles = simulation.plant().state().axle;
        assert!(axles.iter().all(|axle| axle.torque == [0.0; 2]));
        assert_eq!(simulation.lead_output().mode, LeadMode::Idle);
    }
}
