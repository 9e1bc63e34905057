//! Robot of virtual STM32F405 boards that run the default images, with the parts wired to them, in the simulated
//! plant.
//!
//! The host is connected to the boards only through the robot and the serial port of the front board: motors turn
//! wheels, wheels turn encoders, the bent frame strains gauges. Orders and the lead node's output pass through the
//! port ([`BoardLink`]); states are read from the bus.

pub mod axle;
pub mod beam;
mod clock;
pub mod faults;
mod options;
mod port;
mod power;
pub mod report;
mod store;
pub mod tools;
#[cfg(test)]
mod turns;

pub use options::Options;
pub use report::BoardReport;

use crate::board_link::BoardLink;
use crate::board_log::BoardLog;
use crate::images::Images;
use crate::log_reader::Reader;
use axle::{AxleBoard, AxleMotion, AxleParts, WheelMotion};
use beam::{BeamBoard, BridgeParts};
use clock::Clock;
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{self, CanFrame, Message};
use core_algos::link::protocol::Placement;
use core_algos::math::Posture;
use core_algos::node::lead::{self, Task};
use core_algos::safety::{Condition, OperatingState};
use core_algos::time::{EPOCH, Micros};
use core_algos::topology::{FrameId, Node, Role, Topology};
use host_sim::base::error::{Error, Refusal};
use host_sim::bus::virtual_bus::BusStatistics;
use host_sim::run::recovery::Monitor;
use host_sim::run::robot::{Record, Robot, RunControl, outlines};
use host_sim::scenario::Scenario;
use host_sim::targets::{BoardTraffic, HostCommand, Room};
use host_sim::world::drawn::Drawn;
use host_sim::world::random::{Stream, generator};
use host_sim::world::sensors::Sensors;
use plant::{Outline, Plant, Station};
use rand::RngExt;
use report::BoardObservations;
use tools::Tools;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::device::Motion;
use virtual_board::network::Network;
use virtual_board::wire::{Id, Wire};

/// Time step of the plant, one tick.
const TICK: Time = Time::from_micros(1_000);
/// Time for which the boards run independently of each other.
const QUANTUM: Time = Time::from_micros(40);
/// Timeout from power-on until all nodes are ready.
const BOOT_TIMEOUT: Time = Time::from_micros(5_000_000);
/// Number of ticks for which all nodes must stay ready.
const READY_TICKS: u32 = 100;
/// Duration of a press of the button.
const PRESS_DURATION: Time = Time::from_micros(150_000);
/// Limit of the random frequency errors of the crystals, parts in 10⁹.
const CRYSTAL_PPB: i64 = 20_000;
/// Number of ticks for which a run continues after the lead node's fault, to show its effects.
const TICKS_AFTER_FAULT: u64 = 1000;
/// Friction of a blocked wheel, N m s/rad: the most that is stable with steps of a millisecond.
const BLOCKED_NM_S: f64 = 2.0;
/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

/// Robot of virtual boards in the simulated plant.
#[derive(Clone)]
pub struct VirtualRobot {
    topology: Topology,
    network: Network,
    roles: Vec<Role>,
    images: Images,
    readers: Vec<Reader>,
    observations: Vec<BoardObservations>,
    plant: Plant,
    /// Posture of the midpoint at the start, (m, m, rad).
    start: [f64; 3],
    /// Angles of the motors at the latest placement on the start, rad.
    start_angles: Vec<[f64; 2]>,
    gauges: Vec<Vec<Station>>,
    outlines: Vec<Outline>,
    half_thickness: f64,
    /// Strains at the gauges of each frame: true strain plus drift.
    strains: Vec<[f32; MAX_GAUGES]>,
    /// Sensor model of the simulated world; gives the inertial sensors' biases once all nodes are ready, which is after
    /// the boards' averages at rest.
    sensors: Box<Sensors>,
    /// True if inertial sensors are fitted.
    inertial: bool,
    biases: Vec<[f64; 2]>,
    /// Links to the front board and to the other recorded boards.
    link: BoardLink,
    other_links: Vec<BoardLink>,
    recorded: bool,
    reported: Vec<bus::CanFrame>,
    /// True if this program is the host at the front board's serial port.
    hosted: bool,
    clock: Clock,
    /// Start posture of the robot, with its uncertainty, as set in the lead node.
    place: Placement,
    /// Latest output of the lead node received over the link.
    lead: lead::Output,
    /// Time of validity of the estimates in `lead`, µs since power-on; `None` until an output is received.
    estimate_time: Option<Micros>,
    task: Task,
    frames: u64,
    /// Time from power-on until all nodes were ready; zero until then.
    booted: Time,
    tick: u64,
    control: RunControl,
    /// Heartbeats of the nodes.
    monitor: Monitor,
    /// Reason why the run must end, a lost or restarted board; `None` while the run may continue.
    failure: Option<String>,
    tools: Tools,
    /// Blocked wheel (axle, side: 0 is left); `None` if all wheels turn freely.
    blocked: Option<(usize, usize)>,
}

