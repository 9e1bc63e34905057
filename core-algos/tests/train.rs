//! Control of three to five axles against the plant: paths, regulation, stops. True postures, ideal robot.

use core_algos::control::cascade::AxleReference;
use core_algos::control::dynamic::{self, Dynamic};
use core_algos::control::path::{PathBuffer, PathPoint};
use core_algos::control::regulator::Tolerance;
use core_algos::control::train::{self, Step, Task, Train};
use core_algos::math::{AxleLoad, Posture, Twist, Wrench};
use core_algos::topology::MAX_AXLES;
use plant::{Plant, PlantConfig, Tyre};

const STIFFNESS: f32 = 0.833;
const LENGTH: f32 = 0.37;
/// Ticks after the beginning of an epoch at which the axles have their references.
const REFERENCES_AT: usize = 3;
/// Ticks after the beginning of an epoch at which the axles have the postures of the frames.
const FRAMES_AT: usize = 2;

type Path = PathBuffer<256>;
type Order<'a> = Task<'a, 256, 128>;

/// Robot with its controllers.
struct Bench {
    plant: Plant,
    train: Train,
    state: train::State,
    law: Dynamic,
    axles: usize,
    references: [AxleReference; MAX_AXLES],
    /// Age of the references in ticks.
    age: usize,
    frames: [Posture; MAX_AXLES],
    torques: [[f64; 2]; MAX_AXLES],
    /// Sum of squares, number and largest of the frames' forces, N.
    force: (f64, f64, f64),
    /// Largest distance of an axle from its reference, m.
    off: f32,
    time: f64,
}

fn posture([x, y, phi]: [f64; 3]) -> Posture {
    let phi = phi.sin().atan2(phi.cos());
    Posture::new(x as f32, y as f32, phi as f32)
}

impl Bench {
    fn new(axles: usize, start: [f64; 3]) -> Self {
        let config = PlantConfig {
            tyre: Tyre::brush(20.0),
            ..PlantConfig::default()
        };
        let mut plant = config.build(axles).unwrap();
        plant.place(start);
        let train = train::Config {
            axles: axles as u8,
            ..train::Config::default()
        };
        Self {
            plant,
            train: train.build().unwrap(),
            state: train::State::NEW,
            law: dynamic::Config::default().build().unwrap(),
            axles,
            references: [AxleReference::default(); MAX_AXLES],
            age: 0,
            frames: [Posture::ORIGIN; MAX_AXLES],
            torques: [[0.0; 2]; MAX_AXLES],
            force: (0.0, 0.0, 0.0),
            off: 0.0,
            time: 0.0,
        }
    }

    fn postures(&self) -> [Posture; MAX_AXLES] {
        let mut postures = [Posture::ORIGIN; MAX_AXLES];
        for (to, axle) in postures.iter_mut().zip(self.plant.axles()) {
            *to = posture(axle.posture);
        }
        postures
    }

    fn load(&self, axle: usize) -> AxleLoad {
        let wrench = |frame: usize| Wrench::cubic(STIFFNESS, LENGTH, 0.0, self.frames[frame]);
        let mut load = AxleLoad::default();
        if axle > 0 {
            load = load.plus(wrench(axle - 1).on_rear(0.0));
        }
        if axle + 1 < self.axles {
            load = load.plus(wrench(axle).on_front(self.frames[axle], 0.0));
        }
        load
    }

