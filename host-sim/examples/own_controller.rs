//! Posture regulation with a user-written kinematic controller: the law in polar coordinates of Aicardi et al. (1995).
//! `firmware-axle/examples/own_controller.rs` is a board image with the same law.

#[path = "../../firmware-axle/examples/law/mod.rs"]
mod law;

use host_sim::base::error::Error;
use host_sim::run::regulate::regulate_on;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets::InProcess;

fn main() -> Result<(), Error> {
    let scenario = Scenario::default();
    for seed in 1..=5 {
        let robot = scenario.robot.topology();
        let board = |role| Box::new(InProcess::with_controller(robot, role, &law::Polar)) as _;
        let boards = robot.boards().map(board).collect();
        let mut robot = Simulation::on(boards, &scenario, seed, 0)?;
        let outcome = regulate_on(&mut robot, &scenario, |_| ())?;
        let [x, y, phi] = outcome.midpoint.map(|value| 100.0 * value);
        println!(
            "seed {seed}: {}, {x:.1} cm, {y:.1} cm, {phi:.1} crad",
            outcome.end.text()
        );
    }
    Ok(())
}
