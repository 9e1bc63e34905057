//! Trials of a single board: power failures at the start and during flash writes, and damaged flash contents.

use super::Campaign;
use super::bench::FaultBench;
use super::run::node;
use crate::virtual_robot::{Options, store};
use core_algos::bus::field::Calibrate;
use core_algos::bus::{self, Message};
use core_algos::params::stored::StoreReport;
use core_algos::params::{BoardKind, Disarmed, Settings, TABLE};
use core_algos::safety::Condition;
use core_algos::topology::{FrameId, Node, Role};
use firmware_common::store::Store;
use firmware_common::store::simulated::{Flash, run};
use host_sim::base::error::Error;
use host_sim::run::recovery::Monitor;
use host_sim::run::robot::Robot;
use host_sim::world::random::{Stream, generator};
use rand::RngExt;
use std::ops::Range;
use virtual_board::Time;
use virtual_board::chip::FlashOperation;
use virtual_board::finding::FindingKind;
use virtual_board::wire::{Frame, Id};

/// Outer error: the trial could not run. Inner result: number of cases, or description of the failure.
type TrialResult = Result<Result<usize, String>, Error>;

const SECTOR: usize = 16 << 10;
/// Address range of the stored parameters in the flash.
const STORE: Range<usize> = store::FIRST..store::FIRST + 3 * SECTOR;
/// Limit of the time from power-on to a board's first status message, ms.
const STARTED_MS: u64 = 1_000;
/// Limit of the time of a calibration and its save, ms.
const SAVED_MS: u64 = 6_000;

const fn ms(count: u64) -> Time {
    Time::from_micros(1_000 * count)
}

/// Robot under test with its boards off, and with an additional bus node that acknowledges frames.
fn acknowledging_bench(campaign: &Campaign, seed: u64) -> Result<FaultBench, Error> {
    let mut bench = FaultBench::new(campaign, Options::default(), seed)?;
    bench.intruder(|_, _| {});
    Ok(bench)
}

impl FaultBench {
    /// Runs boards and plant for `ms` milliseconds.
    pub fn run_for(&mut self, ms: u64) {
        for _ in 0..ms {
            self.robot.advance();
        }
    }

    /// Switches a board on and waits for its first status message.
    fn start_board(&mut self, role: Role) {
        self.board(role, |board| board.power(true));
        let now = self.now();
        // The beam board sends only if another node sends the common time.
        if role == Role::beam(0) {
            for epoch in 0..STARTED_MS as u32 / 10 {
                let message = Message::TimeSync {
                    epoch,
                    last_delay_us: (epoch > 0).then_some(0),
                };
                self.send(now + ms(50 + 10 * u64::from(epoch)), &message);
            }
        }
        self.await_status(role);
    }

    /// Waits for the first status message of a board, at most [`STARTED_MS`].
    fn await_status(&mut self, role: Role) {
        for _ in 0..STARTED_MS {
            self.run_for(1);
            if self.robot.monitor().latest(node(role)).is_some() {
                return;
            }
        }
    }

    /// Sends a message from the additional bus node.
    fn send(&mut self, at: Time, message: &Message) {
        let Ok(frame) = bus::encode(message) else {
            return;
        };
        let data = frame.data.get(..frame.length.into()).unwrap_or_default();
        let frame = Frame::new(Id::Standard(frame.id), data);
        self.intruder(|node, _| node.send(at, frame));
    }

    /// Contents of the parameter store in a board's flash.
    fn read_store(&mut self, role: Role) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.board(role, |board| bytes = board.chip().flash()[STORE].to_vec());
        bytes
    }

    fn write_store(&mut self, role: Role, bytes: &[u8]) {
        self.board(role, |board| {
            board.chip().flash()[STORE].copy_from_slice(bytes);
        });
    }

    fn operations(&mut self) -> Vec<FlashOperation> {
        let mut list = Vec::new();
        self.board(Role::beam(0), |board| {
            list = board.chip().flash_operations().to_vec();
        });
        list
    }

    /// First finding of a board except resets; `None` if there is none.
    fn first_finding(&mut self, role: Role) -> Option<String> {
        let mut first_finding = None;
        self.board(role, |board| {
            let mut findings = board.chip().findings().list().iter();
            let finding = findings.find(|found| found.kind != FindingKind::Reset);
            first_finding = finding.map(ToString::to_string);
        });
        first_finding
    }
}

/// Settings that a board reads from these bytes of its parameter store, and its report on the store.
fn settings_from_store(bytes: &[u8], role: Role) -> (Settings, StoreReport) {
    let mut flash = Flash::<SECTOR>::new(3, 1);
    flash.bytes.copy_from_slice(bytes);
    let range = flash.range();
    let kind = BoardKind::of(role);
    let base = Settings::of(kind);
    let Some(mut store) = Store::new(flash, range) else {
        return (base, StoreReport::default());
    };
    let check = |settings: &Settings| settings.check_role(kind).map(|_| ());
    run(store.load()).resolve(&base, check)
}

