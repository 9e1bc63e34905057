//! Nodes without a board.

use super::frame::Frame;
use super::node::{Action, Event, EventKind, Node, Settings};
use crate::time::Time;
use std::collections::VecDeque;

/// Number of mailboxes of a virtual node.
const MAILBOXES: u8 = 3;

/// A controller without a board that sends the frames given to it.
#[derive(Clone)]
pub struct VirtualNode {
    actions: VecDeque<(Time, Action)>,
    waiting: VecDeque<(Time, Frame)>,
    free: Vec<u8>,
    babble: Option<Frame>,
}

impl VirtualNode {
    /// A controller with these settings, on the bus from the start.
    pub fn new(settings: Settings) -> Self {
        Self {
            actions: VecDeque::from([(Time(0), Action::Set(settings))]),
            waiting: VecDeque::new(),
            free: (0..MAILBOXES).rev().collect(),
            babble: None,
        }
    }

    /// Sends a frame at this time or later. Frames are sent in the order given.
    pub fn send(&mut self, at: Time, frame: Frame) {
        self.waiting.push_back((at, frame));
    }

    /// Sends a frame continuously, as often as the bus allows; `None` stops that.
    pub fn babble(&mut self, frame: Option<Frame>) {
        self.babble = frame;
    }
}

impl Node for VirtualNode {
    fn take_action(&mut self) -> Option<(Time, Action)> {
        if let Some(action) = self.actions.pop_front() {
            return Some(action);
        }
        let mailbox = *self.free.last()?;
        let (at, frame) = match self.waiting.pop_front() {
            Some(next) => next,
            None => (Time(0), self.babble?),
        };
        self.free.pop();
        Some((at, Action::Request { mailbox, frame }))
    }

    fn event(&mut self, event: Event) {
        match event.kind {
            EventKind::Failed { again: true, .. } => {}
            EventKind::Sent { mailbox, .. } | EventKind::Failed { mailbox, .. } => {
                self.free.push(mailbox)
            }
            _ => {}
        }
    }
}
