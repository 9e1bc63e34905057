//! One trial: physics and rig in lockstep at 1 kHz.

use crate::base::error::{Error, Refusal};
use crate::bus::virtual_bus::BusStatistics;
use crate::plant::{Outline, Plant, Station};
use crate::run::bit_compare::Trace;
use crate::run::recovery::{Monitor, Recovery};
use crate::run::rig::Rig;
use crate::run::robot::{FRAME_POINTS, Record, Robot, RunControl, outlines};
use crate::scenario::Scenario;
use crate::targets::{self, BoardTraffic, Boards, EventKind, HostCommand, Room, Target};
use crate::world::drawn::Drawn;
use crate::world::faults::{Fault, Wheel};
use crate::world::sensors::{AxleTruth, Truth};
use core_algos::beam::MAX_GAUGES;
use core_algos::node::lead::{self, Task};
use core_algos::time::{Micros, TICK};
use core_algos::topology::Node;

/// Time from a fault of the lead node to the end of the run, ticks: the run shows the reaction of the robot.
const TICKS_AFTER_FAULT: u64 = 1000;

/// Physics of a simulated robot: the plant of this project, or another simulator.
pub trait Physics {
    /// Writes motion and strains into the inputs of the sensors.
    fn measure(&mut self, truth: &mut Truth);

    /// Advances by 1 ms with the wheel torques that the boards command, `[axle][left, right]`, N m.
    fn step(&mut self, torque: &[[f64; 2]]);

    /// Record of the robot at `now`, with the lead node's latest output and the measured strains of each frame.
    fn record(
        &self,
        now: Micros,
        lead: lead::Output,
        strain: &dyn Fn(usize) -> [f32; MAX_GAUGES],
    ) -> Record;

    /// The plant; `None` for another simulator.
    fn plant(&self) -> Option<&Plant> {
        None
    }

    /// Applies the injected fault of a wheel. Only the plant has injected faults.
    fn lift_wheel(&mut self, _wheel: Wheel) {}

    /// Applies the injected fault of the frame. Only the plant has injected faults.
    fn snap_frame(&mut self, _frame: usize) {}
}

/// Plant of a drawn robot with the true positions of its gauges.
#[derive(Debug)]
pub struct DrawnPlant {
    /// Simulated robot with motors, axles and frame.
    pub plant: Plant,
    /// True positions of the gauges of each frame.
    gauges: Vec<Vec<Station>>,
    half_thickness: f64,
    /// Positions along each frame of the points of a record.
    outlines: Vec<Outline>,
}

impl DrawnPlant {
    /// Plant at rest at its true start.
    pub fn new(scenario: &Scenario, imperfections: &Drawn) -> Result<Self, Error> {
        let plant = scenario.world.plant_of(imperfections, scenario.mission.rps);
        let mut plant = plant.map_err(|error| Refusal::of("plant.", &error))?;
        let start = scenario.mission.start;
        plant.place(std::array::from_fn(|i| {
            start[i] + imperfections.placement[i]
        }));
        Ok(Self {
            half_thickness: scenario.world.sensors.bridge.half_thickness_m,
            gauges: scenario.world.gauges_of(imperfections, &plant),
            outlines: outlines(&plant),
            plant,
        })
    }

    /// Points of the bent frames from root to tip, global, m.
    pub fn frame_points(&self) -> Vec<[[f64; 2]; FRAME_POINTS]> {
        let draw = |outline| {
            let mut points = [[0.0; 2]; FRAME_POINTS];
            self.plant.draw(outline, &mut points);
            points
        };
        self.outlines.iter().map(draw).collect()
    }
}

impl Physics for DrawnPlant {
    fn measure(&mut self, truth: &mut Truth) {
        for (truth, axle) in truth.axles.iter_mut().zip(self.plant.axles()) {
            *truth = AxleTruth {
                wheel_angle: axle.motor_angle,
                yaw_rate: axle.velocity[2],
                forward_acceleration: axle.acceleration[0],
            };
        }
        let frames = truth.strains.iter_mut().zip(&self.gauges);
        for (frame, (strains, gauges)) in frames.enumerate() {
            self.plant.gauges(frame, gauges, |i, curvature| {
                strains[i] = self.half_thickness * curvature;
            });
        }
    }

    fn step(&mut self, torque: &[[f64; 2]]) {
        self.plant.step(torque);
    }

