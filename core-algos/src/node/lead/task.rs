//! Tasks of the robot, and its posture at the start.

use crate::control::regulator::Tolerance;
use crate::fusion::Estimate;
use crate::math::Posture;

/// Start posture of the robot with its uncertainty, and the drift of the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Placement {
    /// Posture of the midpoint.
    pub center: Estimate,
    /// Posture of the front axle in the rear axle's frame.
    pub relative: Estimate,
    /// Displacement of the robot by the floor per metre rolled, standard deviation along each of the floor's axes.
    pub floor_drift: f32,
}

/// Largest coordinate of a placement, m: single precision resolves 8 mm there.
const FARTHEST_M: f32 = 1e5;
/// Largest standard deviation of a placement, m and rad.
const WIDEST: f32 = 1e3;

impl Placement {
    /// True if an estimate can start from this placement: every number is finite and within its range, and no variance
    /// is negative.
    pub fn is_sound(&self) -> bool {
        let near = |estimate: &Estimate| {
            let Posture { x, y, phi } = estimate.posture;
            [x, y, phi].iter().all(|part| part.abs() <= FARTHEST_M)
        };
        let known = |estimate: &Estimate| {
            let p = &estimate.covariance;
            let variances = [0, 1, 2].map(|i| p[i][i]);
            let bounded = p.iter().flatten().all(|part| part.abs() <= WIDEST * WIDEST);
            bounded && variances.iter().all(|&variance| variance >= 0.0)
        };
        let estimates = [&self.center, &self.relative];
        estimates.into_iter().all(|one| near(one) && known(one))
            && (0.0..=1.0).contains(&self.floor_drift)
    }
}

/// Task of the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Task {
    /// Motors off.
    #[default]
    Idle,
    /// Brake and hold.
    Stop,
    /// Motors off; clear latched faults whose causes are gone.
    Clear,
    /// Bring the midpoint to a posture and to rest.
    Regulate {
        /// Goal posture of the midpoint O.
        goal: Posture,
        /// Tolerance of the goal.
        within: Tolerance,
    },
    /// Follow the path in the node's buffer from its beginning (see
    /// [`LeadNode::path_task`](super::LeadNode::path_task)), and rest at its end.
    Follow {
        /// Tolerance of the posture at the end of the path.
        within: Tolerance,
    },
    /// Track the trajectory in the node's buffer, beginning now, and rest at its end.
    Track {
        /// Tolerance of the posture at the end of the trajectory.
        within: Tolerance,
    },
    /// Drive with this speed and curvature. The robot stops if the task is not given again within
    /// [`DEAD_MAN`](super::DEAD_MAN).
    Drive {
        /// Speed of O, m/s.
        speed_m_s: f32,
        /// Curvature of the path of O, 1/m.
        curvature: f32,
    },
}

impl Task {
    /// Path following with the default tolerance.
    pub fn follow() -> Self {
        Self::Follow {
            within: Tolerance::default(),
        }
    }

    /// Trajectory tracking with the default tolerance.
    pub fn track() -> Self {
        Self::Track {
            within: Tolerance::default(),
        }
    }

    /// True for path following and trajectory tracking.
    pub fn is_on_path(&self) -> bool {
        matches!(self, Self::Follow { .. } | Self::Track { .. })
    }

    /// Tolerance of the task; the default for tasks without a tolerance.
    pub fn within(&self) -> Tolerance {
        match *self {
            Self::Regulate { within, .. } | Self::Follow { within } | Self::Track { within } => {
                within
            }
            _ => Tolerance::default(),
        }
    }

    /// Regulation with the default tolerance.
    pub fn regulate(goal: Posture) -> Self {
        Self::Regulate {
            goal,
            within: Tolerance::default(),
        }
    }
}

/// Activity of the robot, for its button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Stopped by a fault that [`Task::Clear`] has to clear.
    Faulted,
    /// Under way with a task.
    Busy,
    /// No task, or the task has ended.
    Resting,
}
