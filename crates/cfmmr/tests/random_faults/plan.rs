//! Faults and commands of a run, drawn from a seed.

use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::control::regulator::Tolerance;
use core_algos::fusion::Estimate;
use core_algos::math::Posture;
use core_algos::node::board::Samples;
use core_algos::node::lead::{Placement, Task};
use core_algos::safety::Condition;
use core_algos::topology::{Role, Side, Topology};
use host_sim::scenario::Scenario;
use host_sim::targets::HostCommand;
use host_sim::world::faults::{Fault, Wheel};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Length of a run, ms.
pub const RUN_MS: u32 = 10_000;

/// First and last tick of a fault, ms.
#[derive(Clone, Copy, Debug)]
pub struct Span(u32, u32);

impl Span {
    pub fn holds(self, tick: u32) -> bool {
        (self.0..=self.1).contains(&tick)
    }
}

/// Fault of a sensor of an axle or of the strip.
#[derive(Clone, Copy, Debug)]
pub enum SensorFault {
    EncoderMissing(Side),
    EncoderFrozen(Side),
    EncoderJumps(Side, i32),
    Gyro(f32),
    GyroMissing,
    Accelerometer(f32),
    BridgeRail(usize, bool),
    BridgesFrozen,
    BridgeNoise(i32),
}

/// Fault of the bus at one board.
#[derive(Clone, Copy, Debug)]
pub enum BusFault {
    /// The board receives nothing.
    ReceiveNothing,
    /// The board sends nothing.
    SendNothing,
    /// Share of the frames that the board does not receive.
    Loss(f64),
    /// Additional delay of frames, ms.
    Late(u32),
}

/// Faults and commands of a run.
#[derive(Debug)]
pub struct Plan {
    pub changes: Vec<String>,
    pub bus: Vec<(Role, BusFault, Span)>,
    pub sensors: Vec<(Role, SensorFault, Span)>,
    pub conditions: Vec<(Role, Condition, Span)>,
    pub commands: Vec<(u32, HostCommand)>,
    pub injected: Option<(Fault, u32)>,
}

/// Conditions that the drivers of a board report.
const REPORTED: [Condition; 18] = [
    Condition::EmergencyStop,
    Condition::BusOff,
    Condition::OverTemperature,
    Condition::SupplyLow,
    Condition::SupplyHigh,
    Condition::TickOverrun,
    Condition::OverCurrent,
    Condition::DriverFault,
    Condition::MotorUnresponsive,
    Condition::Restarted,
    Condition::RoleTaken,
    Condition::NotANumber,
    Condition::EncoderFault,
    Condition::MotorStall,
    Condition::TemperatureHigh,
    Condition::SupplyWarning,
    Condition::ClockStepped,
    Condition::TickLate,
];

/// Extreme and invalid numbers that a host may send.
const EXTREME_NUMBERS: [f32; 10] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    -1e30,
    1e18,
    1e-30,
    -0.0,
    1e5,
    -1e9,
];

impl Plan {
    pub fn draw(seed: u64) -> Self {
        let mut draw = Draw(Pcg64::seed_from_u64(seed));
        let mut changes = Vec::new();
        if draw.happens(0.5) {
            changes
                .extend(["gyro", "accelerometer"].map(|one| format!("sensors.{one}.fitted=true")));
        }
        if draw.happens(0.3) {
            let (loss, jitter) = (draw.between(0.0, 0.03), draw.below(4));
            changes.push(format!("bus.loss={loss:.4}"));
            changes.push(format!("bus.jitter_ms={jitter}"));
            changes.push(format!("bus.doubling={:.4}", draw.between(0.0, 0.02)));
        }
        if draw.happens(0.1) {
            changes.push("bus.corruption=0.002".to_owned());
        }
        let few = |draw: &mut Draw, most: usize| 0..draw.below(most + 1);
        let bus = few(&mut draw, 4)
            .map(|_| draw.bus())
            .collect::<Vec<_>>()
            .concat();
        let sensors = few(&mut draw, 2).map(|_| draw.sensor()).collect();
        let conditions = few(&mut draw, 3)
            .map(|_| {
                (
                    draw.role(),
                    REPORTED[draw.below(REPORTED.len())],
                    draw.span(600),
                )
            })
            .collect();
        let injected = draw.happens(0.25).then(|| draw.injected());
        Self {
            changes,
            bus,
            sensors,
            conditions,
            commands: draw.commands(),
            injected,
        }
    }

    pub fn scenario(&self) -> Scenario {
        Scenario::parse(None, "", "test", &self.changes).unwrap()
    }
}

struct Draw(Pcg64);

impl Draw {
    fn happens(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }

