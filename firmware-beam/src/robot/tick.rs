//! The beam's tick, once a millisecond: sample → receive → node → calibrate → send.

use core_algos::acquisition::rest_noise::RestNoise;
use core_algos::beam::procedure::{Event, Procedure};
use core_algos::beam::{MAX_GAUGES, calibration};
use core_algos::bus::Message;
use core_algos::bus::field::CalibrationResult;
use core_algos::config::ConfigError;
use core_algos::link::record::{Entry, Reference};
use core_algos::node::Outbox;
use core_algos::node::beam::{self, BeamNode};
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::node::tick_sync::{Step, TickSync};
use core_algos::params::Disarmed;
use core_algos::safety::{Condition, Conditions};
use core_algos::time::{Micros, TICK, sequence};
use core_algos::topology::Role;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_sync::watch;
use firmware_common::can::{self, Receiver, Sender};
use firmware_common::fault;
use firmware_common::identity::Identity;
use firmware_common::led::Led;
use firmware_common::link;
use firmware_common::record;
use firmware_common::task_watchdog::CheckIn;
use firmware_common::timing::{Every, Stopwatch};

use super::bridges::{Block, Bridges};
use crate::rules::Motors;

/// Ticks between health reports.
const HEALTH: u8 = 100;
/// Nominal supply of the board, V; the excitation is measured against it.
const SUPPLY_V: f32 = 3.3;

/// Report for the log.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Excitation over its nominal value.
    pub excitation: f32,
    /// Temperature of the strip, °C.
    pub temperature_c: Option<f32>,
    /// Gauges the latest posture was made from.
    pub gauges: u8,
    /// True if the common time is known and the ticks are in step with it.
    pub in_step: bool,
    /// Largest jitter and longest tick since the last report, µs.
    pub timing_us: (u16, u16),
    /// Ticks missed since the start.
    pub missed: u16,
    /// Times conversions were lost since the start.
    pub lost: u16,
    /// Standard deviations of the bridges over the last 10 s with the motors off, counts.
    pub noise: Option<[f32; MAX_GAUGES]>,
}

/// Destination of the tick's report.
pub type Reports = watch::Sender<'static, CriticalSectionRawMutex, Report, 1>;

/// A calibration on its way into the store, and whether it got there on the way back.
pub struct Saving {
    /// To the store.
    pub wanted: Signal<CriticalSectionRawMutex, (calibration::Config, Disarmed)>,
    /// From the store.
    pub done: Signal<CriticalSectionRawMutex, bool>,
}

/// Everything the tick works with.
pub struct Beam {
    /// State of the node, to be seen.
    pub led: Led,
    /// Identity of the board, for the bus.
    pub identity: Identity,
    /// Bridges.
    pub bridges: Bridges,
    /// Bus, outwards.
    pub sender: Sender,
    /// Bus, inwards.
    pub receiver: Receiver,
    /// Configuration, with the calibration in use.
    pub config: RobotConfig,
    /// The node.
    pub node: BeamNode,
    /// Calibration on request.
    pub procedure: Procedure,
    /// The store's two signals.
    pub saving: &'static Saving,
    /// State of the parameters at the start.
    pub parameters: Conditions,
    /// Destination of the reports.
    pub reports: Reports,
    /// For the watchdog.
    pub check_in: CheckIn,
}

/// All that changes from tick to tick.
struct State {
    sync: TickSync,
    motors: Motors,
    saving: Option<u8>,
    /// Times conversions were lost.
    lost: u16,
    rest_noise: RestNoise<MAX_GAUGES>,
    noise: Option<[f32; MAX_GAUGES]>,
    /// Conditions found since the latest tick of the node.
    found: Conditions,
    /// The latest tick as a host was told it.
    reference: Reference,
    /// A calibration was adopted since the start: the node is not that of the configuration.
    adopted: bool,
}

/// The node of a configuration.
pub fn node(config: &RobotConfig) -> Result<BeamNode, ConfigError> {
    config.build_beam()
}

/// Runs the tick for ever.
#[embassy_executor::task]
pub async fn run(mut beam: Beam) -> ! {
    let mut stopwatch = Stopwatch::new(TICK as u32);
    let mut health = Every::new(HEALTH);
    let mut state = State {
        sync: TickSync::following(),
        motors: Motors::default(),
        saving: None,
        lost: 0,
        rest_noise: RestNoise::default(),
        noise: None,
        found: Conditions::NONE.with(Condition::Restarted, fault::restarted()),
        reference: Reference::default(),
        adopted: false,
    };
    loop {
        let block = beam.bridges.read().await;
        beam.check_in.report();
        let Some(block) = block else {
            // Which sample is of which bridge is no longer known: the scan begins anew, and the axles
            // do without the beam for a few milliseconds.
            state.lost = state.lost.saturating_add(1);
            state.found.set(Condition::ConversionsLost, true);
            beam.bridges.restart();
            continue;
        };
        stopwatch.begin();
        beam.tick(&mut state, &block);
        stopwatch.end();
        if health.tick() {
            beam.report_health(&state, &block, stopwatch.take());
        }
    }
}

