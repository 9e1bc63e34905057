//! Axle node: encoders and inertial sensors in, wheel torques out, once a millisecond.
//!
//! The step reads in the order of the data: wheels → zeroing → filter → report → supervision →
//! reference → control. The posture is odometric, in a frame of its own that begins where the axle was started; the lead
//! node knows where that frame lies and sends references in it, so a correction of the global
//! estimate never makes the controller jump.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. Without a fresh reference the axle brakes by
//! itself, along the path it is on, and switches its motors off; with any number that is not finite
//! the torques are zero at once.

use super::Outbox;
use super::peers::{self, Peers};
use crate::bus::{LeadMode, Message, layout};
use crate::config::{ConfigError, in_range, positive};
use crate::control::cascade::AxleReference;
use crate::control::dynamic::{self, Dynamic};
use crate::control::wheel_observer::{self, WheelObserver};
use crate::fusion::Estimate;
use crate::fusion::ekf::{self, AxleFilter, Measurements, Verdict};
use crate::fusion::standstill::{self, Bias, RestDetector, RestTimes, Zeroing};
use crate::math::{AxleLoad, Posture, Steering, Twist, Wrench};
use crate::safety::supervisor::{self, Supervisor};
use crate::safety::{Condition, Conditions, OperatingState, Permit, Request, ramp};
use crate::time::{EPOCH, Micros, Stamped, TICK, epoch_start, is_epoch_start, seconds, sequence};
use crate::topology::AxleId;
use crate::topology::Node;

/// Speed the controller uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum SpeedSource {
    /// The tracking observers of the wheels: least lag.
    #[default]
    Wheels,
    /// The axle filter.
    Filter,
}

/// Age from which a reference is late: the lead node and the bus have had two epochs for it.
const LATE: Micros = 3 * EPOCH;

/// Parameters of an axle node.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Age of a mode or a reference after which the motors are switched off, s.
    pub reference_timeout_s: f32,
    /// Age of a wrench from the beam after which it is no longer used, s.
    pub wrench_timeout_s: f32,
    /// Speed the controller uses.
    pub speed_source: SpeedSource,
    /// Wheel observers.
    pub wheel: wheel_observer::Config,
    /// Radius of the right wheel over that of the left.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub wheel_ratio: f32,
    /// Time of rest after which the inertial sensors are zeroed, s: wheels still for the
    /// accelerometer, motors off too for the gyro.
    pub rest_hold_s: f32,
    /// Time for which the motors must have been off before the gyro is zeroed, s, unless they never
    /// were on: a bent frame unwinds over creeping tyres.
    pub rest_settle_s: f32,
    /// Zeroing of the gyro at standstill.
    pub gyro_zero: standstill::Config,
    /// Zeroing of the accelerometer at standstill.
    pub accelerometer_zero: standstill::Config,
    /// Axle filter.
    pub filter: ekf::Config,
    /// Dynamic controller.
    pub controller: dynamic::Config,
    /// When the axle stops because something is wrong.
    pub limits: Limits,
    /// How it stops.
    pub stop: ramp::Config,
    /// Supervisor.
    pub supervisor: supervisor::Config,
}

/// Bounds of what a sound axle does; each counts only after the time of its condition.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Limits {
    /// Distance from the reference, m.
    pub tracking_m: f32,
    /// Difference in heading from the reference, rad.
    pub tracking_rad: f32,
    /// Share of the largest torque from which a wheel that stands still is blocked.
    pub stall_share: f32,
    /// Speed below which a wheel stands still, rad/s.
    pub stall_rad_s: f32,
    /// Difference of the yaw rates by the wheels and by the gyro, rad/s.
    pub slip_rad_s: f32,
    /// Speed of a wheel over ground beyond which a reference is not taken, m/s.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub wheel_speed_m_s: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            tracking_m: 0.08,
            tracking_rad: 0.35,
            stall_share: 0.6,
            stall_rad_s: 0.2,
            slip_rad_s: 0.8,
            wheel_speed_m_s: 0.5,
        }
    }
}

