//! Axle node: encoders and inertial sensors in, wheel torques out, once a millisecond.
//!
//! The step reads in the order of the data: wheels → zeroing → filter → report → supervision → reference → control.
//! The posture is odometric, in a frame that begins where the axle was started; its position is kept modulo the span
//! of positions on the bus. The lead node estimates where that frame lies and sends references in it, so a correction
//! of the global estimate never makes the controller jump.
//!
//! # Panic contract
//!
//! [`Config::build`] validates; nothing else can fail. Without a fresh reference the axle brakes by
//! itself, along the path it is on, and switches its motors off; with any number that is not finite
//! the torques are zero at once.

mod backlash;
mod config;
mod watch;

use backlash::Backlash;
pub use config::{Config, FrameProperties, Limits, SpeedSource};

use super::Outbox;
use super::peers::{self, Peers};
use crate::acquisition::icm42688::DELAY_S;
use crate::bus::field::wrap_position;
use crate::bus::{LeadMode, Message, layout};
use crate::control::cascade::AxleReference;
use crate::control::disturbance::Observer;
use crate::control::dynamic::{self, Dynamic};
use crate::control::wheel_observer::{self, WheelObserver};
use crate::fusion::ekf::{self, AxleFilter, Measurements, Verdict};
use crate::fusion::standstill::{Bias, RestDetector, RestTimes, Zeroing};
use crate::math::matrix::{Mat3, add, scale};
use crate::math::{AxleLoad, Posture, Steering, Twist, Wrench};
use crate::safety::supervisor::{self, Supervisor};
use crate::safety::{Conditions, Permit, ramp};
use crate::time::{
    EPOCH, Micros, Stamped, TICK, epoch_start, is_epoch_start, seconds, sequence, share_of_epoch,
};
use crate::topology::{AxleId, FrameId, Node, Topology, Wheels};

/// Age above which a reference is late: the lead node and the bus have had two epochs for it.
const LATE: Micros = 3 * EPOCH;

/// Readings of an axle board's sensors at a tick; `None` where a reading is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Samples {
    /// Encoder counts; they wrap.
    pub encoder: Wheels<Option<i32>>,
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
    /// Conditions found by the board's drivers: motors, supply, temperature, bus, time.
    pub conditions: Conditions,
}

/// Output of the node at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Wheel torques, N m; positive drives forward.
    pub torque_nm: Wheels<f32>,
    /// True if a reference is being followed; otherwise the motors are off.
    pub active: bool,
    /// Tracking error (e_X, e_Y, e_φ) in the axle's coordinates; zero when not active.
    pub error: Posture,
    /// True if a computed value was not finite.
    pub invalid: bool,
    /// True if the controller requests more torque than the motors give.
    pub limited: bool,
}

/// Progress of a coordinated stop.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stop {
    ramp: ramp::State,
    /// Share of the holding torque that is still allowed.
    hold: f32,
    /// Larger of the two wheel torques when the release began, N m.
    held_nm: f32,
}