/// Tests power failures at random instants of a start, after one undisturbed start.
pub fn brown_outs(campaign: &Campaign, seed: u64) -> TrialResult {
    let cases = if campaign.quick { 10 } else { 100 };
    let mut bench = acknowledging_bench(campaign, seed)?;
    bench.start_board(Role::LEAD);
    let before = bench.read_store(Role::LEAD);
    for case in 0..cases {
        bench.board(Role::LEAD, |board| board.power(false));
        bench.run_for(2);
        bench.board(Role::LEAD, |board| board.power(true));
        let at = bench.now() + Time::from_micros(bench.draw(120_000));
        let span = Time::from_micros(10 + bench.draw(3_000));
        let volts = bench.draw(2_700) as f64 * 1e-3;
        bench.axle(Role::LEAD, |axle, _| axle.power.dip(at, at + span, volts));
        while bench.now() < at + span {
            bench.run_for(1);
        }
        bench.robot.monitor = Monitor::new(bench.robot.topology);
        bench.await_status(Role::LEAD);
        let started = bench.robot.monitor().latest(Node::axle(0)).is_some();
        let unchanged = bench.read_store(Role::LEAD) == before;
        if let Some(first_finding) = bench.first_finding(Role::LEAD) {
            return Ok(Err(format!("{at}, {volts} V: {first_finding}")));
        }
        if !(started && unchanged) {
            return Ok(Err(format!(
                "case {case}: {at}, {volts} V for {span}: heartbeat received {started}, flash unchanged {unchanged}"
            )));
        }
    }
    Ok(Ok(cases))
}

/// Robot whose beam board was asked to calibrate its zeros and will save them, and the time of the request.
fn calibrating(
    campaign: &Campaign,
    seed: u64,
    stored: Option<&[u8]>,
) -> Result<(FaultBench, Time), Error> {
    let mut bench = acknowledging_bench(campaign, seed)?;
    if let Some(bytes) = stored {
        bench.write_store(Role::beam(0), bytes);
    }
    bench.start_board(Role::beam(0));
    let requested_at = bench.now();
    let message = Message::BeamCalibration {
        frame: FrameId(0),
        sequence: 1,
        calibrate: Calibrate::Zero(0.0),
    };
    bench.send(requested_at, &message);
    Ok((bench, requested_at))
}

/// Tests power cuts during the flash operations of a save. `wanted` gives the instants in each operation as fractions
/// of the operation's duration.
fn cuts(
    campaign: &Campaign,
    seed: u64,
    stored: Option<&[u8]>,
    wanted: impl Fn(usize, &FlashOperation) -> Vec<f64>,
) -> TrialResult {
    let (mut bench, requested_at) = calibrating(campaign, seed, stored)?;
    let before = settings_from_store(&bench.read_store(Role::beam(0)), Role::beam(0)).0;
    bench.run_for(SAVED_MS);
    let after = settings_from_store(&bench.read_store(Role::beam(0)), Role::beam(0)).0;
    if TABLE.iter().all(|p| p.get(&before) == p.get(&after)) {
        return Ok(Err("nothing was saved".to_owned()));
    }
    let operations = bench.operations();
    let operations = operations
        .iter()
        .filter(|operation| operation.at > requested_at);
    let mut cases = 0;
    for (k, operation) in operations.enumerate() {
        for share in wanted(k, operation) {
            let at = operation.at + Time((operation.takes.0 as f64 * share) as u64);
            if let Err(why) = cut(campaign, seed, stored, at, [&before, &after])? {
                return Ok(Err(format!("operation {k}, {at}: {why}")));
            }
            cases += 1;
        }
    }
    Ok(match cases {
        0 => Err("nothing was written".to_owned()),
        _ => Ok(cases),
    })
}

