//! A robot that a visitor drives: commands, faults and changed settings between the ticks.

use crate::drawn_path;
use crate::faults;
use core_algos::bus::LeadMode;
use core_algos::fusion::ekf::Verdict;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::safety::{Condition, Permit};
use core_algos::time::{EPOCH, Micros, TICK};
use host_sim::base::error::{Error, Refusal};
use host_sim::run::path_run::{PathMode, Route, Stream};
use host_sim::run::robot::{Record, Robot, estimated_axles};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets::{self, HostCommand};
use host_sim::world::drawn::Drawn;

/// Time with the motors off in which the frame relaxes.
const RELAX: Micros = 500_000;
/// Coordinates of goals and of the robot, m and rad.
const COORDINATES: [f64; 2] = [-50.0, 50.0];
/// Speeds, m/s, and curvatures, 1/m, of driving by hand; the governor limits them further.
const SPEEDS: [f64; 2] = [-10.0, 10.0];
const CURVATURES: [f64; 2] = [-100.0, 100.0];
/// Friction coefficients of the floor that a visitor may set.
pub const FRICTION: [f64; 2] = [0.02, 2.0];
/// Largest change of the gauges' zeros at once, strain.
const MAX_DRIFT: f64 = 1e-3;

/// Robot in progress.
pub struct Live {
    scenario: Scenario,
    seed: u64,
    trial: u64,
    robot: Simulation,
    /// Time before the present simulation began, s.
    before_s: f64,
    /// Number of times that a person has placed the robot.
    placements: u64,
    /// Task that waits until the robot has settled and the points of its path are sent.
    pending: Option<Task>,
    /// Points of the path that are not yet sent.
    stream: Option<Stream>,
    /// Drawn path that begins once the robot rests with its frame relaxed, and the time of that rest, µs.
    drawn: Option<(Vec<[f64; 2]>, Option<Micros>)>,
    /// Points of the latest planned path, or the reason of a refusal.
    planned: Result<Vec<[f64; 2]>, Error>,
    /// Number of changes of `planned`.
    plans: u32,
    /// First tick that no loss or reset of a board has.
    free_tick: u32,
}

/// Error that names the field, the value and the allowed range.
fn refused(field: &str, value: f64, [least, most]: [f64; 2]) -> Error {
    Error::from(Refusal {
        field: field.to_owned(),
        value: value.to_string(),
        allowed: format!("a number from {least} to {most}"),
    })
}

fn check(field: &str, value: f64, range: [f64; 2]) -> Result<(), Error> {
    match (range[0]..=range[1]).contains(&value) {
        true => Ok(()),
        false => Err(refused(field, value, range)),
    }
}

fn check_posture(posture: [f64; 3]) -> Result<(), Error> {
    let mut fields = ["x", "y", "phi"].into_iter().zip(posture);
    fields.try_for_each(|(field, value)| check(field, value, COORDINATES))
}

/// Robot of drawn errors at the start of a scenario.
fn simulation(
    scenario: &Scenario,
    drawn: &Drawn,
    seed: u64,
    trial: u64,
) -> Result<Simulation, Error> {
    let boards = targets::in_process_with(scenario.robot.topology(), &scenario.own);
    Simulation::with(boards, scenario, drawn, seed, trial)
}

/// Points of a route, m.
fn points(route: &Route) -> Vec<[f64; 2]> {
    let samples = route.path().samples().iter();
    samples.map(|sample| [sample.x, sample.y]).collect()
}

/// True if the lead node has an estimate; without reports of an axle it has none.
fn is_valid(record: &Record) -> bool {
    record.lead.fused.robot.covariance[0][0] > 0.0
}

impl Live {
    /// Robot at rest at the start of the scenario.
    pub fn new(scenario: Scenario, seed: u64, trial: u64) -> Result<Self, Error> {
        let drawn = scenario.world.draw(scenario.robot.topology(), seed, trial);
        Ok(Self {
            robot: simulation(&scenario, &drawn, seed, trial)?,
            scenario,
            seed,
            trial,
            before_s: 0.0,
            placements: 0,
            pending: None,
            stream: None,
            drawn: None,
            planned: Ok(Vec::new()),
            plans: 0,
            free_tick: 0,
        })
    }