impl Stop {
    /// Bounds the torques during the release and keeps their ratio.
    fn bound_release(&mut self, torque_nm: &mut Wheels<f32>) {
        let largest = torque_nm.left.abs().max(torque_nm.right.abs());
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

/// What an axle node keeps from one tick to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Time of the first step; `None` before it.
    started: Option<Micros>,
    wheels: [wheel_observer::State; 2],
    filter: ekf::State,
    rest: RestDetector,
    gyro_bias: Bias,
    /// The gyro's last reading less its bias, rad/s.
    gyro: Option<f32>,
    accelerometer_bias: Bias,
    /// Output of the last step.
    output: Output,
    /// Reference that the axle followed in the last step; `None` if it followed none.
    followed: Option<AxleReference>,
    /// Curvature of the path of the references, 1/m; at rest, the latest.
    curvature: f32,
    /// Force of the ground along the heading, as the disturbance observer estimates it, N; zero while no reference is
    /// followed.
    ground_force_n: f32,
    /// Coordinated stop under way; `None` outside of a stop.
    stop: Option<Stop>,
    /// True if the coordinated stop is over.
    halted: bool,
    peers: Peers,
    supervisor: supervisor::State,
    /// Backlash of the gears, left and right.
    backlash: [Backlash; 2],
    refused: u8,
    gyro_samples: u8,
    gyro_zeroed: bool,
    /// Sum of the covariances that are not reported, and number of their epochs.
    unreported: (Mat3, u8),
    mode: Option<Stamped<LeadMode>>,
    /// True once the lead node has sent the mode idle or clear since this node's start.
    paused: bool,
    steering: Steering,
    velocity: f32,
    pending_posture: Option<Stamped<Posture>>,
    pending_motion: Option<Stamped<[Twist; 2]>>,
    reference: Option<Stamped<AxleReference>>,
    behind: Frame,
    ahead: Frame,
}

/// Latest wrench of a frame and latest posture of its tip, as its beam board sent them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Frame {
    wrench: Option<Stamped<Wrench>>,
    relative: Option<Stamped<Posture>>,
}

/// The frames that are joined to an axle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Neighbours {
    behind: Option<FrameId>,
    ahead: Option<FrameId>,
}

/// Node of one axle: estimates the axle's motion and computes the wheel torques that follow the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxleNode {
    axle: AxleId,
    topology: Topology,
    frames: Neighbours,
    frame: FrameProperties,
    reference_timeout: Micros,
    wrench_timeout: Micros,
    speed_source: SpeedSource,
    /// Mean radius of both wheels, m.
    wheel_radius: f32,
    /// Radius of the left and the right wheel, m.
    wheel_radii: [f32; 2],
    half_track: f32,
    period: f32,
    /// Thresholds of rest; times in ticks.
    rest: RestTimes,
    gyro_zero: Zeroing,
    accelerometer_zero: Zeroing,
    observer: WheelObserver,
    filter: AxleFilter,
    controller: Dynamic,
    disturbance: Observer,
    limits: Limits,
    /// Torque from which a wheel at standstill counts as stalled, N m.
    stall_torque: f32,
    ramp: ramp::Ramp,
    supervisor: Supervisor,
    state: State,
}

/// Speed of a reference above which its yaw rate gives the curvature of its path, m/s.
const CURVED_M_S: f32 = 0.01;

/// Wheel speed above which an axle counts as driven during the release after a stop, rad/s.
const LET_GO_RAD_S: f32 = 5.0;

impl AxleNode {
    /// Resets the node to its state after construction.
    pub fn restart(&mut self) {
        self.state = State::default();
    }

    /// Axle of this node.
    pub fn axle(&self) -> AxleId {
        self.axle
    }

    /// Estimates, latest messages and operating state of the node.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Operating state of the axle, and its reason.
    pub fn supervision(&self) -> &supervisor::State {
        &self.state.supervisor
    }

    /// True if the lead node requests to clear faults; the board's drivers then clear theirs too.
    pub fn clears(&self, now: Micros) -> bool {
        let mode = self.state.mode.as_ref();
        mode.and_then(|mode| mode.fresh(now, self.reference_timeout)) == Some(&LeadMode::Clear)
    }