    fn tick(&mut self) {
        let applied = self.torques;
        for axle in 0..self.axles {
            let at = &self.plant.axles()[axle];
            let dt = 1e-3 * self.age as f32;
            let AxleReference {
                posture: begin,
                twist,
                acceleration,
            } = self.references[axle];
            let v = twist.v + acceleration.v * dt;
            let omega = twist.omega + acceleration.omega * dt;
            let reference = AxleReference {
                posture: begin.advance(0.5 * (twist.v + v) * dt, 0.5 * (twist.omega + omega) * dt),
                twist: Twist::new(v, omega),
                acceleration,
            };
            let here = posture(at.posture);
            self.off = self.off.max(here.distance(reference.posture));
            let command = self.law.step(&dynamic::Input {
                posture: here,
                twist: Twist::new(at.velocity[0] as f32, at.velocity[2] as f32),
                reference,
                reference_load: self.load(axle),
                beam_load: None,
                ground_force_n: 0.0,
            });
            self.torques[axle] = command.torque_nm.list().map(f64::from);
        }
        self.plant.step(&applied[..self.axles]);
        for frame in 0..self.axles - 1 {
            let [x, y] = self.plant.wrench(frame).force;
            let force = x.hypot(y);
            self.force.0 += force * force;
            self.force.1 += 1.0;
            self.force.2 = self.force.2.max(force);
        }
        self.time += 1e-3;
        self.age += 1;
    }

    fn epoch(&mut self, task: Order<'_>) -> Step {
        let postures = self.postures();
        let step = self.train.step(&mut self.state, &postures, task);
        let mut frames = [Posture::ORIGIN; MAX_AXLES];
        for (frame, to) in frames.iter_mut().enumerate().take(self.axles - 1) {
            *to = posture(self.plant.relative_posture(frame));
        }
        if self.time == 0.0 {
            self.references = step.references;
        }
        for tick in 0..10 {
            if tick == FRAMES_AT {
                self.frames = frames;
            }
            if tick == REFERENCES_AT {
                self.references = step.references;
                self.age = REFERENCES_AT;
            }
            self.tick();
        }
        step
    }

    fn force_rms(&self) -> f64 {
        (self.force.0 / self.force.1).sqrt()
    }

    /// Error of O against a goal: distance (m) and heading (rad).
    fn error(&self, goal: Posture) -> (f32, f32) {
        let at = posture(self.plant.midpoint());
        let [_, _, turn] = at.minus(goal);
        (at.distance(goal), turn.abs())
    }

    /// Largest bend of a frame, rad: half the relative heading of its axles.
    fn bend(&self) -> f64 {
        (0..self.axles - 1)
            .map(|frame| 0.5 * self.plant.relative_posture(frame)[2].abs())
            .fold(0.0, f64::max)
    }
}

/// Points of a path from its curve (x, y over a parameter), with the arc length between points `spacing` (m).
fn sampled(at: impl Fn(f64) -> [f64; 2], end: f64, spacing: f64) -> Vec<PathPoint> {
    let h = 1e-4;
    let derivative = |t: f64| {
        let [a, b] = [at(t - h), at(t + h)];
        [(b[0] - a[0]) / (2.0 * h), (b[1] - a[1]) / (2.0 * h)]
    };
    let (mut points, mut s, mut t, dt) = (Vec::new(), 0.0f64, 0.0, 1e-4);
    while t < end {
        if s >= spacing * points.len() as f64 {
            let [x, y] = at(t);
            let [dx, dy] = derivative(t);
            let [[ax, ay], [bx, by]] = [derivative(t - h), derivative(t + h)];
            let (ddx, ddy) = ((bx - ax) / (2.0 * h), (by - ay) / (2.0 * h));
            points.push(PathPoint {
                posture: Posture::new(x as f32, y as f32, dy.atan2(dx) as f32),
                kappa: ((dx * ddy - dy * ddx) / dx.hypot(dy).powi(3)) as f32,
                s: s as f32,
            });
        }
        let [dx, dy] = derivative(t + 0.5 * dt);
        s += dx.hypot(dy) * dt;
        t += dt;
    }
    points
}

/// Lemniscate of 7.9 m with |κ| ≤ 2, from its crossing.
fn eight() -> Vec<PathPoint> {
    let at = |t: f64| {
        let (sin, cos) = t.sin_cos();
        let scale = 1.5 * cos / (1.0 + sin * sin);
        [scale, scale * sin]
    };
    sampled(|t| at(t - core::f64::consts::FRAC_PI_2), core::f64::consts::TAU, 0.01)
}