fn posture(place: [f64; 3]) -> Posture {
    Posture::from(place.map(|value| value as f32))
}

/// Boards with their parts, images and stores, switched off.
fn boards(
    scenario: &Scenario,
    images: &Images,
    (seed, trial): (u64, u64),
    options: &Options,
    roles: &[Role],
    parts: &(Drawn, Vec<Vec<BridgeParts>>),
) -> Result<Vec<Board>, Error> {
    let (drawn, bridges) = parts;
    let mut random = generator(seed, trial, Stream::Other(0x200));
    let mut boards = Vec::new();
    for &role in roles {
        let fast_ppb = random.random_range(-CRYSTAL_PPB..=CRYSTAL_PPB);
        let fast = options.fast_ppb.iter().find(|(board, _)| *board == role);
        let fast_ppb = fast.map_or(fast_ppb, |(_, ppb)| *ppb);
        let part_seed: u64 = random.random();
        let mut board = match role {
            Role::Beam(frame) => {
                let (config, bridges) = (&scenario.world.sensors.bridge, &bridges[frame.index()]);
                let circuit = BeamBoard::new(config, bridges, frame, (seed, trial));
                Board::new(Box::new(circuit), fast_ppb)
            }
            Role::Axle(axle) => {
                let circuit = AxleBoard::new(&AxleParts::of(scenario, drawn, axle, part_seed));
                Board::new(Box::new(circuit), fast_ppb)
            }
        };
        let mut variation = options::chip(part_seed);
        if let Role::Beam(frame) = role {
            // The world, not the chip's random draw, gives the nonlinearity of the beam board's converter.
            variation.converter_nonlinearity = scenario.world.sensors.bridge.nonlinearity_counts;
            variation.converter_seed = drawn.frames[frame.index()].converter.into();
        }
        (options.vary)(role, &mut variation);
        board.chip().set_variation(variation);
        board.flash(images.of(role));
        board.core_mut().set_profiling(options.profile);
        let stored = store::sectors(scenario, role, parts)?;
        let flash = board.chip().flash();
        flash[store::FIRST..store::FIRST + stored.len()].copy_from_slice(&stored);
        boards.push(board);
    }
    Ok(boards)
}

impl VirtualRobot {
    /// Builds a robot with the random errors of a trial, switches its boards on and waits until all nodes are ready.
    pub fn new(
        scenario: &Scenario,
        images: &Images,
        seed: u64,
        trial: u64,
        options: &Options,
        logs: &[BoardLog],
    ) -> Result<Self, Error> {
        let mut robot = Self::without_power(scenario, images, seed, trial, options, logs)?;
        robot.boot(options)?;
        Ok(robot)
    }