    fn record(
        &self,
        now: Micros,
        lead: lead::Output,
        strain: &dyn Fn(usize) -> [f32; MAX_GAUGES],
    ) -> Record {
        Record::of(now, &self.plant, &self.outlines, lead, strain)
    }

    fn plant(&self) -> Option<&Plant> {
        Some(&self.plant)
    }

    fn lift_wheel(&mut self, Wheel { axle, side }: Wheel) {
        self.plant.lift_wheel(axle, side as usize);
    }

    fn snap_frame(&mut self, frame: usize) {
        self.plant.snap_frame(frame);
    }
}

/// Trial of one robot with physics and boards, in progress.
pub struct Simulation<P = DrawnPlant> {
    physics: P,
    rig: Rig,
    truth: Truth,
    control: RunControl,
    recovery: Option<Recovery>,
    /// Latest commanded task.
    task: Task,
}

impl Simulation<DrawnPlant> {
    /// Robot at rest at its start, with the drawn errors of this trial. The boards run in this process, with the
    /// scenario's parts of the user.
    pub fn new(scenario: &Scenario, seed: u64, trial: u64) -> Result<Self, Error> {
        scenario.own.check_axles(scenario.robot.topology())?;
        let boards = targets::in_process_with(scenario.robot.topology(), &scenario.own);
        Self::on(boards, scenario, seed, trial)
    }

    /// As [`Self::new`], with the given boards.
    pub fn on(
        targets: Vec<Box<dyn Target>>,
        scenario: &Scenario,
        seed: u64,
        trial: u64,
    ) -> Result<Self, Error> {
        let imperfections = scenario.world.draw(scenario.robot.topology(), seed, trial);
        Self::with(targets, scenario, &imperfections, seed, trial)
    }

    /// As [`Self::on`], for a robot with the given errors.
    pub fn with(
        targets: Vec<Box<dyn Target>>,
        scenario: &Scenario,
        imperfections: &Drawn,
        seed: u64,
        trial: u64,
    ) -> Result<Self, Error> {
        let plant = DrawnPlant::new(scenario, imperfections)?;
        Self::beside(plant, targets, scenario, imperfections, (seed, trial))
    }

    /// Text of the whole state except the boards.
    #[cfg(test)]
    pub(crate) fn truth(&self) -> String {
        format!("{:?} {}", self.physics, self.rig.truth())
    }

    /// Plant of the simulated robot.
    pub fn plant(&self) -> &Plant {
        &self.physics.plant
    }

    /// Sets the friction coefficient of the floor, above 0, from now on.
    pub fn set_friction(&mut self, friction: f64) {
        self.physics.plant.set_friction(friction);
    }

    /// Adds `strain` to the zeros of all gauges from now on.
    pub fn drift_gauges(&mut self, strain: f64) {
        self.rig.drift_gauges(strain);
    }

    /// Injects a fault from `tick` on, beside those already injected. Losses and resets of boards need a tick each.
    pub fn inject(&mut self, fault: Fault, tick: u32) {
        self.rig.inject(fault, tick);
    }
}

impl<P: Physics> Simulation<P> {
    /// Robot of the drawn errors of a trial (seed and number), with the given boards and physics.
    pub fn beside(
        physics: P,
        targets: Vec<Box<dyn Target>>,
        scenario: &Scenario,
        imperfections: &Drawn,
        trial: (u64, u64),
    ) -> Result<Self, Error> {
        Ok(Self {
            rig: Rig::new(targets, scenario, imperfections, trial)?,
            truth: scenario.world.no_truth(scenario.robot.topology()),
            control: RunControl::default(),
            recovery: None,
            task: Task::Idle,
            physics,
        })
    }

    /// Boards of the robot, to be changed.
    pub fn boards(&mut self) -> &mut Boards {
        &mut self.rig.boards
    }

    /// Ends the trial and returns its boards for a further simulation.
    pub fn release(self) -> Vec<Box<dyn Target>> {
        self.rig.boards.release()
    }

    /// Enables recovery: after the restart of an axle board, the host clears the faults and repeats the task.
    pub fn recover(&mut self) {
        self.recovery = Some(Recovery::default());
    }

    /// Torques that the boards commanded at the latest tick, `[axle][left, right]`, N m.
    pub fn torque(&self) -> &[[f64; 2]] {
        self.rig.torque()
    }

    /// Begins to record the outputs of the boards.
    pub fn record_trace(&mut self) {
        self.rig.trace = Some(Trace::new(self.rig.monitor.topology));
    }