/// Distance of a point from a path, m.
fn distance(points: &[PathPoint], x: f64, y: f64) -> f64 {
    points
        .windows(2)
        .map(|pair| {
            let [a, b] = [pair[0].posture, pair[1].posture].map(|p| [f64::from(p.x), f64::from(p.y)]);
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let u = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy);
            let u = u.clamp(0.0, 1.0);
            (x - a[0] - u * dx).hypot(y - a[1] - u * dy)
        })
        .fold(f64::INFINITY, f64::min)
}

/// Result of following a path.
#[derive(Debug)]
struct Followed {
    /// Root mean square and largest distance of each axle from the path, m.
    rms: Vec<f64>,
    largest: f64,
    force_rms: f64,
    force: f64,
    time: f64,
    target: f32,
}

/// Follows a path, with the axles measured while they are on it.
fn follow(axles: usize, points: &[PathPoint]) -> Followed {
    let first = points[0].posture;
    let body = f64::from(LENGTH) * (axles - 1) as f64;
    let mut bench = Bench::new(axles, [first.x, first.y, first.phi].map(f64::from));
    let mut path = Path::new();
    let (mut next, mut sums, mut count, mut largest) = (0, vec![0.0; axles], 0.0, 0.0f64);
    let length = f64::from(points[points.len() - 1].s);
    loop {
        while next < points.len() && path.room() > 0 {
            path.push(points[next]).unwrap();
            next += 1;
        }
        if next == points.len() {
            path.finish();
        }
        let within = Tolerance::default();
        let step = bench.epoch(Task::Follow {
            path: &mut path,
            within,
        });
        assert!(!step.lost && !step.stuck, "{step:?} after {} s", bench.time);
        assert!(bench.time < 120.0);
        // The body enters beside the path and leaves beyond it: only the middle of the path counts.
        let driven = 0.2 * (bench.time - 0.25);
        if (body + 1.3..length - 0.5 * body - 0.1).contains(&driven) {
            for (sum, axle) in sums.iter_mut().zip(bench.plant.axles()) {
                let off = distance(points, axle.posture[0], axle.posture[1]);
                *sum += off * off;
                largest = largest.max(off);
            }
            count += 1.0;
        }
        if driven < body + 1.3 {
            bench.force = (0.0, 0.0, 0.0);
        }
        if step.done {
            let (target, _) = bench.error(step.target);
            return Followed {
                rms: sums.iter().map(|sum| (sum / count).sqrt()).collect(),
                largest,
                force_rms: bench.force_rms(),
                force: bench.force.2,
                time: bench.time,
                target,
            };
        }
    }
}

#[test]
fn eight_is_driven_on_one_trace_by_all_axles() {
    let points = eight();
    let kappa = points.iter().map(|p| p.kappa.abs()).fold(0.0, f32::max);
    println!("length {} kappa {kappa}", points[points.len() - 1].s);
    let slopes: Vec<f64> = points
        .windows(2)
        .map(|p| f64::from((p[1].kappa - p[0].kappa) / (p[1].s - p[0].s)))
        .collect();
    let own = 0.833 * (slopes.iter().map(|k| k * k).sum::<f64>() / slopes.len() as f64).sqrt();
    println!("own force {own}");
    for axles in 3..=5 {
        let found = follow(axles, &points);
        println!("{axles}: {found:?}");
        assert!(found.rms.iter().all(|rms| *rms < 4e-3));
        assert!(found.force_rms < 1.1 * own && found.force_rms < 1.0);
        assert!(found.target < 5e-3);
    }
}

/// Numbers from 0 to 1 of a fixed sequence.
struct Luck(u64);