    fn below(&mut self, end: usize) -> usize {
        self.0.random_range(0..end)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    fn role(&mut self) -> Role {
        Role::PAIR[self.below(3)]
    }

    /// Span of at most `most_ms`; short spans are more likely.
    fn span(&mut self, most_ms: u32) -> Span {
        let from = self.0.random_range(200..RUN_MS);
        let share = self.between(0.0, 1.0);
        let length = (f64::from(most_ms) * share * share) as u32;
        Span(from, from + length)
    }

    /// Bus fault of one board, or of all boards at a time.
    fn bus(&mut self) -> Vec<(Role, BusFault, Span)> {
        let (fault, span) = match self.below(4) {
            0 => (BusFault::ReceiveNothing, self.span(400)),
            1 => (BusFault::SendNothing, self.span(400)),
            2 => (BusFault::Loss(self.between(0.05, 0.9)), self.span(2000)),
            _ => (BusFault::Late(self.0.random_range(1..70)), self.span(2000)),
        };
        match self.happens(0.3) {
            true => Role::PAIR.map(|role| (role, fault, span)).to_vec(),
            false => vec![(self.role(), fault, span)],
        }
    }

    fn sensor(&mut self) -> (Role, SensorFault, Span) {
        let side = Side::BOTH[self.below(2)];
        let fault = match self.below(9) {
            0 => SensorFault::EncoderMissing(side),
            1 => SensorFault::EncoderFrozen(side),
            2 => SensorFault::EncoderJumps(side, 1 << self.below(31)),
            3 => SensorFault::Gyro([f32::NAN, f32::INFINITY, 35.0, -35.0][self.below(4)]),
            4 => SensorFault::GyroMissing,
            5 => SensorFault::Accelerometer([f32::NAN, 157.0, -157.0][self.below(3)]),
            6 => SensorFault::BridgeRail(1 + self.below(5), side == Side::Left),
            7 => SensorFault::BridgesFrozen,
            _ => SensorFault::BridgeNoise(1 << self.below(14)),
        };
        let role = match fault {
            SensorFault::BridgeRail(..)
            | SensorFault::BridgesFrozen
            | SensorFault::BridgeNoise(_) => Role::beam(0),
            _ => [Role::LEAD, Role::axle(1)][self.below(2)],
        };
        (role, fault, self.span(1500))
    }

    fn injected(&mut self) -> (Fault, u32) {
        let at = self.0.random_range(300..RUN_MS - 1000);
        let wheel = Wheel {
            axle: self.below(2),
            side: Side::BOTH[self.below(2)],
        };
        let fault = match self.below(6) {
            0..=2 => Fault::Reset {
                board: self.role(),
                off_ms: self.0.random_range(20..1500),
            },
            3 => Fault::Freeze {
                board: self.role(),
                ms: self.0.random_range(2..90),
            },
            4 => Fault::MotorWeak { wheel, share: 0.3 },
            _ => Fault::WheelLifted(wheel),
        };
        (fault, at)
    }

    fn commands(&mut self) -> Vec<(u32, HostCommand)> {
        let mut at = self.0.random_range(60..400);
        let mut commands = Vec::new();
        while at < RUN_MS {
            match self.below(8) {
                // Clears the faults, then drives.
                0 | 1 => {
                    commands.push((at, HostCommand::Task(Task::Clear)));
                    at += self.0.random_range(15..300);
                    commands.push((at, self.drive()));
                }
                2 => commands.push((at, self.any_command())),
                _ => commands.push((at, self.drive())),
            }
            if let Some((_, HostCommand::Task(Task::Drive { .. }))) = commands.last() {
                let again = commands[commands.len() - 1].1.clone();
                for _ in 0..self.below(12) {
                    at += 100;
                    commands.push((at, again.clone()));
                }
            }
            at += self.0.random_range(1..3000);
        }
        commands
    }

    fn near_posture(&mut self) -> Posture {
        let [x, y, phi] = [1.5, 1.5, 3.0].map(|most| self.between(-most, most) as f32);
        Posture::new(x, y, phi)
    }

    /// Number within ±`limit`, or with probability 0.25 one of [`EXTREME_NUMBERS`].
    fn number(&mut self, limit: f64) -> f32 {
        match self.happens(0.25) {
            true => EXTREME_NUMBERS[self.below(EXTREME_NUMBERS.len())],
            false => self.between(-limit, limit) as f32,
        }
    }

    fn drive(&mut self) -> HostCommand {
        HostCommand::Task(match self.below(6) {
            0 => Task::Stop,
            1 => Task::Drive {
                speed_m_s: self.between(-0.3, 0.3) as f32,
                curvature: self.between(-2.0, 2.0) as f32,
            },
            2 => return HostCommand::Task(Task::Idle),
            _ => Task::regulate(self.near_posture()),
        })
    }

    fn tolerance(&mut self) -> Tolerance {
        Tolerance {
            position_m: self.number(0.2),
            heading_rad: self.number(0.2),
        }
    }

    fn extreme_posture(&mut self) -> Posture {
        let [x, y, phi] = [2.0, 2.0, 4.0].map(|most| self.number(most));
        Posture::new(x, y, phi)
    }

    fn any_command(&mut self) -> HostCommand {
        match self.below(9) {
            0 => HostCommand::Lost,
            1 => HostCommand::SetPose(self.place()),
            2 | 3 => self.path(),
            4 => HostCommand::Task(Task::Follow {
                within: self.tolerance(),
            }),
            5 => HostCommand::Task(Task::Track {
                within: self.tolerance(),
            }),
            6 => HostCommand::Task(Task::Drive {
                speed_m_s: self.number(0.5),
                curvature: self.number(3.0),
            }),
            _ => HostCommand::Task(Task::Regulate {
                goal: self.extreme_posture(),
                within: match self.happens(0.5) {
                    true => Tolerance::default(),
                    false => self.tolerance(),
                },
            }),
        }
    }

    fn place(&mut self) -> Placement {
        let (center, relative) = match self.happens(0.5) {
            true => (self.near_posture(), Posture::new(0.37, 0.0, 0.0)),
            false => (self.extreme_posture(), self.extreme_posture()),
        };
        let sigmas = [0.01, 0.01, 0.02].map(|sigma| match self.happens(0.1) {
            true => self.number(1.0),
            false => sigma,
        });
        Placement {
            center: Estimate::with_sigmas(center, sigmas),
            relative: Estimate::with_sigmas(relative, sigmas),
            floor_drift: match self.happens(0.1) {
                true => self.number(1.0),
                false => 0.015,
            },
        }
    }

    /// Path of points on a line from the start. In 30 % of the paths, a fifth of the points is random, even invalid.
    fn path(&mut self) -> HostCommand {
        let start = Scenario::default().mission.start.map(|part| part as f32);
        let odd = self.happens(0.3);
        let points: Vec<PathPoint> = (0..2 + self.below(20))
            .map(|i| {
                let s = 0.05 * i as f32;
                let mut point = PathPoint {
                    posture: Posture::from(start).advance(s, 0.0),
                    kappa: 0.0,
                    s,
                };
                if odd && self.happens(0.2) {
                    point.posture = self.extreme_posture();
                    point.kappa = self.number(2.0);
                    point.s = self.number(1.0);
                }
                point
            })
            .collect();
        let end = self.happens(0.8);
        match self.happens(0.5) {
            true => HostCommand::Path { points, end },
            false => {
                let v = self.number(0.2).abs();
                let timed = points.iter().map(|&point| TrajectoryPoint {
                    time_s: point.s / 0.1,
                    v,
                    point,
                });
                HostCommand::Trajectory {
                    points: timed.collect(),
                    end,
                }
            }
        }
    }
}

/// Applies the sensor faults of a plan to the samples of a board.
pub struct SampleFaults {
    role: Role,
    random: Pcg64,
    before: Option<Samples>,
}

impl SampleFaults {
    pub fn new(role: Role, seed: u64) -> Self {
        Self {
            role,
            random: Pcg64::seed_from_u64(seed ^ (Topology::PAIR.place(role) as u64 + 1) << 40),
            before: None,
        }
    }

