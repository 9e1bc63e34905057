//! Hours of driving from goal to goal with all sensors and all noise: the health of the estimator
//! does not drift and memory does not grow. Not among the tests of every day:
//! `cargo test --release -p host-sim --test soak -- --ignored --nocapture`; `SOAK_TICKS` shortens it.

use core_algos::control::regulator::Phase;
use core_algos::fusion::ekf::Verdict;
use core_algos::math::Posture;
use core_algos::node::EPOCH;
use core_algos::node::lead::Task;
use host_sim::scenario::Scenario;
use host_sim::simulation::Simulation;
use host_sim::targets::Order;

const WINDOWS: u64 = 10;
/// Time for one goal, ms.
const PATIENCE: u64 = 60_000;

/// Resident memory of this process, KiB.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1));
    number
        .and_then(|text| text.parse().ok())
        .expect("a number of KiB")
}

#[derive(Clone, Copy, Debug, Default)]
struct Window {
    nis: f64,
    updates: u64,
    gated: u64,
    reached: u64,
    failed: u64,
    resident_kib: u64,
}

#[test]
#[ignore = "minutes long"]
fn health_does_not_drift_and_memory_does_not_grow() {
    let ticks = std::env::var("SOAK_TICKS").map_or(10_000_000, |text| text.parse().unwrap());
    let mut scenario = Scenario::default();
    scenario.sensors.gyro.fitted = true;
    scenario.sensors.accelerometer.fitted = true;
    scenario.bus.loss = 0.01;
    let mut simulation = Simulation::new(&scenario, 5, 0).unwrap();
    let mut windows = Vec::new();
    let mut window = Window::default();
    let (mut begun, mut goals) = (0u64, 0u32);
    println!("| tick | NIS of the beam | gated | goals reached | not reached | memory, KiB |");
    println!("|---|---|---|---|---|---|");
    for tick in 0..ticks {
        if tick == 500 || (tick > 500 && tick == begun) {
            goals += 1;
            // Somewhere in a square of 3 m, headed anywhere.
            let part = |k: f64| (f64::from(goals) * k).fract();
            let goal = Posture::new(
                (3.0 * part(0.618_034) - 1.5) as f32,
                (3.0 * part(0.414_214) - 1.5) as f32,
                (6.2 * part(0.732_051) - 3.1) as f32,
            );
            simulation
                .order(&Order::Task(Task::Regulate { goal }))
                .unwrap();
        }
        simulation.step().unwrap();
        if simulation.now().is_multiple_of(EPOCH) {
            let lead = *simulation.lead_output();
            let beam = lead.fused.beam;
            if matches!(beam.verdict, Verdict::Used | Verdict::Gated) {
                window.updates += 1;
                window.nis += f64::from(beam.nis);
                window.gated += u64::from(beam.verdict == Verdict::Gated);
            }
            let waited = tick.saturating_sub(begun) > 1000;
            let over = tick.saturating_sub(begun) > PATIENCE || lead.phase == Phase::GaveUp;
            if waited && (lead.done || over) {
                window.reached += u64::from(lead.done);
                window.failed += u64::from(!lead.done);
                begun = tick + 1;
            }
        }
        if (tick + 1).is_multiple_of(ticks / WINDOWS) {
            window.resident_kib = resident_kib();
            let updates = window.updates.max(1) as f64;
            println!(
                "| {} | {:.3} | {:.5} | {} | {} | {} |",
                tick + 1,
                window.nis / updates,
                window.gated as f64 / updates,
                window.reached,
                window.failed,
                window.resident_kib
            );
            windows.push(std::mem::take(&mut window));
        }
    }
    let nis = |window: &Window| window.nis / window.updates.max(1) as f64;
    let all = windows.iter().map(nis).sum::<f64>() / windows.len() as f64;
    let [.., before, last] = windows.as_slice() else {
        panic!("too few windows");
    };
    for window in &windows {
        assert!(window.updates > 0 && window.reached > 0, "{window:?}");
        assert!(
            nis(window) < 1.5 * all && nis(window) > 0.5 * all,
            "{window:?}"
        );
    }
    assert!(last.reached + before.reached > 0);
    // What is taken at the start is kept; nothing is added after the first window.
    assert!(last.resident_kib <= windows[0].resident_kib + 256);
}
