//! Step of a lead node with three or more axles: every axle drives on the curve of the [`train`](crate::control::train).
//!
//! The curve lies in the frame `odom`. An axle's estimate is seen from O in `map`, and O stands at its posture in
//! `odom`; so a jump of the estimate in `map` moves no axle against its reference.

use core::array::from_fn;

use super::fused::Fused;
use super::{Decision, LeadNode, Output, REST_M_S, Task, active_until};
use crate::bus::LeadMode;
use crate::control::cascade::{AxleReference, Motion};
use crate::control::regulator::Phase;
use crate::control::train::{self, Train};
use crate::math::Posture;
use crate::node::Outbox;
use crate::node::path_task::{PATH_POINTS, TRAJECTORY_POINTS};
use crate::safety::{Condition, Permit, supervisor};
use crate::time::{Micros, epoch_start, sequence};
use crate::topology::MAX_AXLES;

/// Task of the train with the buffers of the path task.
type TrainTask<'a> = train::Task<'a, PATH_POINTS, TRAJECTORY_POINTS>;

/// What a step of the train decides.
struct Course {
    decision: Decision,
    step: train::Step,
}

impl LeadNode {
    /// A step with a permit to drive.
    pub(super) fn step_train(
        &mut self,
        now: Micros,
        train: &Train,
        fused: &Fused,
        supervision: supervisor::Output,
        outbox: &mut Outbox,
    ) -> Output {
        let map = fused.robot().posture;
        let odom = self.state.odom.unwrap_or(map);
        let between =
            |posture: Posture, from: Posture, to: Posture| to.compose(posture.relative_to(from));
        let axles = from_fn(|k| between(fused.axle(k), map, odom));
        let Course { decision, step } = match supervision.permit {
            // Before it drives the robot holds still, so that a swinging frame comes to rest.
            Permit::Hold if !self.state.is_over() => {
                let step = self.stop_train(train, &axles);
                let decision = Decision {
                    mode: LeadMode::Hold,
                    ..Decision::default()
                };
                Course { decision, step }
            }
            _ if self.state.failed.is_some() => {
                let decision = self.give_up();
                let step = self.stop_train(train, &axles);
                Course { decision, step }
            }
            _ => {
                let course = self.decide_train(now, train, &axles);
                let decision = self.at_end(course.decision, map);
                Course { decision, ..course }
            }
        };
        self.state.governor.motion = Motion {
            v: step.v,
            v_rate: step.v_rate,
            psi: self.with.cascade.steering(step.kappa),
            ..Motion::default()
        };
        let references = step.references.map(|reference| AxleReference {
            posture: between(reference.posture, odom, map),
            ..reference
        });
        self.send_references(now, decision.mode, &references, fused, outbox);
        self.conclude(&decision, fused, supervision)
    }

    /// A step that brakes along the curve.
    fn stop_train(&mut self, train: &Train, axles: &[Posture; MAX_AXLES]) -> train::Step {
        train.step(&mut self.train, axles, TrainTask::Stop)
    }

    /// Motion and mode that the task demands with the axles at `axles` in `odom`.
    fn decide_train(&mut self, now: Micros, train: &Train, axles: &[Posture; MAX_AXLES]) -> Course {
        let slow = |step: &train::Step| step.v.abs() < REST_M_S;
        match self.state.task {
            Task::Idle | Task::Clear => Course {
                decision: Decision::default(),
                step: self.stop_train(train, axles),
            },
            Task::Stop => {
                let step = self.stop_train(train, axles);
                let done = slow(&step);
                let decision = Decision {
                    mode: active_until(done),
                    done,
                    ..Decision::default()
                };
                Course { decision, step }
            }
            Task::Drive {
                speed_m_s,
                curvature,
            } => {
                let alive = !self.state.is_silent();
                let task = match alive {
                    true => TrainTask::Drive {
                        speed_m_s,
                        curvature,
                    },
                    false => TrainTask::Stop,
                };
                let step = train.step(&mut self.train, axles, task);
                let done = !alive && slow(&step);
                let decision = Decision {
                    mode: active_until(done),
                    done,
                    ..Decision::default()
                };
                Course { decision, step }
            }
            Task::Regulate { goal, within } => {
                let task = TrainTask::Regulate { goal, within };
                let step = train.step(&mut self.train, axles, task);
                let reason = match self.train.is_blocked() {
                    true => Condition::NoProgress,
                    false => Condition::GaveUp,
                };
                let decision = Decision {
                    mode: active_until(step.done),
                    phase: step.phase,
                    done: step.done,
                    failed: (step.phase == Phase::GaveUp).then_some(reason),
                    ..Decision::default()
                };
                Course { decision, step }
            }
            Task::Follow { within } => {
                let (path, _) = self.path_task.buffers();
                let empty = path.is_empty();
                let task = TrainTask::Follow { path, within };
                let step = train.step(&mut self.train, axles, task);
                self.on_path(step, empty)
            }
            Task::Track { within } => {
                let time_s = self.path_task.time(epoch_start(now, sequence(now)));
                let (_, trajectory) = self.path_task.buffers();
                let empty = trajectory.is_empty();
                let task = TrainTask::Track {
                    trajectory,
                    time_s,
                    within,
                };
                let step = train.step(&mut self.train, axles, task);
                self.path_task.discard_before(time_s);
                self.on_path(step, empty)
            }
        }
    }

    /// Decision of a step on a path or trajectory, which has no point if it is `empty`.
    fn on_path(&mut self, step: train::Step, empty: bool) -> Course {
        self.path_task.set_end(step.done, step.lost);
        let decision = Decision {
            mode: active_until(step.done),
            target: (!empty).then_some(step.target),
            done: step.done,
            failed: step.stuck.then_some(Condition::NoProgress),
            ..Decision::default()
        };
        Course { decision, step }
    }
}