    /// Replaces the settings. True posture, estimate and its standard deviations stay; frame and motors are at rest.
    pub fn change(&mut self, scenario: Scenario) -> Result<(), Error> {
        let record = self.robot.record();
        let truth = record.midpoint;
        let estimate = &record.lead.fused.robot;
        let drawn = scenario
            .world
            .draw(scenario.robot.topology(), self.seed, self.trial);
        let covariance = estimate.covariance.map(|row| row.map(f64::from));
        let mut carried = scenario.clone();
        let mut errors = drawn;
        if is_valid(&record) {
            let at = estimate.posture;
            carried.mission.start = [at.x, at.y, at.phi].map(f64::from);
            carried.mission.placement_m = covariance[0][0].max(covariance[1][1]).sqrt();
            carried.mission.placement_rad = covariance[2][2].sqrt();
            errors.placement = std::array::from_fn(|i| truth[i] - carried.mission.start[i]);
        } else {
            carried.mission.start = truth;
        }
        self.begin(scenario, &carried, &errors)
    }

    /// Lifts the robot and places it at a posture, with a new placement error of the world.
    pub fn place(&mut self, posture: [f64; 3]) -> Result<(), Error> {
        check_posture(posture)?;
        self.placements += 1;
        let topology = self.scenario.robot.topology();
        let world = &self.scenario.world;
        let mut drawn = world.draw(topology, self.seed, self.trial);
        let other = world.draw(
            topology,
            self.seed,
            self.trial.wrapping_add(self.placements << 32),
        );
        drawn.placement = other.placement;
        let mut placed = self.scenario.clone();
        placed.mission.start = posture;
        self.begin(self.scenario.clone(), &placed, &drawn)
    }

    /// Continues with a new simulation of `started`; `scenario` has the mission as the user wrote it.
    fn begin(
        &mut self,
        scenario: Scenario,
        started: &Scenario,
        drawn: &Drawn,
    ) -> Result<(), Error> {
        let robot = simulation(started, drawn, self.seed, self.trial)?;
        self.before_s = self.time_s();
        (self.robot, self.scenario) = (robot, scenario);
        (self.pending, self.stream, self.drawn) = (None, None, None);
        self.free_tick = 0;
        Ok(())
    }

    /// Time since the robot was created, s.
    fn time_s(&self) -> f64 {
        self.before_s + self.robot.now() as f64 * 1e-6
    }

    fn tick(&self) -> u32 {
        (self.robot.now() / TICK) as u32
    }

    /// Advances by 1 ms.
    pub fn step(&mut self) -> Result<(), Error> {
        let now = self.robot.now();
        if now.is_multiple_of(EPOCH) {
            self.begin_path();
            if let Some(stream) = &mut self.stream
                && let Some(points) = stream.next(self.robot.room())
            {
                self.robot.command(&points)?;
            }
            let settled = now as f64 * 1e-6 >= self.scenario.mission.settle_s;
            if settled && let Some(task) = self.pending.take() {
                self.command(task)?;
            }
        }
        self.robot.step()
    }

    fn command(&mut self, task: Task) -> Result<(), Error> {
        self.robot.monitor_mut().begin_task();
        self.robot.command(&HostCommand::Task(task))
    }

    /// Gives a task at the next epoch after the robot has settled, and forgets the path.
    fn give(&mut self, task: Task) {
        (self.stream, self.drawn) = (None, None);
        self.pending = Some(task);
    }

    /// Begins the drawn path once the robot rests. A frame held bent cannot begin a path that is straight, so the
    /// motors are switched off for a moment.
    fn begin_path(&mut self) {
        let Some((drawn, rest)) = &mut self.drawn else {
            return;
        };
        let now = self.robot.now();
        let lead = self.robot.lead_output();
        match *rest {
            None if self.pending.is_some() => {}
            None if lead.supervision.state.permit() == Permit::Off => *rest = Some(now),
            None if lead.mode == LeadMode::Hold && lead.done => self.pending = Some(Task::Idle),
            Some(since) if now >= since + RELAX => {
                let drawn = std::mem::take(drawn);
                self.drawn = None;
                self.plans += 1;
                self.planned = self.start_path(&drawn);
            }
            _ => {}
        }
    }

