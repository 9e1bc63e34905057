//! Description of the simulation for a page: choices, names, dimensions, layout of the state.

use crate::faults;
use crate::live::Live;
use core_algos::bus::LeadMode;
use core_algos::control::regulator::Phase;
use core_algos::fusion::robot::Mode;
use core_algos::safety::OperatingState;
use core_algos::safety::condition::TABLE;
use core_algos::topology::{MAX_AXLES, Role};
use declare::{Declared, Kind};
use host_sim::base::error::Error;
use host_sim::run::end::EndKind;
use host_sim::run::path_run::bounds;
use host_sim::scenario::Scenario;
use host_sim::world::body::Body;
use host_sim::world::{self, NAMES};
use serde_json::{Value, json};

/// Phases of the regulator, in the order of their numbers.
const PHASES: [Phase; 8] = [
    Phase::Stop,
    Phase::Plan,
    Phase::Steer,
    Phase::Segment,
    Phase::Approach,
    Phase::Hold,
    Phase::Done,
    Phase::GaveUp,
];

/// First sentence of a world file.
fn summary(name: &str) -> Result<Value, Error> {
    let text = world::text(name)?;
    let lines = text.lines().map_while(|line| line.strip_prefix('#'));
    let text: String = lines.collect();
    let sentence = text.trim().split_inclusive(". ").next();
    Ok(json!({ "name": name, "text": sentence.unwrap_or_default().trim() }))
}

/// Description of a robot with a number of axles, in JSON.
pub fn json(axles: usize) -> Result<Value, Error> {
    let text = format!("[robot.geometry]\naxles = {axles}");
    let scenario = Scenario::parse(None, &text, "scenario", &[])?;
    let topology = scenario.robot.topology();
    let body = Body::of(&scenario.world.plant);
    let strip = &scenario.robot.beam.strip;
    let limits = bounds(&scenario);
    let mission = &scenario.mission;
    let worlds: Result<Vec<Value>, Error> = NAMES.iter().map(|name| summary(name)).collect();
    let fusions = match Mode::KIND {
        Kind::Choice(choices) => choices,
        _ => &[],
    };
    let fusion =
        |choice: &declare::Choice| json!({ "name": choice.name, "text": choice.meaning() });
    let code = |entry: &core_algos::safety::condition::Entry| {
        let class = entry.condition.class().name();
        json!({
            "code": entry.code, "name": entry.name, "class": class,
            "meaning": entry.meaning, "remedy": entry.remedy,
        })
    };
    let fault = |fault: faults::Entry| json!({ "name": fault.name, "text": fault.text });
    let mut state = Vec::new();
    let robot = Live::new(scenario.clone(), 1, 0)?;
    robot.visit(&mut |name, values| state.push(json!([name, values.len()])));
    Ok(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "worlds": worlds?,
        "fusions": fusions.iter().map(fusion).collect::<Vec<_>>(),
        "codes": TABLE.iter().map(code).collect::<Vec<_>>(),
        "faults": faults::of(topology).into_iter().map(fault).collect::<Vec<_>>(),
        "ends": EndKind::ALL.map(EndKind::name),
        "modes": LeadMode::NAMES,
        "states": OperatingState::NAMES,
        "nodes": topology.nodes().map(|node| topology.node_name(node)).collect::<Vec<_>>(),
        "axles": topology.axles().map(|axle| topology.name(Role::Axle(axle))).collect::<Vec<_>>(),
        "most_axles": MAX_AXLES,
        "beams": topology.frames().map(|frame| topology.name(Role::Beam(frame))).collect::<Vec<_>>(),
        "body": {
            "half_track": body.half_track_m,
            "wheel_radius": body.wheel_radius_m,
            "wheel_width": body.wheel_width_m,
        },
        "gauges_m": strip.gauges_m.iter().collect::<Vec<_>>(),
        "strip_m": strip.length_m,
        "rigid_m": scenario.robot.geometry.rigid_end_m,
        "world": scenario.world.name,
        "fusion": scenario.fusion(),
        "phases": PHASES.map(|phase| format!("{phase:?}").to_lowercase()),
        "mission": {
            "start": mission.start, "goal": mission.goal,
            "tolerance": [mission.tolerance_m, mission.tolerance_rad],
        },
        "limits": {
            "speed": scenario.robot.limits.max_speed_m_s,
            "curvature": limits.max_curvature(),
            "friction": crate::live::FRICTION,
        },
        "friction": scenario.world.plant.friction,
        "state": state,
    }))
}