/// Tests a power cut at `at`: afterwards each stored value must be the old or the new value.
fn cut(
    campaign: &Campaign,
    seed: u64,
    stored: Option<&[u8]>,
    at: Time,
    permitted: [&Settings; 2],
) -> Result<Result<(), String>, Error> {
    let (mut bench, _) = calibrating(campaign, seed, stored)?;
    while bench.now() + ms(1) <= at {
        bench.run_for(1);
    }
    bench.robot.network.run_until(at);
    bench.board(Role::beam(0), |board| board.power(false));
    bench.run_for(3);
    bench.robot.monitor = Monitor::new(bench.robot.topology);
    bench.start_board(Role::beam(0));
    let bytes = bench.read_store(Role::beam(0));
    let (found, report) = settings_from_store(&bytes, Role::beam(0));
    for parameter in &TABLE {
        let value = parameter.get(&found);
        if permitted
            .iter()
            .all(|settings| parameter.get(settings) != value)
        {
            return Ok(Err(format!("{} = {value}", parameter.name)));
        }
    }
    if report.defaults() > 0 {
        return Ok(Err(format!("{} values lost", report.defaults())));
    }
    let notices = bench.robot.monitor().noticed(Node::beam(0));
    let same = notices.contains(Condition::ParameterDefault) == report.unverified;
    Ok(match (bench.robot.monitor().latest(Node::beam(0)), same) {
        (None, _) => Err("the board did not start".to_owned()),
        (Some(_), false) => Err("the notice of a default does not match the store".to_owned()),
        (Some(_), true) => match bench.first_finding(Role::beam(0)) {
            Some(first_finding) => Err(first_finding),
            None => Ok(()),
        },
    })
}

/// Tests power cuts while a save writes words to the flash.
pub fn cuts_of_words(campaign: &Campaign, seed: u64) -> TrialResult {
    let every = if campaign.quick { 16 } else { 1 };
    cuts(campaign, seed, None, |k, operation| {
        let chosen = !operation.erases && k % every == 0;
        chosen
            .then_some(0.3 + 0.1 * (k % 7) as f64)
            .into_iter()
            .collect()
    })
}

/// Tests power cuts while a save into a full store erases a sector.
pub fn cuts_of_erases(campaign: &Campaign, seed: u64) -> TrialResult {
    let full = full_store(campaign, seed)?;
    let shares: &[f64] = match campaign.quick {
        true => &[0.5],
        false => &[0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.999],
    };
    cuts(
        campaign,
        seed,
        Some(&full),
        |_, operation| match operation.erases {
            true => shares.to_vec(),
            false => Vec::new(),
        },
    )
}

/// Store of a beam board that is full: the next save of the zeros erases a sector.
fn full_store(campaign: &Campaign, seed: u64) -> Result<Vec<u8>, Error> {
    let mut bytes = acknowledging_bench(campaign, seed)?.read_store(Role::beam(0));
    let base = Settings::of(BoardKind::Beam);
    let mut settings = settings_from_store(&bytes, Role::beam(0)).0;
    for round in 0..10_000 {
        for parameter in TABLE.iter().filter(|p| p.name.contains("zero_counts")) {
            let value = parameter.get(&settings) + [1.0, -1.0][round % 2];
            parameter.set(&mut settings, value)?;
        }
        let mut flash = Flash::<SECTOR>::new(3, 1);
        flash.bytes.copy_from_slice(&bytes);
        let range = flash.range();
        let off = Disarmed::when(true);
        let (Some(mut store), Some(off)) = (Store::new(flash, range), off) else {
            break;
        };
        run(store.save(&settings, &base, off))
            .map_err(|error| Error::Failure(format!("store: {error:?}")))?;
        let flash = store.into_flash();
        if flash.erases > 0 {
            return Ok(bytes);
        }
        bytes = flash.bytes;
    }
    Err(Error::Failure("store: never full".to_owned()))
}

/// Tests starts with one flipped bit in the store: every value must be unchanged or replaced by its default with a
/// notice, and nothing may be written.
pub fn flipped_bits(campaign: &Campaign, seed: u64) -> TrialResult {
    let cases = if campaign.quick { 4 } else { 40 };
    let mut random = generator(seed, 0, Stream::Other(0x301));
    for _ in 0..cases {
        let mut bench = acknowledging_bench(campaign, seed)?;
        let mut bytes = bench.read_store(Role::beam(0));
        let saved = settings_from_store(&bytes, Role::beam(0)).0;
        let used = bytes.iter().rposition(|&byte| byte != 0xff).unwrap_or(0) + 1;
        let bit: usize = random.random_range(0..8 * used);
        bytes[bit / 8] ^= 1 << (bit % 8);
        bench.write_store(Role::beam(0), &bytes);
        bench.start_board(Role::beam(0));
        let (found, _) = settings_from_store(&bytes, Role::beam(0));
        let notices = bench.robot.monitor().noticed(Node::beam(0));
        let same = TABLE.iter().all(|p| p.get(&found) == p.get(&saved));
        let unchanged = bench.read_store(Role::beam(0)) == bytes;
        let started = bench.robot.monitor().latest(Node::beam(0)).is_some();
        let has_notice = notices.contains(Condition::ParameterDefault);
        if !(started && unchanged && (same || has_notice)) {
            return Ok(Err(format!(
                "bit {bit}: heartbeat received {started}, flash unchanged {unchanged}, values unchanged {same}, default noticed {has_notice}"
            )));
        }
    }
    Ok(Ok(cases))
}
