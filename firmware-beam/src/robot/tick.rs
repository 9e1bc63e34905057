//! The beam's tick, once a millisecond: sample → receive → node → calibrate → send.

use core_algos::acquisition::rest_noise::RestNoise;
use core_algos::beam::procedure::{Event, Procedure};
use core_algos::beam::{MAX_GAUGES, calibration};
use core_algos::bus::Message;
use core_algos::bus::field::CalibrationResult;
use core_algos::link::MotorState;
use core_algos::node::Outbox;
use core_algos::node::beam::{self, BeamNode};
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::node::tick_sync::TickStep;
use core_algos::params::Disarmed;
use core_algos::safety::{Condition, Conditions};
use core_algos::time::{Micros, TICK};
use core_algos::topology::{FrameId, Role, Wheels};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use firmware_common::can::Arrived;
use firmware_common::fault;
use firmware_common::tick_loop::{self, BoardTick, Chip, Health, TickLoop};

use super::bridges::{Block, Bridges};
use crate::rules::Motors;

/// Nominal supply of the board, V: the supply reported in health messages if the excitation is nominal.
const SUPPLY_V: f32 = 3.3;

/// Report of the beam's tick for the board's log.
#[derive(Clone, Copy, Debug)]
pub struct BeamReport {
    /// Timing, misses and synchronisation of the ticks.
    pub health: Health,
    /// Excitation divided by its nominal value.
    pub excitation: f32,
    /// Temperature of the strip, °C.
    pub temperature_c: Option<f32>,
    /// Number of gauges used by the latest posture.
    pub gauges: u8,
    /// Number of times that conversions were lost since the start.
    pub lost: u16,
    /// Standard deviations of the bridges over the last 10 s with the motors off, counts.
    pub noise: Option<[f32; MAX_GAUGES]>,
}

/// State of the tick that all boards share, on this board's chip.
type Common = tick_loop::Common<Chip>;

/// Signals between the tick and the store, to save a calibration.
pub struct Saving {
    /// From the tick: calibration to save, and the proof that the motors are off.
    pub wanted: Signal<CriticalSectionRawMutex, (calibration::Config, Disarmed)>,
    /// From the store: true if the calibration was saved.
    pub done: Signal<CriticalSectionRawMutex, bool>,
}

/// Devices, node and calibration that the beam's tick works with.
pub struct Beam {
    /// Sampling of the strain bridges.
    pub bridges: Bridges,
    /// Configuration, with the calibration in use.
    pub config: RobotConfig,
    /// Beam node, which computes the relative posture.
    pub node: BeamNode,
    /// Calibration procedure, which a message starts.
    pub procedure: Procedure,
    /// Signals to and from the store.
    pub saving: &'static Saving,
    /// Conditions from reading the stored parameters at the start.
    pub parameters: Conditions,
}

/// Parts of the tick that only a beam board has.
pub struct BeamTick {
    beam: Beam,
    motors: Motors,
    motors_off: bool,
    /// Request number of the calibration that is being saved.
    saving: Option<u8>,
    /// Number of times that conversions were lost since the start.
    lost: u16,
    rest_noise: RestNoise<MAX_GAUGES>,
    noise: Option<[f32; MAX_GAUGES]>,
    /// Conditions found since the node's latest step.
    found: Conditions,
    /// True if a calibration was adopted since the start, so that the node does not match the start configuration.
    adopted: bool,
}

/// Runs the tick for ever.
#[embassy_executor::task]
pub async fn run(mut tick: TickLoop<BeamTick>) -> ! {
    tick.run().await
}

impl BoardTick for BeamTick {
    type Hardware = Chip;
    type Input = Block;
    type Samples = Block;
    type LogReport = BeamReport;

    async fn wait(&mut self) -> Option<(Micros, Block)> {
        let block = self.beam.bridges.read().await;
        if block.is_none() {
            // The assignment of samples to bridges is lost. The scan restarts, and the axles drive without
            // the beam for a few milliseconds.
            self.lost = self.lost.saturating_add(1);
            self.found.set(Condition::ConversionsLost, true);
            self.beam.bridges.restart();
        }
        block.map(|block| (block.local, block))
    }

    /// Restarts the node if a host begins to record and the motors are off.
    fn begin(&mut self, local: Micros, block: Block, common: &mut Common) -> Block {
        if let Some(last) = common.sync.last()
            && common.link.take_begin()
            && self.motors.are_off(local)
        {
            self.beam.node.restart();
            common.record_begin(last + TICK);
            if self.adopted {
                common.record_end();
            }
        }
        block
    }