    /// Outputs of the boards since [`Self::record_trace`]; `None` without a recording.
    pub fn take_trace(&mut self) -> Option<Trace> {
        self.rig.trace.take()
    }

    /// Latest output of the lead node.
    pub fn lead_output(&self) -> &lead::Output {
        self.rig.lead()
    }

    fn tick(&self) -> u64 {
        self.now() / TICK
    }

    /// Applies the injected faults to the physics.
    fn disturb(&mut self, tick: u32) {
        for injector in self.rig.injectors() {
            if let Some(wheel) = injector.lifts(tick) {
                self.physics.lift_wheel(wheel);
            }
            if let Some(frame) = injector.snaps(tick) {
                self.physics.snap_frame(frame);
            }
        }
    }

    /// Executes the host's action after the restart of a board.
    fn step_recovery(&mut self, tick: u32) -> Result<(), Error> {
        let (restart, monitor) = (self.rig.boards.last_restart(), &self.rig.monitor);
        let recovery = self.recovery.as_mut();
        let Some(act) = recovery.and_then(|it| it.step(tick, restart, monitor)) else {
            return Ok(());
        };
        let task = if act == EventKind::Cleared {
            Task::Clear
        } else {
            self.task
        };
        self.rig.boards.note(tick, act);
        self.rig.boards.command(&HostCommand::Task(task))
    }
}

impl<P: Physics> Robot for Simulation<P> {
    fn now(&self) -> Micros {
        self.rig.now()
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        if let HostCommand::Task(task) = command {
            self.task = *task;
        }
        self.rig.boards.command(command)
    }

    fn is_settled(&self) -> bool {
        true
    }

    fn room(&mut self) -> Room {
        self.rig.boards.room()
    }

    /// Reason for the end of the run: loss of a board, or a fault of the lead node that has lasted 1 s without a
    /// pending recovery. `None` while the run can continue.
    fn failure(&self) -> Option<String> {
        if let Some(why) = self.rig.boards.end(self.tick() as u32) {
            return Some(why.to_owned());
        }
        let fault = self.rig.monitor.fault_since(Node::Lead)?;
        let over = self.tick().saturating_sub(fault) >= TICKS_AFTER_FAULT;
        if !over || self.recovery.as_ref().is_some_and(Recovery::is_pending) {
            return None;
        }
        self.rig.monitor.why_stopped()
    }

    /// Advances by a tick: sensors, bus and boards, then the physics.
    fn step(&mut self) -> Result<(), Error> {
        if let Some(pace) = &mut self.control.pace {
            pace.wait();
        }
        let tick = self.tick() as u32;
        self.step_recovery(tick)?;
        self.physics.measure(&mut self.truth);
        self.disturb(tick);
        let torque = self.rig.step(&self.truth)?;
        self.physics.step(torque);
        self.notify_observers()
    }

    fn record(&self) -> Record {
        let lead = *self.rig.lead();
        self.physics
            .record(self.now(), lead, &|frame| self.rig.strain(frame))
    }

    fn plant(&self) -> Option<&Plant> {
        self.physics.plant()
    }

    fn monitor(&self) -> &Monitor {
        &self.rig.monitor
    }

    fn monitor_mut(&mut self) -> &mut Monitor {
        &mut self.rig.monitor
    }

    fn control(&self) -> &RunControl {
        &self.control
    }

    fn control_mut(&mut self) -> &mut RunControl {
        &mut self.control
    }

    fn traffic(&self) -> Vec<BoardTraffic> {
        self.rig.boards.traffic()
    }

    fn bus(&self) -> BusStatistics {
        self.rig.bus.statistics()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::bus::LeadMode;
    use core_algos::math::Posture;
    use core_algos::topology::Side;

    #[test]
    fn torques_take_effect_one_tick_late_and_only_with_a_task() {
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
            let axles = simulation.plant().axles();
            axles.iter().any(|axle| axle.torque != [0.0; 2])
        };
        let mut ticks = 0;
        while !moving(&simulation) {
            simulation.step().unwrap();
            ticks += 1;
            assert!(ticks < 500, "the task never reached the motors");
        }
        // The command reaches the axle after the lead node's epoch and the latency of the bus; the motors follow one
        // tick later.
        let bus = u64::from(Scenario::default().world.bus.latency_ms);
        assert!(ticks > bus + 1, "{ticks}");
    }