impl Limits {
    fn check(&self) -> Result<(), ConfigError> {
        positive("tracking_m", self.tracking_m)?;
        positive("tracking_rad", self.tracking_rad)?;
        in_range("stall_share", self.stall_share, 0.1, 1.0)?;
        positive("stall_rad_s", self.stall_rad_s)?;
        positive("slip_rad_s", self.slip_rad_s)?;
        positive("wheel_speed_m_s", self.wheel_speed_m_s)?;
        Ok(())
    }

    /// Whether an error of the posture is within so many times what a sound axle has.
    fn near(&self, error: Posture, times: f32) -> bool {
        let (way, turn) = (times * self.tracking_m, times * self.tracking_rad);
        error.x.abs() <= way && error.y.abs() <= way && error.phi.abs() <= turn
    }

    /// Whether a motion is one that this robot can be asked for.
    fn allow(&self, twist: Twist, half_track: f32) -> bool {
        twist.v.abs() + half_track * twist.omega.abs() <= self.wheel_speed_m_s
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            reference_timeout_s: layout::timeout_s(layout::id::REFERENCE_POSTURE),
            wrench_timeout_s: layout::timeout_s(layout::id::BEAM_WRENCH),
            speed_source: SpeedSource::Wheels,
            wheel: wheel_observer::Config::default(),
            wheel_ratio: 1.0,
            rest_hold_s: 0.1,
            rest_settle_s: 60.0,
            gyro_zero: standstill::Config::GYRO,
            accelerometer_zero: standstill::Config::ACCELEROMETER,
            filter: ekf::Config::default(),
            controller: dynamic::Config::default(),
            limits: Limits::default(),
            stop: ramp::Config::default(),
            supervisor: supervisor::Config::default(),
        }
    }
}

/// What an axle must know of the frame it is fixed to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameProperties {
    /// Bending stiffness EI, N m².
    pub bending_stiffness_n_m2: f32,
    /// Flexible length L, m.
    pub length_m: f32,
}

impl Config {
    /// The node of one axle; the error names the parameter that is wrong.
    pub fn build(&self, axle: AxleId, frame: FrameProperties) -> Result<AxleNode, ConfigError> {
        in_range("reference_timeout_s", self.reference_timeout_s, 0.01, 1.0)?;
        in_range("wrench_timeout_s", self.wrench_timeout_s, 0.01, 1.0)?;
        positive("bending_stiffness_n_m2", frame.bending_stiffness_n_m2)?;
        positive("frame_length_m", frame.length_m)?;
        self.limits.check()?;
        let to_micros = |s: f32| (s * 1e6) as Micros;
        let period = positive("period_s", self.filter.period_s)?;
        let rest_hold = in_range("rest_hold_s", self.rest_hold_s, 0.01, 10.0)?;
        let rest_settle = in_range("rest_settle_s", self.rest_settle_s, 0.0, 3600.0)?;
        let gyro_zero = self.gyro_zero.build(period)?;
        let wheel_radius = positive("wheel_radius_m", self.controller.wheel_radius_m)?;
        let ratio = in_range("wheel_ratio", self.wheel_ratio, 0.8, 1.25)?;
        let left = 2.0 * wheel_radius / (1.0 + ratio);
        Ok(AxleNode {
            axle,
            frame,
            reference_timeout: to_micros(self.reference_timeout_s),
            wrench_timeout: to_micros(self.wrench_timeout_s),
            speed_source: self.speed_source,
            wheel_radius,
            wheel_radii: [left, ratio * left],
            half_track: positive("half_track_m", self.controller.half_track_m)?,
            period,
            rest: RestTimes {
                hold: (rest_hold / period).clamp(1.0, f32::from(u16::MAX)) as u16,
                settle: (rest_settle / period) as u32,
                spread: gyro_zero.spread(),
            },
            gyro_zero,
            accelerometer_zero: self.accelerometer_zero.build(period)?,
            observer: self.wheel.build()?,
            filter: self.filter.build()?,
            controller: self.controller.build()?,
            stall_torque: self.limits.stall_share * self.controller.max_torque_nm,
            limits: self.limits,
            ramp: self.stop.build(self.supervisor.stop_timeout_s)?,
            supervisor: self.supervisor.build()?,
            state: State::new(),
        })
    }
}