    /// Takes in a message that arrived at `now`. Messages for other nodes are ignored.
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
                state.pending_posture = Some(Stamped::new(posture, epoch_start(now, sequence)));
                state.pair_reference();
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
                    let motion = [twist, acceleration];
                    state.pending_motion = Some(Stamped::new(motion, epoch_start(now, sequence)));
                    state.pair_reference();
                }
            }
            Message::BeamWrench {
                frame,
                sequence,
                wrench,
            } => {
                if let Some(bent) = state.frame(frame, &self.frames) {
                    bent.wrench = Some(Stamped::new(wrench, epoch_start(now, sequence)));
                }
            }
            Message::BeamPosture {
                frame,
                sequence,
                posture,
                gauges,
            } if gauges > 0 => {
                if let Some(bent) = state.frame(frame, &self.frames) {
                    bent.relative = Some(Stamped::new(posture, epoch_start(now, sequence)));
                }
            }
            _ => {}
        }
    }

    /// Runs one tick at `now`. Reports go to `outbox` at the beginning of an epoch.
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
        if let Some(AxleReference { twist, .. }) = reference
            && twist.v.abs() > CURVED_M_S
        {
            self.state.curvature = twist.omega / twist.v;
        }
        (self.state.output, self.state.ground_force_n) = reference
            .map(|reference| self.control(now, speeds, reference))
            .unwrap_or_default();
        if let Some(stop) = &mut self.state.stop {
            stop.bound_release(&mut self.state.output.torque_nm);
        }
        self.state.output
    }

    /// Identity of this node.
    fn node(&self) -> Node {
        Node::Axle(self.axle)
    }

    /// Permit of the motors at this tick; sends the heartbeat.
    fn supervise(&mut self, now: Micros, samples: &Samples, outbox: &mut Outbox) -> Permit {
        let mut input = supervisor::Input {
            conditions: self.watch(now, samples),
            halted: self.state.halted,
            ..supervisor::Input::default()
        };
        let before = self.state.supervisor.operating();
        let mut permit = Permit::Off;
        // Up to three requests in one tick, so that an axle at rest drives at once: ready, arm, start.
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

    /// The reference of the coordinated stop at this tick.
    fn brake(&mut self) -> AxleReference {
        let state = &mut self.state;
        let ramp = &self.ramp;
        let (velocity, steering, length) = (state.velocity, state.steering, self.frame.length_m);
        let many = self.topology.axle_count() > 2;
        let stop = state.stop.get_or_insert_with(|| Stop {
            ramp: match state.followed {
                // Each axle is on its own circle: the frames bend differently.
                Some(reference) if many => {
                    ramp.begin_on_circle(reference.posture, velocity, reference.twist)
                }
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

    /// Torques that follow the reference, and the force of the ground estimated for the next tick, N.
    fn control(
        &self,
        now: Micros,
        speeds: [f32; 2],
        mut reference: AxleReference,
    ) -> (Output, f32) {
        let posture = self.state.filter.posture();
        // Positions on the bus repeat after a span. The reference means the equivalent position that is nearest to the
        // axle.
        let to = &mut reference.posture;
        to.x = posture.x + wrap_position(to.x - posture.x);
        to.y = posture.y + wrap_position(to.y - posture.y);
        let input = dynamic::Input {
            posture,
            twist: self.twist(speeds),
            reference,
            reference_load: self.reference_load(now),
            beam_load: self.beam_load(now),
            ground_force_n: self.state.ground_force_n,
        };
        let command = self.controller.step(&input);
        // A reference too far away gives zero torque. If it lasts, it becomes a fault.
        let near = self.limits.near(command.error, 2.0);
        let (torque_nm, ground_force_n) = if near {
            let force = self.disturbance.step(&input, &command);
            (command.torque_nm, force)
        } else {
            (Wheels::default(), 0.0)
        };
        let output = Output {
            torque_nm,
            active: command.valid,
            error: command.error,
            invalid: !command.valid,
            limited: command.scale < 1.0,
        };
        (output, ground_force_n)
    }

    /// Runs wheel observers and filter; returns the wheels' speeds over ground, m/s.
    fn estimate(&mut self, samples: &Samples) -> [f32; 2] {
        let state = &mut self.state;
        let mut speeds = [0.0; 2];
        let mut advance = [None; 2];
        for (i, count) in samples.encoder.list().into_iter().enumerate() {
            let wheel = self.observer.step(&state.wheels[i], count);
            let radius = self.wheel_radii[i];
            speeds[i] = radius * wheel.speed_rad_s;
            // A missing or impossible count is no measurement, so the filter only predicts.
            if count.is_some() && !wheel.jumped {
                advance[i] = Some(radius * wheel.increment_rad / self.period);
            }
            state.refused = state.refused.saturating_add(u8::from(wheel.jumped));
            state.wheels[i] = wheel;
        }
        for (backlash, torque) in state.backlash.iter_mut().zip(state.output.torque_nm.list()) {
            backlash.step(torque);
        }
        let (gyro, accelerometer) = (samples.gyro_rad_s, samples.acceleration_m_s2);
        let motors_on = state.output.active;
        let rest = state
            .rest
            .step(samples.encoder, motors_on, gyro, &self.rest);
        state.gyro_zeroed |= rest.axle;
        let turning = self.gyro_zero.step(&mut state.gyro_bias, rest.axle, gyro);
        // The gyro's reading is late and the beam's is not, so the missing part of a turn would look like a scale error
        // of the gyro. The reading is therefore extrapolated.
        let late = DELAY_S / self.period;
        let now = match (turning, state.gyro) {
            (Some(turning), Some(before)) => Some(turning + late * (turning - before)),
            _ => turning,
        };
        state.gyro = turning.filter(|turning| turning.is_finite());
        let verdicts = self.filter.step(
            &mut state.filter,
            &Measurements {
                left_m_s: advance[0],
                right_m_s: advance[1],
                gyro_rad_s: now,
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
        let own = self.state.filter.posture();
        self.state
            .filter
            .shift([own.x, own.y].map(|x| wrap_position(x) - x));
        let increment = self.state.filter.take_increment();
        let twist = self.state.filter.twist();
        let wheels_share = 1.0 - share_of_epoch(self.state.gyro_samples);
        let [left, right] = self.state.backlash.each_mut().map(Backlash::take_variance);
        let covariance = backlash::add(
            increment.covariance,
            [left, right],
            self.half_track,
            wheels_share,
        );
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
        let epochs = layout::uncertainty_epochs(self.topology);
        if epochs == 1 {
            outbox.push(Message::AxleUncertainty {
                axle,
                sequence,
                covariance,
            });
        } else {
            self.report_mean(sequence, &covariance, epochs, outbox);
        }
        self.state.refused = 0;
        self.state.gyro_samples = 0;
        self.state.gyro_zeroed = false;
    }

    /// Sends the mean covariance of the epochs since the latest report of it, every `epochs` epochs.
    fn report_mean(&mut self, sequence: u8, of_epoch: &Mat3, epochs: u8, outbox: &mut Outbox) {
        let (sum, count) = &mut self.state.unreported;
        (*sum, *count) = (add(sum, of_epoch), count.saturating_add(1));
        if layout::is_uncertainty_due(epochs, sequence, self.axle.0) {
            outbox.push(Message::AxleUncertainty {
                axle: self.axle,
                sequence,
                covariance: scale(sum, 1.0 / f32::from(*count)),
            });
            self.state.unreported = Default::default();
        }
    }

    fn twist(&self, [left, right]: [f32; 2]) -> Twist {
        match self.speed_source {
            SpeedSource::Wheels => {
                Twist::new(0.5 * (left + right), 0.5 * (right - left) / self.half_track)
            }
            SpeedSource::Filter => self.state.filter.twist(),
        }
    }

    /// The reference extrapolated from its epoch to `now`; `None` if the reference or the mode is missing or too old,
    /// or the mode is idle.
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

    /// Load of the frames: in pure bending by the commanded steering angle; of a robot of three and more axles, whose
    /// frames bend differently, by [`Self::bend_load`].
    fn reference_load(&self, now: Micros) -> AxleLoad {
        if self.topology.axle_count() > 2 {
            return self.bend_load(now);
        }
        let psi = self.state.steering;
        let wrench =
            Wrench::pure_bending(self.frame.bending_stiffness_n_m2, self.frame.length_m, psi);
        let relative = Posture::new(0.0, 0.0, psi.relative_heading().0);
        let bent = |_: &Frame| Some((wrench, relative));
        self.load(bent).unwrap_or_default()
    }

    /// Load of the frames in their measured bend, without axial force. The measured wrench itself would be a positive
    /// feedback that holds an axial force. A frame without a fresh posture counts as bent to the curvature of the axle's
    /// own reference: the other axle of the frame drives on the same curve.
    fn bend_load(&self, now: Micros) -> AxleLoad {
        let FrameProperties {
            bending_stiffness_n_m2,
            length_m,
            rigid_end_m,
        } = self.frame;
        let bent = |frame: &Frame| {
            let relative = frame.relative.as_ref();
            match relative.and_then(|it| it.fresh(now, self.wrench_timeout)) {
                Some(&relative) => {
                    let wrench =
                        Wrench::cubic(bending_stiffness_n_m2, length_m, rigid_end_m, relative);
                    (wrench, relative)
                }
                None => {
                    let psi = Steering(0.5 * length_m * self.state.curvature);
                    let wrench = Wrench::pure_bending(bending_stiffness_n_m2, length_m, psi);
                    (wrench, Posture::new(0.0, 0.0, psi.relative_heading().0))
                }
            }
        };
        let mut load = AxleLoad::default();
        if self.frames.behind.is_some() {
            let (wrench, relative) = bent(&self.state.behind);
            load = load.plus(wrench.on_front(relative, rigid_end_m));
        }
        if self.frames.ahead.is_some() {
            load = load.plus(bent(&self.state.ahead).0.on_rear(rigid_end_m));
        }
        load
    }

    /// Load of the frames as measured by their boards; `None` unless every measurement is fresh.
    fn beam_load(&self, now: Micros) -> Option<AxleLoad> {
        self.load(|frame| {
            let wrench = frame.wrench.as_ref()?.fresh(now, self.wrench_timeout)?;
            let relative = frame.relative.as_ref()?.fresh(now, self.wrench_timeout)?;
            Some((*wrench, *relative))
        })
    }

    /// Load of the frame behind, whose tip is at the axle, and of the frame ahead, whose root is at the axle. `bent`
    /// gives wrench and posture of each.
    fn load(&self, bent: impl Fn(&Frame) -> Option<(Wrench, Posture)>) -> Option<AxleLoad> {
        // The beam boards send moments about the axles' midpoints, so the lever arm of a rigid end is 0 here.
        let behind = || {
            let (wrench, relative) = bent(&self.state.behind)?;
            Some(wrench.on_front(relative, 0.0))
        };
        let ahead = || Some(bent(&self.state.ahead)?.0.on_rear(0.0));
        match (self.frames.behind, self.frames.ahead) {
            (Some(_), None) => behind(),
            (None, Some(_)) => ahead(),
            (Some(_), Some(_)) => Some(behind()?.plus(ahead()?)),
            (None, None) => None,
        }
    }
}

impl State {
    /// Wrench and posture of a frame at this axle; `None` for a frame that is not at this axle.
    fn frame(&mut self, frame: FrameId, at: &Neighbours) -> Option<&mut Frame> {
        match Some(frame) {
            frame if frame == at.behind => Some(&mut self.behind),
            frame if frame == at.ahead => Some(&mut self.ahead),
            _ => None,
        }
    }

    /// Combines posture and motion of one epoch into a reference. Compares their times, because sequence numbers
    /// repeat after 2.56 s.
    fn pair_reference(&mut self) {
        if let (Some(posture), Some(motion)) = (self.pending_posture, self.pending_motion)
            && posture.time == motion.time
        {
            let [twist, acceleration] = motion.value;
            let reference = AxleReference {
                posture: posture.value,
                twist,
                acceleration,
            };
            self.reference = Some(Stamped::new(reference, posture.time));
        }
    }
}

#[cfg(test)]
mod tests;