    /// Three to five axles at rest: every estimate is near its true posture and claims no more than it knows.
    #[test]
    fn chains_at_rest_are_estimated_within_their_claims() {
        use crate::base::statistics::nees;
        use crate::run::robot::estimated_axles;
        for axles in 3..=5 {
            let mut scenario = Scenario::parse(None, "", "test", &[]).unwrap();
            scenario.robot.geometry.axles = axles;
            scenario.check().unwrap();
            let mut simulation = Simulation::new(&scenario, 3, 0).unwrap();
            for _ in 0..1000 {
                simulation.step().unwrap();
            }
            let record = simulation.record();
            let count = axles as usize;
            assert_eq!(
                (record.axles.len(), record.frames.len()),
                (count, count - 1)
            );
            let estimated: Vec<_> = estimated_axles(&record.lead).collect();
            assert_eq!(estimated.len(), count);
            for (axle, estimate) in record.axles.iter().zip(&estimated) {
                let off = libm::hypot(
                    axle.posture[0] - f64::from(estimate.x),
                    axle.posture[1] - f64::from(estimate.y),
                );
                // Placement: 5 mm along each axis and 10 mrad, at most 0.74 m from the midpoint.
                assert!(off < 0.04, "{axles}: {off}");
            }
            let nees = nees(&record.lead.fused.robot, record.midpoint);
            assert!(nees < 16.0, "{axles}: {nees}");
            let middle = |k: usize| {
                let mean = record
                    .axles
                    .windows(2)
                    .map(|it| 0.5 * (it[0].posture[k] + it[1].posture[k]));
                mean.sum::<f64>() / (count - 1) as f64
            };
            assert!((0..2).all(|k| (record.midpoint[k] - middle(k)).abs() < 1e-9));
            assert_eq!(
                simulation.bus().late,
                0,
                "reports of {axles} axles are late"
            );
            // The load table gives the worst case of stuff bits.
            let load = simulation.bus().busy_us as f64 / 1e6;
            let robot = scenario.robot.topology();
            let most = core_algos::bus::layout::load(robot, 1e6);
            assert!(
                load > 0.6 * f64::from(most) && load < f64::from(most),
                "{axles}: {load} {most}"
            );
        }
    }

    /// The bridges of each frame have zeros of their own, and its board is calibrated with these.
    #[test]
    fn strains_of_each_straight_frame_are_near_zero() {
        let mut scenario = Scenario::parse(None, "", "test", &[]).unwrap();
        scenario.robot.geometry.axles = 3;
        let mut simulation = Simulation::new(&scenario, 5, 0).unwrap();
        for _ in 0..200 {
            simulation.step().unwrap();
        }
        for frame in &simulation.record().frames {
            // Zeros of bridges are spread by 200 microstrain; drift and noise by a few.
            assert!(
                frame.strain.iter().all(|strain| strain.abs() < 6e-5),
                "{:?}",
                frame.strain
            );
        }
    }

    #[test]
    fn sensor_stuck_from_the_first_tick_does_not_end_the_run() {
        use crate::world::faults::{Fault, Wheel};
        let wheel = Wheel {
            axle: 1,
            side: Side::Right,
        };
        for fault in [Fault::GaugeStuck(2), Fault::EncoderStuck(wheel)] {
            let mut simulation = Simulation::new(&Scenario::default(), 1, 0).unwrap();
            simulation.inject(fault, 0);
            for _ in 0..20 {
                simulation.step().unwrap();
            }
        }
    }

    #[test]
    fn motors_switch_off_without_messages() {
        let mut simulation = Simulation::new(&Scenario::default(), 1, 0).unwrap();
        // Lets the robot settle: a task needs a robot at rest whose boards have received each other's messages.
        for _ in 0..100 {
            simulation.step().unwrap();
        }
        let task = HostCommand::Task(Task::regulate(Posture::ORIGIN));
        simulation.command(&task).unwrap();
        for _ in 0..3000 {
            simulation.step().unwrap();
        }
        let front = &simulation.plant().axles()[0];
        assert!(front.torque != [0.0; 2], "under way");
        assert!(simulation.lead_output().motion.v.abs() > 0.05, "under way");
        simulation.rig.bus.cut();
        // The stop takes 50 ms to detect the loss, 250 ms to slow down, 100 ms at rest and 750 ms to release the frame.
        for _ in 0..1200 {
            simulation.step().unwrap();
        }
        let axles = simulation.plant().axles();
        assert!(axles.iter().all(|axle| axle.torque == [0.0; 2]));
        assert_eq!(simulation.lead_output().mode, LeadMode::Idle);
    }
}