    /// Builds the robot with its boards switched off.
    fn without_power(
        scenario: &Scenario,
        images: &Images,
        seed: u64,
        trial: u64,
        options: &Options,
        logs: &[BoardLog],
    ) -> Result<Self, Error> {
        let topology = scenario.robot.topology();
        let drawn = scenario.world.draw(topology, seed, trial);
        let plant = scenario.world.plant_of(&drawn, scenario.mission.rps);
        let mut plant = plant.map_err(|error| Refusal::of("plant.", &error))?;
        let start = std::array::from_fn(|i| scenario.mission.start[i] + drawn.placement[i]);
        plant.place(start);
        let sensors = Sensors::new(&scenario.world.sensors, &drawn, seed, trial)
            .map_err(|error| Error::input(error.to_string()))?;
        let gauges = scenario.world.gauges_of(&drawn, &plant);
        let bridges = topology.frames().map(|frame| {
            let gauges = 0..gauges[frame.index()].len();
            gauges.map(|k| BridgeParts::of(&drawn, frame, k)).collect()
        });
        let bridges: Vec<Vec<BridgeParts>> = bridges.collect();
        let fitted = |role: &Role| scenario.mission.rps || !role.is_beam();
        let roles: Vec<Role> = topology.boards().filter(fitted).collect();
        let parts = (drawn, bridges);
        let boards = boards(scenario, images, (seed, trial), options, &roles, &parts)?;
        let mut wire = Wire::new(boards.len() + options.extra_nodes, QUANTUM, seed);
        wire.record();
        let at = posture(scenario.mission.start);
        let place = scenario
            .robot
            .placement(at, &scenario.mission.configured_placement());
        Ok(Self {
            topology,
            network: Network::new(boards, wire, QUANTUM, options.threads),
            readers: roles
                .iter()
                .map(|&role| Reader::new(images.of(role), &logs[topology.place(role)]))
                .collect(),
            observations: roles.iter().map(|_| BoardObservations::default()).collect(),
            half_thickness: scenario.world.sensors.bridge.half_thickness_m,
            strains: vec![[0.0; MAX_GAUGES]; topology.frame_count()],
            outlines: outlines(&plant),
            sensors: Box::new(sensors),
            inertial: scenario.world.sensors.gyro.fitted,
            biases: vec![[0.0; 2]; topology.axle_count()],
            link: BoardLink::new(topology, Role::LEAD, 0),
            other_links: Vec::new(),
            recorded: false,
            reported: Vec::new(),
            hosted: false,
            clock: Clock::default(),
            place,
            lead: lead::Output::default(),
            estimate_time: None,
            task: Task::Idle,
            images: images.clone(),
            roles,
            gauges,
            plant,
            start,
            start_angles: topology.axles().map(|_| [0.0; 2]).collect(),
            frames: 0,
            booted: Time(0),
            tick: 0,
            control: RunControl::default(),
            monitor: Monitor::new(topology),
            failure: None,
            tools: Tools::new(topology),
            blocked: None,
        })
    }

    /// Time from power-on until all nodes were ready, s.
    pub fn boot_s(&self) -> f64 {
        self.booted.seconds()
    }

    /// Frames on the bus so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Reports of all boards so far.
    pub fn reports(&mut self) -> Vec<BoardReport> {
        let mut reports = Vec::new();
        for (place, &role) in self.roles.iter().enumerate() {
            let can = self.network.wire().statistics(place);
            let Some(board) = self.network.board(place) else {
                continue;
            };
            reports.push(report::of(
                self.topology,
                role,
                self.images.of(role),
                board,
                &self.observations[place],
                &can,
            ));
        }
        reports
    }

    fn place(&self, role: Role) -> Option<usize> {
        self.roles.iter().position(|other| *other == role)
    }

    fn axle(&mut self, role: Role) -> Option<&mut AxleBoard> {
        let place = self.place(role)?;
        self.network.board(place)?.chip().circuit::<AxleBoard>()
    }

    fn beam(&mut self, frame: FrameId) -> Option<&mut BeamBoard> {
        let place = self.place(Role::Beam(frame))?;
        self.network.board(place)?.chip().circuit::<BeamBoard>()
    }

    /// Makes a board's log full and blocking, and stops reading the log.
    fn hang_reader(&mut self, role: Role) {
        if let Some(place) = self.place(role)
            && let Some(board) = self.network.board(place)
        {
            self.readers[place].hang(board);
        }
    }

    /// Switches on the boards whose power-on delay ends now.
    fn power_up(&mut self, options: &Options) {
        let now = self.network.now();
        for place in 0..self.roles.len() {
            let role = self.roles[place];
            let late = options.late_ms.iter().find(|(board, _)| *board == role);
            let after = late.map_or(0, |(_, ms)| *ms);
            if now == Time::from_micros(1000 * after)
                && let Some(board) = self.network.board(place)
            {
                board.power(true);
            }
        }
    }

