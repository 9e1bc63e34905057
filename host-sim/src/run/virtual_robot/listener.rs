//! A listener on the bus between the boards: it runs a lead node of its own on what it hears, and so
//! knows what the one on the front board takes the state to be.
//!
//! The lead node's estimate is not on the bus, and a board whose memory is not looked into keeps it to
//! itself. But all that it is made of is there. The listener counts the common time by
//! [`Message::TimeSync`], hands its node what arrived before the lead node's instant, and steps it when
//! the front board's own step shows as [`Message::LeadStatus`]. The two agree unless a message crosses
//! that instant.

use core_algos::bus::{LeadMode, Message};
use core_algos::config::ConfigError;
use core_algos::fusion::Estimate;
use core_algos::node::Outbox;
use core_algos::node::lead::{self, LeadNode, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::time::{EPOCH, LEAD_PHASE, Micros, TICK};
use std::collections::VecDeque;

/// The common time, as far as it can be heard.
#[derive(Clone, Copy, Debug)]
struct Clock {
    /// Beginning of an epoch in the listener's time, µs, and the epoch's number.
    began: Micros,
    epoch: Micros,
    /// Arrival time of that epoch's message.
    heard: Micros,
}

impl Clock {
    /// Common time of an instant.
    fn common(&self, at: Micros) -> Micros {
        (self.epoch * EPOCH + at).saturating_sub(self.began)
    }
}

/// The listener.
pub struct Listener {
    node: LeadNode,
    start: (Estimate, Estimate),
    task: Task,
    clock: Option<Clock>,
    /// Messages not yet given to the node, with the common time of arrival.
    waiting: VecDeque<(Micros, Message)>,
    mode: LeadMode,
    output: lead::Output,
    /// Time of validity of the latest estimates.
    held: Option<Micros>,
}

impl Listener {
    /// A listener whose node has the parameters of the front board. `start` is where that board takes
    /// the robot to be when it begins its `task`: midpoint, and front axle seen from the rear.
    pub fn new(
        config: &RobotConfig,
        start: (Estimate, Estimate),
        task: Task,
    ) -> Result<Self, ConfigError> {
        Ok(Self {
            node: LeadNode::new(config.build_lead()?),
            start,
            task,
            clock: None,
            waiting: VecDeque::new(),
            mode: LeadMode::Idle,
            output: lead::Output::default(),
            held: None,
        })
    }

    /// Latest output of the lead node, recomputed from the bus.
    pub fn output(&self) -> &lead::Output {
        &self.output
    }

    /// Time of validity of the estimates, µs of the listener's time: the beginning of the epoch.
    pub fn held(&self) -> Option<Micros> {
        self.held
    }

    /// A message whose frame ended at `at`, µs.
    pub fn hear(&mut self, at: Micros, message: &Message) {
        if let Message::TimeSync {
            epoch,
            last_delay_us,
        } = *message
        {
            self.synchronise(at, epoch.into(), last_delay_us);
        }
        let Some(clock) = self.clock else {
            return;
        };
        if let Message::LeadStatus { mode, .. } = *message {
            self.held = Some(clock.began);
            self.step(clock.epoch * EPOCH + LEAD_PHASE, mode);
        }
        self.waiting.push_back((clock.common(at), *message));
    }

    fn synchronise(&mut self, at: Micros, epoch: Micros, last_delay_us: Option<u16>) {
        if self.clock.is_some_and(|last| epoch <= last.epoch) {
            // The front board was restarted and counts anew.
            self.waiting.clear();
        }
        let began = match (self.clock, last_delay_us) {
            (Some(last), Some(delay)) if last.epoch + 1 == epoch => {
                last.heard + EPOCH - Micros::from(delay)
            }
            // Until the first delay is told: the message leaves within a fraction of a tick.
            _ => at.saturating_sub(TICK / 4),
        };
        self.clock = Some(Clock {
            began,
            epoch,
            heard: at,
        });
    }

    /// The front board's lead node has stepped at common time `now`, and asks for this of the axles.
    fn step(&mut self, now: Micros, mode: LeadMode) {
        while let Some((arrived, message)) = self.waiting.front()
            && *arrived <= now
        {
            // A board looks at its queue once a tick.
            let tick = arrived.div_ceil(TICK) * TICK;
            self.node.receive(tick, message);
            self.waiting.pop_front();
        }
        let moving = |mode| matches!(mode, LeadMode::Active | LeadMode::Hold);
        if moving(mode) && !moving(self.mode) {
            let (center, relative) = &self.start;
            self.node.initialize(center, relative);
            self.node.command(self.task);
        }
        self.mode = mode;
        self.output = self.node.step(now, &mut Outbox::new());
        self.output.mode = mode;
    }
}
