//! Parts of the user in a simulated robot: a kinematic controller, an estimator.
//!
//! A scenario holds functions that make the parts, because trials run in parallel: every trial has parts of its own.
//! The parts run on boards in this process; other boards have the parts of their images.
//!
//! # Example
//!
//! ```
//! use core_algos::control::controller::{ControllerOutput, KinematicController};
//! use core_algos::control::regulator::Input;
//! use host_sim::run::regulate::regulate;
//! use host_sim::scenario::Scenario;
//! use host_sim::scenario::own::Own;
//!
//! /// Drives straight ahead until the robot is beyond the goal.
//! struct Ahead;
//!
//! impl KinematicController for Ahead {
//!     fn step(&mut self, input: &Input) -> ControllerOutput {
//!         let ahead = input.goal.relative_to(input.posture);
//!         ControllerOutput { v: 0.15, kappa: 0.0, done: ahead.x < 0.01 }
//!     }
//! }
//!
//! let mut scenario = Scenario::default();
//! scenario.mission.start = [-0.5, 0.0, 0.0];
//! scenario.own = Own::default().with_controller(|| Ahead);
//! let outcome = regulate(&scenario, 1, 0, |_| ())?;
//! assert!(outcome.end.is_success() && outcome.within);
//! # Ok::<(), host_sim::base::error::Error>(())
//! ```

use crate::base::error::Error;
use core_algos::control::controller::KinematicController;
use core_algos::fusion::estimator::Estimator;
use core_algos::node::lead;
use core_algos::topology::Topology;
use std::fmt;
use std::sync::Arc;

/// Makes a part for one trial.
pub type Factory<T> = Arc<dyn Fn() -> Box<T> + Send + Sync>;

/// Functions that make the user's parts; `None` keeps the built-in part. Equal if they are the same functions.
#[derive(Clone, Default)]
pub struct Own {
    /// Makes the controller that replaces the regulator.
    pub controller: Option<Factory<dyn KinematicController + Send>>,
    /// Makes the estimator whose estimates replace those of the fusion.
    pub estimator: Option<Factory<dyn Estimator + Send>>,
}

impl Own {
    /// Replaces the regulator by the controllers that `make` returns, one a trial.
    #[must_use]
    pub fn with_controller<C: KinematicController + Send + 'static>(
        mut self,
        make: impl Fn() -> C + Send + Sync + 'static,
    ) -> Self {
        self.controller = Some(Arc::new(move || Box::new(make())));
        self
    }

    /// Replaces the estimates of the fusion by those of the estimators that `make` returns, one a trial.
    #[must_use]
    pub fn with_estimator<E: Estimator + Send + 'static>(
        mut self,
        make: impl Fn() -> E + Send + Sync + 'static,
    ) -> Self {
        self.estimator = Some(Arc::new(move || Box::new(make())));
        self
    }

    /// Names of the user's parts.
    pub fn names(&self) -> Vec<&'static str> {
        let parts = [
            ("controller", self.controller.is_some()),
            ("estimator", self.estimator.is_some()),
        ];
        let own = parts.into_iter().filter(|(_, own)| *own);
        own.map(|(name, _)| name).collect()
    }

    /// Refuses the user's parts for boards at `place`, outside of this process.
    pub fn check_outside(&self, place: &str) -> Result<(), Error> {
        match self.names().as_slice() {
            [] => Ok(()),
            names => Err(Error::input(format!(
                "{place}: not with the user's {}: boards outside of this process run the parts of their images \
                 (docs/extending.md)",
                names.join(" and ")
            ))),
        }
    }

    /// Refuses the user's parts on a robot of more than two axles: their inputs are those of one pair.
    pub fn check_axles(&self, robot: Topology) -> Result<(), Error> {
        let axles = robot.axle_count();
        match self.names().as_slice() {
            names if axles > 2 && !names.is_empty() => Err(Error::input(format!(
                "robot.geometry.axles = {axles}: must be 2 with the user's {}",
                names.join(" and ")
            ))),
            _ => Ok(()),
        }
    }

    /// Makes the parts of one trial.
    pub fn make(&self) -> Parts {
        Parts {
            controller: self.controller.as_ref().map(|make| make()),
            estimator: self.estimator.as_ref().map(|make| make()),
        }
    }
}

/// The user's parts in sentences, below a table; empty without such parts.
pub fn remark(own: &Own) -> String {
    let mut text = String::new();
    if own.controller.is_some() {
        text += "controller: the user's, in place of the regulator, for tasks with a goal\n";
    }
    if own.estimator.is_some() {
        text += "estimator: the user's; the named fusion gives the frame odom and the checks of the beam\n";
    }
    text
}

/// The user's parts by name, in a title; empty without such parts.
pub fn title(names: &[impl AsRef<str>]) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    match names.is_empty() {
        true => String::new(),
        false => format!(", user's {}", names.join(" and ")),
    }
}

fn same<T: ?Sized>(one: Option<&Arc<T>>, other: Option<&Arc<T>>) -> bool {
    match (one, other) {
        (Some(one), Some(other)) => Arc::ptr_eq(one, other),
        (None, None) => true,
        _ => false,
    }
}

impl PartialEq for Own {
    fn eq(&self, other: &Self) -> bool {
        same(self.controller.as_ref(), other.controller.as_ref())
            && same(self.estimator.as_ref(), other.estimator.as_ref())
    }
}

impl fmt::Debug for Own {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

/// The user's parts of one trial.
#[derive(Default)]
pub struct Parts {
    controller: Option<Box<dyn KinematicController + Send>>,
    estimator: Option<Box<dyn Estimator + Send>>,
}

impl Parts {
    /// The parts for one step of the lead node.
    pub fn lend(&mut self) -> lead::Own<'_> {
        lead::Own {
            controller: self.controller.as_deref_mut().map(|it| it as _),
            estimator: self.estimator.as_deref_mut().map(|it| it as _),
        }
    }
}