impl Beam {
    fn tick(&mut self, state: &mut State, block: &Block) {
        self.led.step(block.local);
        self.begin(state, block.local);
        self.receive(state, block.local);
        self.run_node(state, block);
        self.calibrate(state, block);
        self.sender.serve();
        link::set_armed(!state.motors.are_off(block.local));
        if !state.motors.are_off(block.local) {
            state.rest_noise = RestNoise::default();
        } else if let Some(noise) = state.rest_noise.step(&block.counts) {
            state.noise = Some(noise);
        }
    }

    /// Lets the node begin anew for a host that records.
    fn begin(&mut self, state: &mut State, local: Micros) {
        if let Some(last) = state.sync.last()
            && record::take_wanted()
            && state.motors.are_off(local)
        {
            self.node.restart();
            record::put(&state.reference.begin(last + TICK));
            if state.adopted {
                record::put(&Entry::End);
            }
        }
    }

    fn receive(&mut self, state: &mut State, local: Micros) {
        while let Some(arrived) = self.receiver.take() {
            state.sync.receive(arrived.local, &arrived.message);
            self.node.receive(&arrived.message);
            state.motors.receive(local, &arrived.message);
            if let Message::BeamCalibration {
                sequence,
                calibrate,
            } = arrived.message
                && state.saving.is_none()
            {
                self.procedure.request(sequence, calibrate);
            }
        }
    }

    /// A restart is no different here: the node remembers samples, not times.
    fn run_node(&mut self, state: &mut State, block: &Block) {
        let step = state.sync.step(block.local);
        self.bridges.trim(state.sync.trim());
        let (Step::Run(now) | Step::Restart(now)) = step else {
            return;
        };
        let found = core::mem::take(&mut state.found);
        let conditions = found.union(state.sync.conditions()).union(self.parameters);
        let samples = beam::Samples {
            counts: block.counts,
            conditions: conditions.with(Condition::BusOff, can::is_off()),
        };
        let mut outbox = Outbox::new();
        self.node.step(now, &samples, &mut outbox);
        record::put(&state.reference.tick(now, &Samples::Beam(samples), [0.0; 2]));
        for message in outbox.iter() {
            self.led.see(message);
            self.sender.send(message);
        }
    }

    fn calibrate(&mut self, state: &mut State, block: &Block) {
        if let Some(sequence) = state.saving
            && let Some(stored) = self.saving.done.try_take()
        {
            state.saving = None;
            let result = match stored {
                true => CalibrationResult::Stored,
                false => CalibrationResult::NotStored,
            };
            self.answer(sequence, result, 0);
        }
        let motors_off = state.motors.are_off(block.local);
        let calibration = &self.config.beam.calibration;
        match self
            .procedure
            .sample(calibration, &block.counts, motors_off)
        {
            Some(Event::Refused {
                sequence,
                result,
                gauge,
            }) => self.answer(sequence, result, gauge),
            Some(Event::Adopt { sequence, config }) => {
                let mut robot = self.config;
                robot.beam.calibration = config;
                match (node(&robot), Disarmed::when(motors_off)) {
                    (Ok(node), Some(off)) => {
                        self.node = node;
                        self.config = robot;
                        state.adopted = true;
                        record::put(&Entry::End);
                        state.saving = Some(sequence);
                        self.saving.wanted.signal((config, off));
                    }
                    (Ok(_), None) => self.answer(sequence, CalibrationResult::MotorsOn, 0),
                    (Err(_), _) => self.answer(sequence, CalibrationResult::OutOfRange, 0),
                }
            }
            None => {}
        }
    }

    fn answer(&mut self, sequence: u8, result: CalibrationResult, gauge: u8) {
        self.sender.send(&Message::BeamCalibrated {
            sequence,
            result,
            gauge,
        });
    }

    fn report_health(&mut self, state: &State, block: &Block, timing_us: (u16, u16)) {
        let temperature_c = self.bridges.temperature();
        let sequence = sequence(state.sync.last().unwrap_or(block.local));
        if let Some(message) = self.identity.message(Role::Beam, sequence) {
            self.sender.send(&message);
        }
        self.sender.send(&Message::BoardHealth {
            board: Role::Beam,
            sequence,
            missed_ticks: state.sync.missed().min(255) as u8,
            tick_jitter_us: timing_us.0,
            tick_worst_us: timing_us.1,
            supply_v: (block.excitation * SUPPLY_V).clamp(0.0, 25.5),
            temperature_c: temperature_c.unwrap_or(-128.0).clamp(-128.0, 127.0),
        });
        let gauges = self.node.latest().map_or(0, |latest| latest.used.count());
        self.reports.send(Report {
            excitation: block.excitation,
            temperature_c,
            gauges: gauges as u8,
            in_step: state.sync.in_step(),
            timing_us,
            missed: state.sync.missed(),
            lost: state.lost,
            noise: state.noise,
        });
    }
}