/// What the sensors of an axle board read at a tick; `None` where nothing came.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Samples {
    /// Encoder counts (left, right); they wrap.
    pub encoder: [Option<i32>; 2],
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
    /// What the board's drivers find wrong: motors, supply, temperature, bus, time.
    pub conditions: Conditions,
}

/// What the node did at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Wheel torques (left, right), N m; positive drives forward.
    pub torque_nm: [f32; 2],
    /// Whether a reference is being followed; otherwise the motors are off.
    pub active: bool,
    /// Tracking error (e_X, e_Y, e_φ) in the axle's frame; zero when not active.
    pub error: Posture,
    /// A computation left the finite numbers.
    pub invalid: bool,
    /// The controller asks for more than the motors give.
    pub limited: bool,
}

/// A coordinated stop under way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stop {
    ramp: ramp::State,
    /// Share of the torque at rest that may still be used.
    hold: f32,
    /// Larger of the wheels' torques when letting go began, N m.
    held_nm: f32,
}

impl Stop {
    /// Bounds the torques, with their direction kept, once the frame is being let go.
    fn let_go(&mut self, torque_nm: &mut [f32; 2]) {
        let [left, right] = *torque_nm;
        let largest = left.abs().max(right.abs());
        if self.hold >= 1.0 {
            self.held_nm = largest;
            return;
        }
        let bound = self.hold * self.held_nm;
        if largest > bound {
            *torque_nm = torque_nm.map(|torque| torque * (bound / largest));
        }
    }
}

/// All that changes in an axle node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Time of the first step.
    started: Option<Micros>,
    wheels: [wheel_observer::State; 2],
    filter: ekf::State,
    rest: RestDetector,
    gyro_bias: Bias,
    accelerometer_bias: Bias,
    /// What the last step gave.
    output: Output,
    /// Reference of the last step.
    followed: Option<AxleReference>,
    /// The stop under way.
    stop: Option<Stop>,
    /// The stop is over.
    halted: bool,
    peers: Peers,
    supervisor: supervisor::State,
    refused: u8,
    gyro_samples: u8,
    gyro_zeroed: bool,
    mode: Option<Stamped<LeadMode>>,
    /// The lead node has been heard while it did not drive.
    paused: bool,
    steering: Steering,
    velocity: f32,
    pending_posture: Option<(u8, Posture)>,
    pending_motion: Option<(u8, Twist, Twist)>,
    reference: Option<Stamped<AxleReference>>,
    wrench: Option<Stamped<Wrench>>,
    relative: Option<Stamped<Posture>>,
}

impl State {
    fn new() -> Self {
        Self {
            started: None,
            wheels: [wheel_observer::State::default(); 2],
            // The odometric frame is where the axle stands: its origin is exact by definition.
            filter: ekf::State::at_rest(
                &Estimate::with_sigmas(Posture::ORIGIN, [1e-6; 3]),
                [1e-3, 1e-3, 1e-2, 1e-2],
            ),
            rest: RestDetector::default(),
            gyro_bias: Bias::default(),
            accelerometer_bias: Bias::default(),
            output: Output::default(),
            followed: None,
            stop: None,
            halted: false,
            peers: Peers::default(),
            supervisor: supervisor::State::default(),
            refused: 0,
            gyro_samples: 0,
            gyro_zeroed: false,
            mode: None,
            paused: false,
            steering: Steering::STRAIGHT,
            velocity: 0.0,
            pending_posture: None,
            pending_motion: None,
            reference: None,
            wrench: None,
            relative: None,
        }
    }
}