impl Luck {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

#[test]
fn any_start_is_regulated_to_the_goal() {
    let count: usize = std::env::var("STARTS").map_or(4, |count| count.parse().unwrap());
    for axles in 3..=5 {
        let mut luck = Luck(axles as u64);
        let (mut times, mut worst) = (Vec::new(), [0.0f64; 6]);
        let only: Option<usize> = std::env::var("ONLY").ok().map(|only| only.parse().unwrap());
        for trial in 0..count {
            let skip = only.is_some_and(|only| only != trial);
            let (r, bearing) = (2.0 * luck.next().sqrt(), luck.within(-3.14, 3.14));
            let start = [r * bearing.cos(), r * bearing.sin(), luck.within(-3.14, 3.14)];
            let mut bench = Bench::new(axles, start);
            let bent = trial % 2 == 1;
            if skip {
                if bent {
                    luck.next();
                    luck.next();
                }
                continue;
            }
            if bent {
                // Bends the frames by a drive.
                let curvature = luck.within(-2.3, 2.3) as f32;
                let speed_m_s = if luck.next() < 0.5 { 0.2 } else { -0.2 };
                for epoch in 0..250 {
                    let speed_m_s = if epoch < 200 { speed_m_s } else { 0.0 };
                    bench.epoch(Task::Drive { speed_m_s, curvature });
                }
                bench.state.restart_task();
            }
            let begin = bench.time;
            bench.force = (0.0, 0.0, 0.0);
            bench.off = 0.0;
            let goal = Posture::ORIGIN;
            let within = Tolerance::default();
            let mut plans = 0;
            let mut peak = 0.0f64;
            let mut last = bench.state.phase();
            loop {
                let step = bench.epoch(Task::Regulate { goal, within });
                if step.phase == core_algos::control::regulator::Phase::Plan && last != step.phase {
                    plans += 1;
                }
                if only.is_some() && (last != step.phase || step.off_path_m.abs() > 0.002) {
                    println!("{:.2} {:?} off {:.4} v {} {:?} {:?}", bench.time - begin, step.phase, step.off_path_m, step.v, step.direction, step.references[0].posture);
                }
                last = step.phase;
                if std::env::var("FORCES").is_ok() {
                    if bench.force.2 > peak + 0.2 && bench.force.2 > 5.6 {
                        let kappas: Vec<f32> = (0..axles).map(|i| bench.state.curve().kappa(bench.state.places()[i])).collect();
                        println!("{axles} {trial} {:.2} {:?} force {:.2} v {:.3} off {:.4} {kappas:.2?} bent {bent}", bench.time - begin, step.phase, bench.force.2, step.v, step.off_path_m);
                        peak = bench.force.2;
                    }
                }
                let failed = step.gave_up || step.lost || bench.time - begin > 150.0;
                assert!(!failed, "{axles} {trial} from {start:?}: {step:?}");
                if step.done {
                    break;
                }
            }
            let (e, turn) = bench.error(goal);
            let row = [
                f64::from(e),
                f64::from(turn),
                bench.bend(),
                bench.force.2,
                f64::from(bench.off),
                f64::from(plans),
            ];
            for (worst, value) in worst.iter_mut().zip(row) {
                *worst = worst.max(value);
            }
            times.push(bench.time - begin);
        }
        let mean = times.iter().sum::<f64>() / times.len() as f64;
        let longest = times.iter().copied().fold(0.0, f64::max);
        let [e, turn, bend, force, off, plans] = worst;
        println!(
            "{axles}: {count} starts, mean {mean:.1} s, longest {longest:.1} s, e {:.1} mm, heading {:.2}°, bend {:.1} mrad, \
             force {force:.1} N, off reference {:.1} mm, plans {plans}",
            1e3 * e,
            turn.to_degrees(),
            1e3 * bend,
            1e3 * off
        );
        assert!(e < 0.010 && turn < 0.01745 && bend < 0.015 && force < 7.5);
    }
}