    fn receive(&mut self, block: &Block, arrived: &Arrived) {
        self.beam.node.receive(&arrived.message);
        self.motors.receive(block.local, &arrived.message);
        if let Message::BeamCalibration {
            frame,
            sequence,
            calibrate,
        } = arrived.message
            && frame == self.frame()
            && self.saving.is_none()
        {
            self.beam.procedure.request(sequence, calibrate);
        }
    }

    fn step(&mut self, block: &Block, common: &mut Common) {
        self.motors_off = self.motors.are_off(block.local);
        self.run_node(block, common);
        self.calibrate(block, common);
        if !self.motors_off {
            self.rest_noise = RestNoise::default();
        } else if let Some(noise) = self.rest_noise.step(&block.counts) {
            self.noise = Some(noise);
        }
    }

    fn motors(&self) -> MotorState {
        match self.motors_off {
            true => MotorState::Off,
            false => MotorState::Driven,
        }
    }

    fn report(&mut self, block: &Block, health: Health, common: &mut Common) -> BeamReport {
        let temperature_c = self.beam.bridges.temperature();
        let board = Role::Beam(self.frame());
        common.send_identity(board, &health);
        let supply_v = block.excitation * SUPPLY_V;
        common.send(&health.message(board, supply_v, temperature_c.unwrap_or(-128.0)));
        let latest = self.beam.node.latest();
        let gauges = latest.map_or(0, |latest| latest.used.count());
        BeamReport {
            health,
            excitation: block.excitation,
            temperature_c,
            gauges: gauges as u8,
            lost: self.lost,
            noise: self.noise,
        }
    }
}

impl BeamTick {
    /// Creates the tick of a beam board, before its first tick.
    pub fn new(beam: Beam) -> Self {
        Self {
            beam,
            motors: Motors::default(),
            motors_off: true,
            saving: None,
            lost: 0,
            rest_noise: RestNoise::default(),
            noise: None,
            found: Conditions::NONE.with(Condition::Restarted, fault::restarted()),
            adopted: false,
        }
    }

    /// Frame whose gauges this board reads.
    fn frame(&self) -> FrameId {
        self.beam.node.frame()
    }

    /// Steps the node. A step of the clock does not restart the node, because the node stores samples, not times.
    fn run_node(&mut self, block: &Block, common: &mut Common) {
        let step = common.sync.step(block.local);
        self.beam.bridges.trim(common.sync.trim());
        let (TickStep::Run(now) | TickStep::Restart(now)) = step else {
            return;
        };
        let conditions = core::mem::take(&mut self.found)
            .union(common.conditions())
            .union(self.beam.parameters);
        let samples = beam::Samples {
            counts: block.counts,
            conditions,
        };
        let mut outbox = Outbox::new();
        self.beam.node.step(now, &samples, &mut outbox);
        common.record_tick(now, &Samples::Beam(samples), Wheels::default());
        for message in outbox.iter() {
            common.send_of_node(message);
        }
    }

    /// Reports the result of a saved calibration, and advances a calibration under way.
    fn calibrate(&mut self, block: &Block, common: &mut Common) {
        if let Some(sequence) = self.saving
            && let Some(stored) = self.beam.saving.done.try_take()
        {
            self.saving = None;
            let result = match stored {
                true => CalibrationResult::Stored,
                false => CalibrationResult::NotStored,
            };
            reply(self.frame(), sequence, result, 0, common);
        }
        let frame = self.frame();
        let calibration = &self.beam.config.beam.calibration;
        let procedure = &mut self.beam.procedure;
        match procedure.sample(calibration, &block.counts, self.motors_off) {
            Some(Event::Refused {
                sequence,
                result,
                gauge,
            }) => reply(frame, sequence, result, gauge, common),
            Some(Event::Adopt { sequence, config }) => self.adopt(sequence, config, common),
            None => {}
        }
    }

    /// Adopts a calibration and requests its storage.
    fn adopt(&mut self, sequence: u8, calibration: calibration::Config, common: &mut Common) {
        let frame = self.frame();
        let mut config = self.beam.config;
        config.beam.calibration = calibration;
        match (config.build_beam(frame), Disarmed::when(self.motors_off)) {
            (Ok(node), Some(off)) => {
                self.beam.node = node;
                self.beam.config = config;
                self.adopted = true;
                common.record_end();
                self.saving = Some(sequence);
                self.beam.saving.wanted.signal((calibration, off));
            }
            (Ok(_), None) => reply(frame, sequence, CalibrationResult::MotorsOn, 0, common),
            (Err(_), _) => reply(frame, sequence, CalibrationResult::OutOfRange, 0, common),
        }
    }
}

/// Sends the result of a calibration on the bus.
fn reply(frame: FrameId, sequence: u8, result: CalibrationResult, gauge: u8, common: &mut Common) {
    common.send(&Message::BeamCalibrated {
        frame,
        sequence,
        result,
        gauge,
    });
}