    /// Switches the boards on and runs them until all nodes are ready.
    fn boot(&mut self, options: &Options) -> Result<(), Error> {
        let mut ready = 0;
        while ready < READY_TICKS {
            let now = self.network.now();
            self.power_up(options);
            self.advance();
            ready = if self.waits_for().is_none() {
                ready + 1
            } else {
                0
            };
            if now >= BOOT_TIMEOUT {
                let why = self.waits_for().unwrap_or_default();
                return Err(Error::Failure(format!(
                    "the boards were not ready {} s after power on: {why}",
                    BOOT_TIMEOUT.seconds()
                )));
            }
        }
        self.hosted = options.host;
        if options.host {
            self.open_links(options.record)?;
        }
        self.booted = self.network.now();
        for (place, observed) in self.observations.iter_mut().enumerate() {
            let lost = self.network.wire().statistics(place).given_up;
            if let Some(board) = self.network.board(place) {
                observed.booted(board, lost);
            }
        }
        Ok(())
    }

    /// Description of the first node that is not ready; `None` if all are.
    fn waits_for(&self) -> Option<String> {
        let fitted = |node: &Node| {
            let board = node.board();
            board.is_some_and(|board| self.roles.contains(&board))
        };
        for node in self.topology.nodes().filter(fitted) {
            let name = self.topology.node_name(node);
            match self.monitor.latest(node) {
                None => return Some(format!("no heartbeat of {name}")),
                Some(status) if status.state != OperatingState::Idle || status.reason.is_some() => {
                    return Some(status.to_string());
                }
                // Until the bias at rest is known, the node does not use the inertial sensor, and the robot would drive
                // without it.
                Some(status)
                    if self.inertial && status.notices.contains(Condition::InertialLost) =>
                {
                    return Some(format!("{name}: bias of the inertial sensor not yet known"));
                }
                Some(_) => {}
            }
        }
        None
    }

    /// Advances boards, bus and plant by one millisecond.
    fn advance(&mut self) {
        let from = self.network.now();
        self.update_sensors(from);
        self.network.run_until(from + TICK);
        self.follow();
    }

    /// Advances the plant with the torques of the boards, then reads the bus and the logs.
    fn follow(&mut self) {
        let until = self.network.now();
        let axles = self.topology.axles().map(Role::Axle);
        let torque = axles.map(|role| {
            let axle = self.axle(role);
            axle.map_or([0.0; 2], |axle| axle.take_torque(until))
        });
        let mut torque: Vec<_> = torque.collect();
        // Friction holds a blocked wheel against its motor.
        if let Some((axle, side)) = self.blocked {
            let speed = self.plant.axles()[axle].wheel_speed[side];
            torque[axle][side] = -BLOCKED_NM_S * speed;
        }
        self.plant.step(&torque);
        self.read_bus();
        for (reader, board) in self.readers.iter_mut().zip(self.network.boards()) {
            reader.read(board);
        }
    }

    /// Passes the plant's motion and strains to the boards' sensors.
    fn update_sensors(&mut self, at: Time) {
        let axles = self.plant.axles().to_vec();
        if self.booted > Time(0) {
            self.biases.clear();
            self.biases.extend(self.sensors.inertial_biases());
        }
        for (number, axle) in self.topology.axles().zip(&axles) {
            let [rate, force] = self.biases[number.index()];
            let start_angles = self.start_angles[number.index()];
            let wheel = |k: usize| WheelMotion {
                angle_rad: start_angles[k] + axle.motor_angle[k],
                speed_rad_s: axle.motor_speed[k],
            };
            let motion = AxleMotion {
                wheels: [wheel(0), wheel(1)],
                inertial: Motion {
                    rate: [0.0, 0.0, axle.velocity[2] + rate],
                    rate_slope: [0.0, 0.0, axle.acceleration[2]],
                    force: [
                        axle.acceleration[0] + force,
                        axle.acceleration[1],
                        GRAVITY_M_S2,
                    ],
                    force_slope: [0.0; 3],
                },
            };
            if let Some(board) = self.axle(Role::Axle(number)) {
                board.motion(at, &motion);
            }
        }
        for frame in self.topology.frames() {
            let mut strains = [0.0; MAX_GAUGES];
            let (half, gauges) = (self.half_thickness, &self.gauges[frame.index()]);
            self.plant.gauges(frame.index(), gauges, |i, curvature| {
                if let Some(strain) = strains.get_mut(i) {
                    *strain = half * curvature;
                }
            });
            if let Some(beam) = self.beam(frame) {
                beam.strain(at, &mut strains);
                self.strains[frame.index()] = strains.map(|strain| strain as f32);
            }
        }
        for board in self.network.boards() {
            board.chip().refresh();
        }
    }

