//! Run with a fault, and its verdict.

use super::Campaign;
use super::bench::FaultBench;
use super::entry::{Entry, RunKind, TimedAct};
use super::model;
use super::outcome::{End, FaultCase, Outcome, stop_violation};
use super::shared_robots::{SharedRobots, stores};
use crate::virtual_robot::Options;
use core_algos::safety::{Condition, OperatingState};
use core_algos::topology::{Node, Role};
use host_sim::base::error::Error;
use host_sim::run::robot::Robot;
use virtual_board::Time;
use virtual_board::device::Drv8874;
use virtual_board::wire::ErrorKind;

/// Current above which a motor counts as driven, A; it gives 25 mN m at the wheel.
const CURRENT_A: f64 = 0.05;
/// Time for which a continuing robot is observed, ms.
const OBSERVATION_MS: u64 = 1_000;
/// Limit of the distance between a continuing robot and its position in the undisturbed run, m.
const MAX_DEVIATION_M: f64 = 0.02;
/// Time within which all nodes must be ready after the last act, ms.
const READY_MS: u64 = 1_500;
/// Time for which all nodes must stay ready, ms.
const READY_HOLD_MS: u64 = 100;
/// Time that a started robot drives, ms.
const DRIVE_MS: u64 = 400;
/// Postures of the robot without a fault, by ms since the start.
pub type Reference = Vec<[f64; 3]>;

/// Postures of an undisturbed run, long enough for every case.
pub fn reference(campaign: &Campaign, seed: u64, longest_ms: u64) -> Result<Reference, Error> {
    let mut bench = FaultBench::new(campaign, Options::default(), seed)?;
    bench.robot.boot(&Options::default())?;
    bench.begin_drive();
    let ticks = longest_ms + OBSERVATION_MS + 1_000;
    Ok((0..ticks)
        .map(|_| {
            bench.robot.advance();
            bench.robot.plant.midpoint()
        })
        .collect())
}

/// Runs a case; `robots` are the shared robots of all cases.
pub fn run(
    campaign: &Campaign,
    case: &FaultCase,
    reference: &Reference,
    robots: &SharedRobots,
) -> Result<Outcome, Error> {
    match &case.entry.kind {
        RunKind::BoardTrial(trial) => {
            let (end, cases) = match trial(campaign, case.seed)? {
                Ok(cases) => (End::WentOn, cases),
                Err(why) => (End::Wrong(why), 1),
            };
            Ok(Outcome {
                seed: case.seed,
                after_ms: 0,
                end,
                reason: None,
                off_s: None,
                own_off_s: None,
                cases,
            })
        }
        RunKind::Drive(steps) => {
            let (mut bench, before) = robots.get(campaign, case)?;
            let observed = run_until_clear(&mut bench, case.entry, steps);
            Ok(outcome_of(bench, case, observed, reference, &before))
        }
        RunKind::Start(steps) => start(campaign, case, steps),
        RunKind::Model(fault) => model::run(campaign, case, fault.clone()),
    }
}

#[derive(Clone, Debug)]
struct MotorObservation {
    /// Time of the start of the fault.
    from: Time,
    /// Latest time at which a motor of each axle carried current.
    last: Vec<Time>,
    /// True if a motor carried current at the end of the run.
    driven: bool,
}

/// Performs the acts at their times and runs until the effects of the fault are clear, at most until the fault's time
/// limit.
fn run_until_clear(bench: &mut FaultBench, entry: &Entry, steps: &[TimedAct]) -> MotorObservation {
    let from = bench.now();
    let mut observed = MotorObservation {
        from,
        last: bench.robot.topology.axles().map(|_| from).collect(),
        driven: true,
    };
    let longest = steps.iter().map(|step| step.after_ms).max().unwrap_or(0);
    let limit = longest + (entry.off_within_s * 1e3) as u64 + entry.rest_ms + 500;
    for elapsed in 0..=limit {
        for step in steps.iter().filter(|step| step.after_ms == elapsed) {
            (step.act)(bench);
        }
        bench.run_for(1);
        let now = bench.now();
        let axles = bench.robot.topology.axles();
        for (axle, last) in axles.zip(&mut observed.last) {
            if let Some(axle) = bench.robot.axle(Role::Axle(axle))
                && axle
                    .driven_currents(now)
                    .iter()
                    .any(|a| a.abs() > CURRENT_A)
            {
                *last = now;
            }
        }
        if elapsed < longest {
            continue;
        }
        let rest = Time::from_micros(1000 * entry.rest_ms);
        observed.driven = observed.last.iter().any(|last| now - *last < rest);
        let restarted = !entry.restarts || has_restarted(bench);
        let faulty = stopped(bench).is_some();
        let since = elapsed - longest;
        let off = !observed.driven && since >= entry.rest_ms;
        let on = observed.driven && !faulty && since >= OBSERVATION_MS && entry.goes_on;
        if restarted && (off || on) {
            break;
        }
    }
    observed
}

