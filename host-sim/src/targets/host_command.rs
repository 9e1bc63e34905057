//! Commands of the host to the lead node.

use core_algos::control::path::{PathPoint, TrajectoryPoint};
use core_algos::node::lead::Task;
use serde::{Deserialize, Serialize};

/// Command to the lead node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostCommand {
    /// Task.
    Task(Task),
    /// More of the path, no more than there is room for; true if it ends there.
    Path(Vec<PathPoint>, bool),
    /// More of the trajectory, no more than there is room for; true if it ends there.
    Trajectory(Vec<TrajectoryPoint>, bool),
}