    /// Records health and identity messages of a board.
    fn observe_board(&mut self, message: &Message) {
        let (Message::BoardHealth { board, .. } | Message::BoardIdentity { board, .. }) = *message
        else {
            return;
        };
        let place = self.place(board);
        let Some(observed) = place.and_then(|place| self.observations.get_mut(place)) else {
            return;
        };
        match *message {
            Message::BoardHealth {
                missed_ticks,
                tick_worst_us,
                tick_jitter_us,
                ..
            } => {
                observed.health(missed_ticks, tick_worst_us, tick_jitter_us);
            }
            Message::BoardIdentity { build, schema, .. } => observed.identify(build, schema),
            _ => {}
        }
    }

    /// Reads the bus frames of the latest step.
    fn read_bus(&mut self) {
        for record in self.network.wire().take_records() {
            let sender = self.roles.get(record.node).copied();
            if !self.tools.count_transmission(sender, &record) {
                continue;
            }
            self.frames += 1;
            let Id::Standard(id) = record.frame.id() else {
                continue;
            };
            let bytes = record.frame.data();
            let mut data = [0; 8];
            data[..bytes.len()].copy_from_slice(bytes);
            let frame = bus::CanFrame {
                id,
                length: bytes.len() as u8,
                data,
            };
            let at = record.end - self.booted;
            self.monitor.receive((at.micros() / 1000) as u32, &frame);
            let Ok(message) = bus::decode(&frame) else {
                continue;
            };
            self.clock.receive(record.end.micros(), &message);
            self.observe_board(&message);
        }
    }
}

impl Robot for VirtualRobot {
    fn now(&self) -> Micros {
        self.tick * core_algos::time::TICK
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        if let HostCommand::Task(task) = command {
            self.task = *task;
        }
        self.link.command(command);
        Ok(())
    }

    fn is_settled(&self) -> bool {
        self.link.is_settled()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), Error> {
        self.link.send(frame);
        Ok(())
    }

    fn room(&mut self) -> Room {
        self.link.room()
    }

    fn failure(&self) -> Option<String> {
        if self.failure.is_some() {
            return self.failure.clone();
        }
        let fault = self.monitor.fault_since(Node::Lead)?;
        let lasts = self.tick.saturating_sub(fault) >= TICKS_AFTER_FAULT;
        (lasts && !self.restart_pending())
            .then(|| self.monitor.why_stopped())
            .flatten()
    }

    fn step(&mut self) -> Result<(), Error> {
        self.begin_tick();
        self.send_due_bytes()?;
        self.advance();
        self.read_sent_bytes()?;
        self.tick += 1;
        self.end_tick()
    }

    fn record(&self) -> Record {
        let (lead, strain) = (self.lead, |frame: usize| self.strains[frame]);
        Record::of(self.now(), &self.plant, &self.outlines, lead, strain)
    }

    fn plant(&self) -> Option<&Plant> {
        Some(&self.plant)
    }

    fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    fn monitor_mut(&mut self) -> &mut Monitor {
        &mut self.monitor
    }

    fn control(&self) -> &RunControl {
        &self.control
    }

    fn control_mut(&mut self) -> &mut RunControl {
        &mut self.control
    }

    fn estimate_age(&self) -> Micros {
        let now = self.network.now().micros();
        self.estimate_time
            .map_or(EPOCH, |estimate_time| now.saturating_sub(estimate_time))
    }

    fn builds(&self) -> Vec<(Role, String)> {
        let of = |role: &Role| (*role, self.images.name(*role));
        self.roles.iter().map(of).collect()
    }

    fn traffic(&self) -> Vec<BoardTraffic> {
        self.board_traffic()
    }

    fn bus(&self) -> BusStatistics {
        BusStatistics {
            sent: self.frames,
            ..BusStatistics::default()
        }
    }
}