    /// Sends the robot along a drawn path; gives the points of the planned path.
    fn start_path(&mut self, drawn: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, Error> {
        let route = self.route(drawn)?;
        self.stream = Some(Stream::new(&route, PathMode::Follow));
        self.pending = Some(Task::Follow {
            within: self.scenario.mission.within(),
        });
        Ok(points(&route))
    }

    /// Path from the estimated posture through drawn points.
    fn route(&self, drawn: &[[f64; 2]]) -> Result<Route, Error> {
        let fused = &self.robot.lead_output().fused;
        let midpoint = fused.robot.posture;
        let at = match self.scenario.robot.topology().frame_count() {
            1 => midpoint,
            _ => fused.front.posture,
        };
        drawn_path::route(
            [at.x, at.y, at.phi].map(f64::from),
            [midpoint.x, midpoint.y].map(f64::from),
            drawn,
            &self.scenario,
        )
    }

    /// Drives to a goal.
    pub fn regulate(&mut self, goal: [f64; 3]) -> Result<(), Error> {
        check_posture(goal)?;
        self.give(self.scenario.mission.regulate(goal));
        Ok(())
    }

    /// Brakes and holds.
    pub fn halt(&mut self) {
        self.give(Task::Stop);
    }

    /// Clears latched faults of the boards whose causes are gone.
    pub fn clear(&mut self) {
        self.give(Task::Clear);
    }

    /// Drives by hand until 200 ms after the latest call.
    pub fn speed(&mut self, speed_m_s: f64, curvature: f64) -> Result<(), Error> {
        check("speed", speed_m_s, SPEEDS)?;
        check("curvature", curvature, CURVATURES)?;
        let task = Task::Drive {
            speed_m_s: speed_m_s as f32,
            curvature: curvature as f32,
        };
        self.give(task);
        Ok(())
    }

    /// Follows a drawn path from the robot's estimated posture, after the robot has come to rest. Refuses a path that
    /// the robot cannot follow from its present posture.
    pub fn follow(&mut self, drawn: &[[f64; 2]]) -> Result<(), Error> {
        self.planned = Ok(points(&self.route(drawn)?));
        self.plans += 1;
        let rests = self.robot.lead_output().mode == LeadMode::Idle;
        self.give(if rests { Task::Idle } else { Task::Stop });
        self.drawn = Some((drawn.to_vec(), None));
        Ok(())
    }

    /// Points of the latest planned path, or the reason why the robot could not begin the path at its rest.
    pub fn planned(&self) -> Result<&[[f64; 2]], Error> {
        self.planned.as_deref().map_err(Clone::clone)
    }

    /// Injects a fault beside those present.
    pub fn fault(&mut self, number: usize) -> Result<(), Error> {
        let mut all = faults::of(self.scenario.robot.topology());
        if number >= all.len() {
            return Err(refused(
                "fault",
                number as f64,
                [0.0, all.len() as f64 - 1.0],
            ));
        }
        let fault = all.swap_remove(number).fault;
        let tick = self.free_tick.max(self.tick());
        self.free_tick = tick + 1;
        self.robot.inject(fault, tick);
        Ok(())
    }

    /// Sets the friction coefficient of the floor.
    pub fn friction(&mut self, friction: f64) -> Result<(), Error> {
        check("friction", friction, FRICTION)?;
        self.robot.set_friction(friction);
        Ok(())
    }

    /// Adds a strain to the zeros of all gauges.
    pub fn drift_gauges(&mut self, strain: f64) -> Result<(), Error> {
        check("strain", strain, [-MAX_DRIFT, MAX_DRIFT])?;
        self.robot.drift_gauges(strain);
        Ok(())
    }

    /// Passes each value of the state by name; the declaration of the state's layout.
    pub fn visit(&self, put: &mut dyn FnMut(&'static str, &[f64])) {
        let record = self.robot.record();
        let lead = &record.lead;
        let fused = &lead.fused;
        let posture = |p: Posture| [p.x, p.y, p.phi].map(f64::from);
        let code = |condition: Option<Condition>| condition.map_or(0.0, |it| it.code().into());
        put("time_s", &[self.time_s()]);
        put("truth", &record.midpoint);
        put("estimate", &posture(fused.robot.posture));
        let p = fused.robot.covariance.map(|row| row.map(f64::from));
        put("covariance", &[p[0][0], p[0][1], p[1][1], p[2][2]]);
        put("valid", &[f64::from(u8::from(is_valid(&record)))]);
        let axles = record.axles.iter();
        put(
            "axles",
            &axles
                .clone()
                .flat_map(|axle| axle.posture)
                .collect::<Vec<_>>(),
        );
        let mut estimated: Vec<f64> = estimated_axles(lead).flat_map(posture).collect();
        let count = 3 * record.axles.len();
        // Before the first estimate of each axle, no axle is known.
        if estimated.len() != count {
            estimated = vec![f64::NAN; count];
        }
        put("estimated_axles", &estimated);
        let points = record.frames.iter().rev().flat_map(|frame| frame.points);
        put(
            "frame",
            &points
                .flat_map(|point| point.map(f64::from))
                .collect::<Vec<_>>(),
        );
        let strains = record
            .frames
            .iter()
            .flat_map(|frame| frame.strain.map(f64::from));
        put("strain", &strains.collect::<Vec<_>>());
        put(
            "torque",
            &axles.flat_map(|axle| axle.torque).collect::<Vec<_>>(),
        );
        put("speed", &[self.robot.speed()]);
        put("command", &[lead.motion.v.into(), lead.motion.psi.0.into()]);
        let unknown = fused.beam.verdict == Verdict::Absent;
        let known = |value: f32| if unknown { f64::NAN } else { value.into() };
        put("innovation", &fused.beam.innovation.map(known));
        put("nis", &[known(fused.beam.nis)]);
        put("mode", &[lead.mode as u8 as f64]);
        put("phase", &[lead.phase as u8 as f64]);
        put("target", &lead.target.map_or([f64::NAN; 3], posture));
        put("plans", &[self.plans.into()]);
        put("done", &[f64::from(u8::from(lead.done))]);
        put("failed", &[code(lead.failed)]);
        let monitor = self.robot.monitor();
        let nodes = monitor.topology.nodes().map(|node| monitor.latest(node));
        let reasons = nodes
            .clone()
            .map(|status| code(status.and_then(|it| it.reason)));
        put("reasons", &reasons.collect::<Vec<_>>());
        let states = nodes.map(|status| status.map_or(f64::NAN, |it| it.state as u8 as f64));
        put("states", &states.collect::<Vec<_>>());
        let notices = monitor.notices();
        let noticed = Condition::ALL.map(|it| f64::from(u8::from(notices.contains(it))));
        put("notices", &noticed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::topology::Topology;

    fn robot(text: &str) -> Live {
        let scenario = Scenario::parse(None, text, "scenario", &[]).unwrap();
        Live::new(scenario, 3, 0).unwrap()
    }

    fn run(robot: &mut Live, seconds: f64) {
        for _ in 0..(seconds * 1e3) as u32 {
            robot.step().unwrap();
        }
    }

    fn state(robot: &Live, name: &str) -> Vec<f64> {
        let mut found = Vec::new();
        robot.visit(&mut |it, values| {
            if it == name {
                found.extend(values);
            }
        });
        assert!(!found.is_empty(), "{name}");
        found
    }

    fn distance(a: &[f64], b: &[f64]) -> f64 {
        libm::hypot(a[0] - b[0], a[1] - b[1])
    }

    #[test]
    fn goals_follow_each_other_and_a_reached_goal_is_reported() {
        let mut robot = robot("");
        for goal in [[0.0; 3], [0.6, 0.3, 0.5]] {
            robot.regulate(goal).unwrap();
            run(&mut robot, 30.0);
            assert_eq!(state(&robot, "done"), [1.0]);
            assert!(distance(&state(&robot, "truth"), &goal) < 0.1);
        }
    }

    #[test]
    fn changed_settings_keep_truth_estimate_uncertainty_and_time() {
        let mut robot = robot("");
        robot.regulate([0.0; 3]).unwrap();
        run(&mut robot, 30.0);
        let names = ["truth", "estimate", "time_s"];
        let before = names.map(|name| state(&robot, name));
        let spread = state(&robot, "covariance");
        let without = Scenario::parse(None, "[mission]\nrps = false", "scenario", &[]).unwrap();
        robot.change(without).unwrap();
        assert_eq!(state(&robot, "time_s"), before[2]);
        run(&mut robot, 1.0);
        for (name, before) in names.iter().zip(&before).take(2) {
            let after = state(&robot, name);
            assert!(
                distance(&after, before) < 1e-4,
                "{name}: {after:?} {before:?}"
            );
            assert!((after[2] - before[2]).abs() < 1e-3, "{name}");
        }
        let kept = state(&robot, "covariance");
        assert!(
            kept[0] >= 0.9 * spread[0] && kept[2] >= 0.9 * spread[2],
            "{kept:?} {spread:?}"
        );
        // Without gauges the angle between the axles is known less well.
        assert!(
            kept[3] >= 0.9 * spread[3] && kept[3] < 3.0 * spread[3],
            "{kept:?} {spread:?}"
        );
    }

    #[test]
    fn placed_robot_believes_the_posture_and_stands_elsewhere() {
        let mut robot = robot("");
        let goal = [0.5, -0.5, 1.0];
        let mut errors = Vec::new();
        for _ in 0..2 {
            robot.place(goal).unwrap();
            run(&mut robot, 0.5);
            assert!(distance(&state(&robot, "estimate"), &goal) < 1e-3);
            errors.push(distance(&state(&robot, "truth"), &goal));
        }
        assert!(
            errors.iter().all(|&error| error > 1e-5 && error < 0.03),
            "{errors:?}"
        );
        assert_ne!(errors[0], errors[1]);
    }

    /// The second path is given while the robot drives the first, with its frame bent.
    #[test]
    fn drawn_path_replaces_the_path_that_the_robot_follows() {
        let mut robot = robot("");
        run(&mut robot, 0.6);
        let line = |from: [f64; 2], turn: f64| -> Vec<[f64; 2]> {
            let along = (1..40).map(|k| 0.05 * f64::from(k));
            along
                .map(|s| [from[0] + s * libm::cos(turn), from[1] + s * libm::sin(turn)])
                .collect()
        };
        let start = state(&robot, "truth");
        robot.follow(&line([start[0], start[1]], 1.0)).unwrap();
        run(&mut robot, 4.0);
        assert!(state(&robot, "speed")[0] > 0.1);
        let at = state(&robot, "truth");
        robot.follow(&line([at[0], at[1]], 0.0)).unwrap();
        run(&mut robot, 25.0);
        assert_eq!(state(&robot, "done"), [1.0]);
        assert_eq!(state(&robot, "plans"), [4.0]);
        let end = *robot.planned().unwrap().last().unwrap();
        assert!(distance(&state(&robot, "truth"), &end) < 0.1);
        assert!(distance(&end, &[at[0] + 1.95, at[1]]) < 0.06, "{end:?}");
    }

    #[test]
    fn several_faults_act_together() {
        let mut robot = robot("");
        robot.regulate([0.0; 3]).unwrap();
        run(&mut robot, 3.0);
        let faults = faults::of(Topology::PAIR);
        let number = |name: &str| faults.iter().position(|fault| fault.name == name).unwrap();
        for name in ["gauge wire breaks", "beam board off", "rear board off"] {
            robot.fault(number(name)).unwrap();
        }
        run(&mut robot, 2.0);
        let noticed = state(&robot, "notices");
        let has = |condition: Condition| {
            let all = Condition::ALL.iter();
            all.zip(&noticed)
                .any(|(&it, &set)| it == condition && set == 1.0)
        };
        assert!(has(Condition::BeamLost));
        assert_eq!(state(&robot, "valid"), [0.0], "no report of the rear axle");
        assert_eq!(
            state(&robot, "reasons")[0],
            f64::from(Condition::NeighbourLost.code())
        );
    }

    /// The path begins at the first axle, and what is drawn along the robot is left out.
    #[test]
    fn four_axles_follow_a_drawn_path_from_their_first_axle() {
        let mut robot = robot("[robot.geometry]\naxles = 4");
        run(&mut robot, 0.6);
        let at = state(&robot, "truth");
        let line: Vec<[f64; 2]> = (0..60)
            .map(|k| [at[0] + 0.05 * f64::from(k), at[1]])
            .collect();
        robot.follow(&line).unwrap();
        run(&mut robot, 30.0);
        assert_eq!(state(&robot, "done"), [1.0]);
        let path = robot.planned().unwrap().to_vec();
        let front = &state(&robot, "axles")[..2];
        assert!(path[0][0] - at[0] > 0.5, "{:?} {at:?}", path[0]);
        // The midpoint ends at the end of the path, so the first axle drives beyond.
        let end = path.last().unwrap();
        assert!(
            distance(&state(&robot, "truth"), end) < 0.1,
            "{front:?} {end:?}"
        );
    }

    /// The state holds every axle and frame, and the lost board of an inner axle is noticed.
    #[test]
    fn three_axles_reach_a_goal_and_stop_without_their_middle_board() {
        let mut robot = robot("[robot.geometry]\naxles = 3");
        robot.regulate([0.0; 3]).unwrap();
        run(&mut robot, 45.0);
        assert_eq!(state(&robot, "done"), [1.0]);
        assert!(distance(&state(&robot, "truth"), &[0.0, 0.0]) < 0.1);
        let (axles, estimated) = (state(&robot, "axles"), state(&robot, "estimated_axles"));
        assert_eq!((axles.len(), estimated.len()), (9, 9));
        for k in 0..3 {
            assert!(distance(&axles[3 * k..], &estimated[3 * k..]) < 0.1, "{k}");
        }
        let faults = faults::of(Topology::new(3).unwrap());
        let number = faults
            .iter()
            .position(|fault| fault.name == "axle-2 board off");
        robot.regulate([1.0, 0.0, 0.0]).unwrap();
        robot.fault(number.unwrap()).unwrap();
        run(&mut robot, 2.0);
        let lost = f64::from(Condition::NeighbourLost.code());
        assert_eq!(state(&robot, "reasons")[0], lost);
    }

    /// At the largest torque the wheels of a robot on ice slip; its acceleration is below friction times gravity.
    #[test]
    fn friction_changes_while_the_robot_drives() {
        let speed_after = |friction: f64| {
            let mut robot = robot("world = \"ideal\"");
            robot.friction(friction).unwrap();
            run(&mut robot, 0.6);
            for _ in 0..10 {
                robot.speed(0.25, 0.0).unwrap();
                run(&mut robot, 0.1);
            }
            state(&robot, "speed")[0]
        };
        let slippery = speed_after(0.02);
        assert!(
            slippery < 9.81 * 0.02 && slippery < 0.9 * speed_after(0.6),
            "{slippery}"
        );
    }

    #[test]
    fn drift_of_the_gauges_bends_the_measured_frame() {
        let mut robot = robot("world = \"ideal\"");
        run(&mut robot, 0.5);
        let before = state(&robot, "strain");
        robot.drift_gauges(2e-5).unwrap();
        run(&mut robot, 0.5);
        let after = state(&robot, "strain");
        for k in 0..5 {
            assert!(
                (after[k] - before[k] - 2e-5).abs() < 5e-6,
                "{after:?} {before:?}"
            );
        }
    }

    #[test]
    fn numbers_outside_their_range_are_refused_by_name() {
        let mut robot = robot("");
        let text = |result: Result<(), Error>| result.unwrap_err().to_string();
        for (text, start) in [
            (
                text(robot.regulate([0.0, f64::NAN, 0.0])),
                "y = NaN: must be",
            ),
            (text(robot.place([99.0, 0.0, 0.0])), "x = 99: must be"),
            (text(robot.friction(0.0)), "friction = 0: must be"),
            (text(robot.drift_gauges(1.0)), "strain = 1: must be"),
            (
                text(robot.speed(f64::INFINITY, 0.0)),
                "speed = inf: must be",
            ),
            (text(robot.fault(99)), "fault = "),
        ] {
            assert!(text.starts_with(start), "{text}");
        }
    }
}
