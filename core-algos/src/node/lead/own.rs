//! Parts of the user in the lead node: a kinematic controller, an estimator.

use super::{Decision, LeadNode, REST_M_S, active_until};
use crate::bus::LeadMode;
use crate::control::cascade::{Cascade, Motion};
use crate::control::controller::{ControllerOutput, KinematicController};
use crate::control::governor::GovernorInput;
use crate::control::regulator::Phase;
use crate::fusion::estimator::Estimator;
use crate::safety::Condition;

/// Parts of the user; `None` keeps the built-in part.
#[derive(Default)]
pub struct Own<'a> {
    /// Replaces the regulator.
    pub controller: Option<&'a mut dyn KinematicController>,
    /// Replaces the estimates of the fusion.
    pub estimator: Option<&'a mut dyn Estimator>,
}

impl LeadNode {
    /// Begins a commanded task in the controller, and starts the estimator from a new placement.
    pub(super) fn begin(&mut self, own: &mut Own<'_>) {
        if let Some(controller) = own.controller.as_deref_mut()
            && !self.state.begun
        {
            controller.begin();
            self.state.begun = true;
        }
        if let Some(estimator) = own.estimator.as_deref_mut()
            && let Some(placement) = self.placement.take()
        {
            estimator.start(&placement.center, &placement.relative);
        }
    }
}

/// Decision by the output of the user's controller. With an output that is not finite, the robot brakes and the task
/// ends without success.
pub(super) fn decision(cascade: &Cascade, output: &ControllerOutput, motion: &Motion) -> Decision {
    if !output.is_finite() {
        return Decision {
            mode: LeadMode::Active,
            phase: Phase::GaveUp,
            failed: Some(Condition::NotANumber),
            ..Decision::default()
        };
    }
    let (v, done) = match output.done {
        true => (0.0, motion.v.abs() < REST_M_S),
        false => (output.v, false),
    };
    Decision {
        governor_input: Some(GovernorInput::from_curvature(cascade, v, output.kappa)),
        mode: active_until(done),
        phase: if done { Phase::Done } else { Phase::Approach },
        done,
        ..Decision::default()
    }
}