/// First reason with which an axle or lead node went to safe stop or fault; `None` without a stop.
fn stopped(bench: &FaultBench) -> Option<Condition> {
    let changes = bench.robot.monitor().changes().iter();
    let mut stops = changes.filter(|status| {
        let stopped = matches!(
            status.state,
            OperatingState::SafeStop | OperatingState::Fault
        );
        stopped && !matches!(status.node, Node::Beam(_))
    });
    stops.find_map(|status| status.reason)
}

/// Axle or beam node of a board.
pub fn node(role: Role) -> Node {
    match role {
        Role::Axle(axle) => Node::Axle(axle),
        Role::Beam(frame) => Node::Beam(frame),
    }
}

/// True if the latest status of the affected board has the reason *restarted*.
fn has_restarted(bench: &mut FaultBench) -> bool {
    let Some(role) = bench.affected else {
        return false;
    };
    let latest = bench.robot.monitor().latest(node(role)).copied();
    latest.is_some_and(|status| status.reason == Some(Condition::Restarted))
}

/// First violation that does not depend on how the run ends: a wrong reset, a finding, changed parameters, a missing
/// notice, a failed check; `None` without one.
fn violation(bench: &mut FaultBench, entry: &Entry, before: &[Vec<u8>]) -> Option<String> {
    let reports = bench.robot.reports();
    for (role, report) in bench.robot.roles.iter().copied().zip(reports) {
        let name = report.name;
        let is_affected = bench.affected == Some(role);
        if entry.must_reset && is_affected && report.resets.is_empty() {
            return Some(format!("{name} board not reset"));
        }
        let may_reset = (entry.resets)(role);
        if let (Some((time_s, cause)), false) = (report.resets.first(), may_reset) {
            return Some(format!("{name} board reset by {cause} at {time_s:.3} s"));
        }
        let own = |text: &str| entry.findings.iter().any(|part| text.contains(part));
        let finding = report
            .findings
            .iter()
            .find(|finding| !own(&format!("{}: {}", finding.kind, finding.text)));
        if let Some(finding) = finding {
            return Some(format!(
                "{name} board: {}: {}, in {}",
                finding.kind, finding.text, finding.place
            ));
        }
    }
    if stores(bench) != before {
        return Some("parameters in the flash have changed".to_owned());
    }
    if let Some(condition) = entry.notice {
        let role = bench.affected.unwrap_or(Role::LEAD);
        if !bench
            .robot
            .monitor()
            .noticed(node(role))
            .contains(condition)
        {
            return Some(format!("no notice of {}", condition.entry().name));
        }
    }
    if !entry.fast_ppb.is_empty()
        && let Some(bus_errors) = bus_errors(bench)
    {
        return Some(bus_errors);
    }
    let observed = bench.violation.take();
    if let Some(wrong) = observed.or_else(|| entry.check.and_then(|check| check(bench))) {
        return Some(wrong);
    }
    (entry.restarts && !has_restarted(bench)).then(|| "the restart was not reported".to_owned())
}

/// End of the last PWM pulse of the affected axle; `None` if no axle is affected.
fn last_pulse(bench: &mut FaultBench) -> Option<Time> {
    let axle = bench.robot.axle(bench.affected?)?;
    axle.drivers.iter().map(Drv8874::driven_until).max()
}

/// First board with bus errors, and their number. Missing acknowledgements do not count: they are normal while other
/// boards start.
fn bus_errors(bench: &mut FaultBench) -> Option<String> {
    let mut boards = bench.robot.topology.boards();
    let of_board = |role| {
        let place = bench.robot.place(role)?;
        let statistics = bench.robot.network.wire().statistics(place);
        let kind = ErrorKind::ALL.into_iter().find(|&kind| {
            !matches!(kind, ErrorKind::Acknowledgement) && statistics.errors_of(kind) > 0
        })?;
        let count = statistics.errors_of(kind);
        Some(format!(
            "{} board: {count} errors: {}",
            bench.robot.topology.name(role),
            kind.name()
        ))
    };
    boards.find_map(of_board)
}