/// The node of one axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxleNode {
    axle: AxleId,
    frame: FrameProperties,
    reference_timeout: Micros,
    wrench_timeout: Micros,
    speed_source: SpeedSource,
    /// Mean of the two.
    wheel_radius: f32,
    /// Left and right.
    wheel_radii: [f32; 2],
    half_track: f32,
    period: f32,
    /// Ticks.
    rest: RestTimes,
    gyro_zero: Zeroing,
    accelerometer_zero: Zeroing,
    observer: WheelObserver,
    filter: AxleFilter,
    controller: Dynamic,
    limits: Limits,
    /// N m.
    stall_torque: f32,
    ramp: ramp::Ramp,
    supervisor: Supervisor,
    state: State,
}

/// Wheel speed above which an axle that is let go after a stop is being driven, rad/s.
const LET_GO_RAD_S: f32 = 5.0;

impl AxleNode {
    /// Begins anew, as it was built.
    pub fn restart(&mut self) {
        self.state = State::new();
    }

    /// Which axle this is.
    pub fn axle(&self) -> AxleId {
        self.axle
    }

    /// All that changes.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Where the axle stands, and why.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervisor
    }

    /// Whether the lead node asks to forget faults; the board's drivers forget theirs too.
    pub fn clears(&self, now: Micros) -> bool {
        let mode = self.state.mode.as_ref();
        mode.and_then(|mode| mode.fresh(now, self.reference_timeout)) == Some(&LeadMode::Clear)
    }

    /// Takes in a message that arrived at `now`. What is not meant for this axle is ignored.
    pub fn receive(&mut self, now: Micros, message: &Message) {
        let state = &mut self.state;
        state.peers.receive(now, message);
        match *message {
            Message::LeadStatus {
                mode,
                steering_rad,
                velocity_m_s,
                ..
            } => {
                state.mode = Some(Stamped::new(mode, now));
                state.paused |= matches!(mode, LeadMode::Idle | LeadMode::Clear);
                state.steering = Steering(steering_rad);
                state.velocity = velocity_m_s;
            }
            Message::ReferencePosture {
                axle,
                sequence,
                posture,
            } if axle == self.axle => {
                state.pending_posture = Some((sequence, posture));
                state.pair_reference(now);
            }
            Message::ReferenceMotion {
                axle,
                sequence,
                velocity_m_s,
                yaw_rate_rad_s,
                acceleration_m_s2,
                yaw_acceleration_rad_s2,
            } if axle == self.axle => {
                let twist = Twist::new(velocity_m_s, yaw_rate_rad_s);
                if self.limits.allow(twist, self.half_track) {
                    let acceleration = Twist::new(acceleration_m_s2, yaw_acceleration_rad_s2);
                    state.pending_motion = Some((sequence, twist, acceleration));
                    state.pair_reference(now);
                }
            }
            Message::BeamWrench { sequence, wrench } => {
                state.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
            }
            Message::BeamPosture {
                sequence,
                posture,
                gauges,
            } if gauges > 0 => {
                state.relative = Some(Stamped::new(posture, epoch_start(now, sequence)));
            }
            _ => {}
        }
    }

    /// One tick at `now`. Reports go to `outbox` at the beginning of an epoch.
    pub fn step(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Output {
        self.state.started.get_or_insert(now);
        let speeds = self.estimate(samples);
        if is_epoch_start(now) {
            self.report(now, outbox);
        }
        let permit = self.supervise(now, samples, outbox);
        let reference = match permit {
            Permit::Off => None,
            Permit::Hold | Permit::Drive => self.reference(now),
            Permit::Brake => Some(self.brake()),
        };
        if permit != Permit::Brake {
            self.state.stop = None;
            self.state.halted = false;
        }
        self.state.followed = reference;
        self.state.output = reference.map_or(Output::default(), |reference| {
            self.control(now, speeds, reference)
        });
        if let Some(stop) = &mut self.state.stop {
            stop.let_go(&mut self.state.output.torque_nm);
        }
        self.state.output
    }

    /// Which node this is.
    fn node(&self) -> Node {
        match self.axle {
            AxleId::Front => Node::FrontAxle,
            AxleId::Rear => Node::RearAxle,
        }
    }

    /// What the motors may do at this tick; the heartbeat goes out with it.
    fn supervise(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Permit {
        let mut input = supervisor::Input {
            conditions: self.watch(now, samples),
            halted: self.state.halted,
            ..supervisor::Input::default()
        };
        let before = self.state.supervisor.operating();
        let mut permit = Permit::Off;
        // From rest to driving in one tick: arm and start.
        for _ in 0..3 {
            input.request = self.request(now);
            permit = self
                .supervisor
                .step(&mut self.state.supervisor, now, &input)
                .permit;
            if self.request(now).is_none() {
                break;
            }
        }
        let node = self.node();
        let state = &mut self.state.supervisor;
        if is_epoch_start(now) || state.operating() != before {
            outbox.push(peers::heartbeat(node, now, state));
        }
        permit
    }

    /// What the lead node's mode asks of this axle.
    fn request(&self, now: Micros) -> Option<Request> {
        let mode = self.state.mode?.fresh(now, self.reference_timeout).copied();
        let driving = matches!(mode, Some(LeadMode::Active | LeadMode::Hold));
        match self.state.supervisor.operating() {
            OperatingState::Boot => Some(Request::Ready),
            // A board that starts while the robot drives stays off until the robot has stopped.
            OperatingState::Idle
                if driving && self.state.paused && self.reference(now).is_some() =>
            {
                Some(Request::Arm)
            }
            OperatingState::Armed if driving => Some(Request::Start),
            OperatingState::Armed => Some(Request::Disarm),
            OperatingState::Active if matches!(mode, Some(LeadMode::Idle | LeadMode::Clear)) => {
                Some(Request::Disarm)
            }
            OperatingState::Fault if mode == Some(LeadMode::Clear) => Some(Request::Clear),
            _ => None,
        }
    }

    /// What is wrong at this tick.
    fn watch(&self, now: Micros, samples: &Samples) -> Conditions {
        let state = &self.state;
        let other = match self.axle {
            AxleId::Front => Node::RearAxle,
            AxleId::Rear => Node::FrontAxle,
        };
        let operating = state.supervisor.operating();
        let powered = operating.permit() != Permit::Off;
        let active = operating == OperatingState::Active;
        let astray =
            |times: f32| state.output.active && !self.limits.near(state.output.error, times);
        // An axle that is let go is not to stay, but it is not to be driven either.
        let runs = |wheel: &wheel_observer::State| !(wheel.speed_rad_s.abs() <= LET_GO_RAD_S);
        let unstopped = operating == OperatingState::SafeStop
            && state
                .stop
                .as_ref()
                .is_some_and(|stop| match stop.hold < 1.0 {
                    true => state.wheels.iter().any(runs),
                    false => astray(2.0),
                });
        let mut stalled = false;
        let mut blind = false;
        for i in 0..2 {
            let wheel = &state.wheels[i];
            let pushes = state.output.torque_nm[i].abs() >= self.stall_torque;
            stalled |= pushes && wheel.speed_rad_s.abs() <= self.limits.stall_rad_s;
            blind |= samples.encoder[i].is_none() || wheel.jumped;
        }
        let by_wheels = self.wheel_radius * 0.5 / self.half_track
            * (state.wheels[1].speed_rad_s - state.wheels[0].speed_rad_s);
        let slips = samples
            .gyro_rad_s
            .is_some_and(|rate| (rate - by_wheels).abs() > self.limits.slip_rad_s);
        let unsound = !state.filter.posture().is_finite();
        let late = state
            .reference
            .is_none_or(|reference| reference.age(now) > LATE);
        // A lead node that lets the axle go sends no more references, and that is no fault.
        let dismissed = state
            .mode
            .is_some_and(|mode| matches!(mode.value, LeadMode::Idle | LeadMode::Clear));
        let failed = state.peers.failed(other, now) || state.peers.failed(Node::Lead, now);
        samples
            .conditions
            .with(
                Condition::CommandTimeout,
                active && !dismissed && self.reference(now).is_none(),
            )
            .with(Condition::NeighbourLost, state.peers.lost(other, now))
            .with(Condition::NeighbourFault, powered && failed)
            .with(Condition::NotANumber, state.output.invalid || unsound)
            .with(Condition::EncoderFault, blind)
            .with(Condition::TrackingLost, active && astray(1.0))
            .with(Condition::StopNotFollowed, unstopped)
            .with(Condition::MotorStall, stalled)
            .with(Condition::WheelSlip, slips)
            .with(Condition::MeasurementRefused, state.refused > 0)
            .with(Condition::TorqueLimited, state.output.limited)
            .with(Condition::MessageLost, active && late)
    }

    /// The reference of the coordinated stop at this tick.
    fn brake(&mut self) -> AxleReference {
        let state = &mut self.state;
        let ramp = &self.ramp;
        let (velocity, steering, length) = (state.velocity, state.steering, self.frame.length_m);
        let stop = state.stop.get_or_insert_with(|| Stop {
            ramp: match state.followed {
                Some(reference) => ramp.begin(reference.posture, velocity, steering, length),
                None => ramp.begin(state.filter.posture(), 0.0, Steering::STRAIGHT, length),
            },
            hold: 1.0,
            held_nm: 0.0,
        });
        let reference = ramp.step(&mut stop.ramp, seconds(TICK));
        stop.hold = reference.hold;
        state.halted = reference.halted;
        AxleReference {
            posture: reference.posture,
            twist: reference.twist,
            acceleration: reference.acceleration,
        }
    }

    /// Torques after the reference.
    fn control(&self, now: Micros, speeds: [f32; 2], reference: AxleReference) -> Output {
        let command = self.controller.step(&dynamic::Input {
            posture: self.state.filter.posture(),
            twist: self.twist(speeds),
            reference,
            reference_load: self.reference_load(),
            beam_load: self.beam_load(now),
        });
        // A reference far off is a mistake, until it has lasted long enough to be a fault.
        let near = self.limits.near(command.error, 2.0);
        Output {
            torque_nm: if near { command.torque_nm } else { [0.0; 2] },
            active: command.valid,
            error: command.error,
            invalid: !command.valid,
            limited: command.scale < 1.0,
        }
    }

    /// Wheels and filter; returns the wheels' speeds over ground, m/s.
    fn estimate(&mut self, samples: &Samples) -> [f32; 2] {
        let state = &mut self.state;
        let mut speeds = [0.0; 2];
        let mut advance = [None; 2];
        for i in 0..2 {
            let wheel = self.observer.step(&state.wheels[i], samples.encoder[i]);
            let radius = self.wheel_radii[i];
            speeds[i] = radius * wheel.speed_rad_s;
            // A missing or impossible count is no measurement: the filter then predicts.
            if samples.encoder[i].is_some() && !wheel.jumped {
                advance[i] = Some(radius * wheel.increment_rad / self.period);
            }
            state.refused = state.refused.saturating_add(u8::from(wheel.jumped));
            state.wheels[i] = wheel;
        }
        let (gyro, accelerometer) = (samples.gyro_rad_s, samples.acceleration_m_s2);
        let motors_on = state.output.active;
        let rest = state
            .rest
            .step(samples.encoder, motors_on, gyro, &self.rest);
        state.gyro_zeroed |= rest.axle;
        let verdicts = self.filter.step(
            &mut state.filter,
            &Measurements {
                left_m_s: advance[0],
                right_m_s: advance[1],
                gyro_rad_s: self.gyro_zero.step(&mut state.gyro_bias, rest.axle, gyro),
                acceleration_m_s2: self.accelerometer_zero.step(
                    &mut state.accelerometer_bias,
                    rest.wheels,
                    accelerometer,
                ),
            },
        );
        let turned = verdicts.gyro == Verdict::Used;
        state.gyro_samples = state.gyro_samples.saturating_add(u8::from(turned));
        for verdict in [
            verdicts.left,
            verdicts.right,
            verdicts.gyro,
            verdicts.accelerometer,
        ] {
            if matches!(verdict, Verdict::Invalid | Verdict::Gated) {
                state.refused = state.refused.saturating_add(1);
            }
        }
        speeds
    }

    fn report(&mut self, now: Micros, outbox: &mut Outbox) {
        let (axle, sequence) = (self.axle, sequence(now));
        let started = self.state.started.unwrap_or(now);
        let epochs = now.saturating_sub(started) / EPOCH;
        let increment = self.state.filter.take_increment();
        let twist = self.state.filter.twist();
        let covariance = increment.covariance;
        outbox.push(Message::AxlePosture {
            axle,
            sequence,
            posture: increment.posture,
        });
        outbox.push(Message::AxleMotion {
            axle,
            sequence,
            velocity_m_s: twist.v,
            yaw_rate_rad_s: twist.omega,
            refused: self.state.refused,
            gyro_samples: self.state.gyro_samples,
            gyro_zeroed: self.state.gyro_zeroed,
            uptime: u8::try_from(epochs).unwrap_or(u8::MAX),
        });
        outbox.push(Message::AxleUncertainty {
            axle,
            sequence,
            covariance,
        });
        self.state.refused = 0;
        self.state.gyro_samples = 0;
        self.state.gyro_zeroed = false;
    }

    fn twist(&self, [left, right]: [f32; 2]) -> Twist {
        match self.speed_source {
            SpeedSource::Wheels => {
                Twist::new(0.5 * (left + right), 0.5 * (right - left) / self.half_track)
            }
            SpeedSource::Filter => self.state.filter.twist(),
        }
    }

    /// The reference moved on from its epoch to `now`; `None` when the motors are to be off.
    fn reference(&self, now: Micros) -> Option<AxleReference> {
        let mode = self.state.mode?;
        let at_epoch = self.state.reference?;
        let fresh =
            mode.age(now) <= self.reference_timeout && at_epoch.age(now) <= self.reference_timeout;
        if !fresh || mode.value == LeadMode::Idle {
            return None;
        }
        let dt = seconds(at_epoch.age(now));
        let AxleReference {
            posture,
            twist,
            acceleration,
        } = at_epoch.value;
        let v = twist.v + acceleration.v * dt;
        let omega = twist.omega + acceleration.omega * dt;
        Some(AxleReference {
            posture: posture.advance(0.5 * (twist.v + v) * dt, 0.5 * (twist.omega + omega) * dt),
            twist: Twist::new(v, omega),
            acceleration,
        })
    }

    /// Load of the frame in pure bending by the commanded steering angle.
    fn reference_load(&self) -> AxleLoad {
        let psi = self.state.steering;
        let wrench =
            Wrench::pure_bending(self.frame.bending_stiffness_n_m2, self.frame.length_m, psi);
        self.load(&wrench, Posture::new(0.0, 0.0, psi.relative_heading().0))
    }

    /// Load of the frame as the beam measured it, if that is fresh.
    fn beam_load(&self, now: Micros) -> Option<AxleLoad> {
        let wrench = self
            .state
            .wrench
            .as_ref()?
            .fresh(now, self.wrench_timeout)?;
        let relative = self
            .state
            .relative
            .as_ref()?
            .fresh(now, self.wrench_timeout)?;
        Some(self.load(wrench, *relative))
    }

    fn load(&self, wrench: &Wrench, relative: Posture) -> AxleLoad {
        // Moments are about the axles' midpoints already, rigid ends included.
        match self.axle {
            AxleId::Front => wrench.on_front(relative, 0.0),
            AxleId::Rear => wrench.on_rear(0.0),
        }
    }
}

impl State {
    /// A posture and a motion of one epoch make a reference.
    fn pair_reference(&mut self, now: Micros) {
        if let (Some((s, posture)), Some((t, twist, acceleration))) =
            (self.pending_posture, self.pending_motion)
            && s == t
        {
            let reference = AxleReference {
                posture,
                twist,
                acceleration,
            };
            self.reference = Some(Stamped::new(reference, epoch_start(now, s)));
        }
    }
}

#[cfg(test)]
mod tests;