    pub fn lost(&mut self, share: f64) -> bool {
        self.random.random::<f64>() < share
    }

    pub fn samples(&mut self, plan: &Plan, tick: u32, samples: &Samples) -> Samples {
        let mut samples = *samples;
        let frozen = self.before.unwrap_or(samples);
        for (role, fault, span) in &plan.sensors {
            if *role == self.role && span.holds(tick) {
                self.apply(*fault, &frozen, &mut samples);
            }
        }
        self.before = Some(samples);
        let of = |(role, condition, span): &(Role, Condition, Span)| {
            (*role == self.role && span.holds(tick)).then_some(*condition)
        };
        for condition in plan.conditions.iter().filter_map(of) {
            match &mut samples {
                Samples::Axle(samples) => samples.conditions.set(condition, true),
                Samples::Beam(samples) => samples.conditions.set(condition, true),
            }
        }
        samples
    }

    fn apply(&mut self, fault: SensorFault, before: &Samples, samples: &mut Samples) {
        match (samples, before) {
            (Samples::Axle(now), Samples::Axle(before)) => match fault {
                SensorFault::EncoderMissing(side) => now.encoder[side] = None,
                SensorFault::EncoderFrozen(side) => now.encoder[side] = before.encoder[side],
                SensorFault::EncoderJumps(side, by) => {
                    let by = by.wrapping_mul(self.random.random_range(0..3));
                    now.encoder[side] = now.encoder[side].map(|count| count.wrapping_add(by));
                }
                SensorFault::Gyro(rate) => now.gyro_rad_s = Some(rate),
                SensorFault::GyroMissing => now.gyro_rad_s = None,
                SensorFault::Accelerometer(value) => now.acceleration_m_s2 = Some(value),
                _ => {}
            },
            (Samples::Beam(now), Samples::Beam(before)) => match fault {
                SensorFault::BridgeRail(count, high) => {
                    let rail = if high { FULL_SCALE } else { 0 };
                    now.counts[..count].fill(rail);
                }
                SensorFault::BridgesFrozen => now.counts = before.counts,
                SensorFault::BridgeNoise(most) => {
                    for count in &mut now.counts {
                        let noisy = *count + self.random.random_range(-most..=most);
                        *count = noisy.clamp(0, FULL_SCALE);
                    }
                }
                _ => {}
            },
            _ => {}
        }
    }
}

/// Largest count of the bridge converter.
const FULL_SCALE: i32 = (1 << 14) - 1;