fn outcome_of(
    mut bench: FaultBench,
    case: &FaultCase,
    observed: MotorObservation,
    reference: &Reference,
    before: &[Vec<u8>],
) -> Outcome {
    let entry = case.entry;
    let first = bench.robot.monitor().first_fault().copied();
    let reason = first.and_then(|status| status.reason);
    let off = |last: Time| (last - observed.from).seconds();
    let off_s = (!observed.driven)
        .then(|| off(observed.last.iter().copied().fold(observed.from, Time::max)));
    let last = last_pulse(&mut bench).filter(|_| !observed.driven);
    let own_off_s = last.map(off);
    let wrong = violation(&mut bench, entry, before).or_else(|| match off_s {
        Some(off_s) => stop_violation(entry, reason, off_s, own_off_s),
        None => drive_violation(&bench, case, observed.from, reference),
    });
    let end = match wrong {
        Some(why) => End::Wrong(why),
        None if observed.driven => End::WentOn,
        None => End::Stopped,
    };
    Outcome {
        seed: case.seed,
        after_ms: case.after_ms,
        end,
        reason,
        off_s,
        own_off_s,
        cases: 1,
    }
}

fn drive_violation(
    bench: &FaultBench,
    case: &FaultCase,
    from: Time,
    reference: &Reference,
) -> Option<String> {
    let reason = stopped(bench);
    if !case.entry.goes_on || reason.is_some() {
        return Some(format!("motors on at the end: {reason:?}"));
    }
    let axles = bench.robot.topology.axles().map(Node::Axle);
    for node in std::iter::once(Node::Lead).chain(axles) {
        let state = bench
            .robot
            .monitor()
            .latest(node)
            .map(|status| status.state);
        if state != Some(OperatingState::Active) {
            return Some(format!(
                "{} at the end: {state:?}",
                bench.robot.topology.node_name(node)
            ));
        }
    }
    let index = case.after_ms + (bench.now() - from).micros() / 1000;
    let expected = reference.get(index as usize - 1)?;
    let midpoint = bench.robot.plant.midpoint();
    let away = libm::hypot(midpoint[0] - expected[0], midpoint[1] - expected[1]);
    (away > MAX_DEVIATION_M)
        .then(|| format!("midpoint {:.1} cm from the undisturbed run", 1e2 * away))
}

/// Runs a case from power-on.
fn start(campaign: &Campaign, case: &FaultCase, steps: &[TimedAct]) -> Result<Outcome, Error> {
    let entry = case.entry;
    let options = entry.options();
    let mut bench = FaultBench::new(campaign, options.clone(), case.seed)?;
    let before = stores(&mut bench);
    let acts = steps.iter().map(|step| step.after_ms);
    let late = entry.late_ms.iter().map(|(_, ms)| *ms);
    let last = acts.chain(late).max().unwrap_or(0);
    let mut ready = 0;
    for elapsed in 0..last + READY_MS {
        bench.robot.power_up(&options);
        for step in steps.iter().filter(|step| step.after_ms == elapsed) {
            (step.act)(&mut bench);
        }
        bench.run_for(1);
        let waits = bench.robot.waits_for().is_some();
        ready = if waits { 0 } else { ready + 1 };
        if ready >= READY_HOLD_MS && elapsed >= last {
            break;
        }
    }
    let waits = bench.robot.waits_for();
    bench.press();
    bench.run_for(DRIVE_MS / 2);
    let mut driven = false;
    for _ in 0..DRIVE_MS / 2 {
        bench.run_for(1);
        let now = bench.now();
        for axle in bench.robot.topology.axles() {
            let axle = bench.robot.axle(Role::Axle(axle));
            driven |= axle.is_some_and(|axle| {
                axle.driven_currents(now)
                    .iter()
                    .any(|a| a.abs() > CURRENT_A)
            });
        }
    }
    let reason = stopped(&bench);
    let wrong = violation(&mut bench, entry, &before).or_else(|| match (entry.goes_on, waits) {
        (true, Some(why)) if !entry.unready => Some(format!("not ready: {why}")),
        (true, _) if !driven || reason.is_some() => Some(format!("does not drive: {reason:?}")),
        (false, None) => Some("ready in spite of the fault".to_owned()),
        (false, Some(_)) if driven => Some("motors on".to_owned()),
        _ => None,
    });
    let end = match wrong {
        Some(why) => End::Wrong(why),
        None if driven => End::WentOn,
        None => End::Stopped,
    };
    Ok(Outcome {
        seed: case.seed,
        after_ms: 0,
        end,
        reason,
        off_s: (!driven).then_some(0.0),
        own_off_s: None,
        cases: 1,
    })
}
