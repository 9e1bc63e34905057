//! Messages of other nodes, for tests.

use crate::bus::{LeadMode, Message};
use crate::math::Posture;
use crate::safety::{Conditions, OperatingState};
use crate::time::{Micros, sequence};
use crate::topology::{AxleId, Node};

/// A heartbeat without notices.
pub(crate) fn beat(node: Node, now: Micros, state: OperatingState, reason: u8) -> Message {
    Message::NodeStatus {
        node,
        sequence: sequence(now),
        state,
        reason,
        notices: Conditions::NONE,
    }
}

/// Status of a lead node whose frame is straight.
pub(crate) fn lead_status(now: Micros, mode: LeadMode, velocity_m_s: f32) -> Message {
    Message::LeadStatus {
        sequence: sequence(now),
        mode,
        steering_rad: 0.0,
        velocity_m_s,
    }
}

/// Reference posture of an axle.
pub(crate) fn reference_posture(axle: AxleId, now: Micros, posture: Posture) -> Message {
    Message::ReferencePosture {
        axle,
        sequence: sequence(now),
        posture,
    }
}

/// The report of an axle that has been up for `uptime` epochs. A gyro is there if it says whether it
/// was zeroed.
pub(crate) fn axle_report(
    axle: AxleId,
    now: Micros,
    posture: Posture,
    uptime: u8,
    gyro_zeroed: Option<bool>,
) -> [Message; 2] {
    let sequence = sequence(now);
    [
        Message::AxlePosture {
            axle,
            sequence,
            posture,
        },
        Message::AxleMotion {
            axle,
            sequence,
            velocity_m_s: 0.0,
            yaw_rate_rad_s: 0.0,
            refused: 0,
            gyro_samples: if gyro_zeroed.is_some() { 10 } else { 0 },
            gyro_zeroed: gyro_zeroed.unwrap_or(false),
            uptime,
        },
    ]
}
