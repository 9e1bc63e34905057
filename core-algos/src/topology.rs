//! Boards, nodes, axles and wheels of the robot.

use core::ops::{Index, IndexMut};

/// One of the two axles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum AxleId {
    /// Axle 1, at the tip of the frame.
    Front,
    /// Axle 2, at the root of the frame.
    Rear,
}

impl AxleId {
    /// Both axles, front first.
    pub const BOTH: [Self; 2] = [Self::Front, Self::Rear];

    /// 0 for the front axle, 1 for the rear.
    pub const fn index(self) -> usize {
        match self {
            Self::Front => 0,
            Self::Rear => 1,
        }
    }
}

/// Side of an axle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Left, seen along the heading.
    Left,
    /// Right.
    Right,
}

impl Side {
    /// Left, then right.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// A quantity of each wheel of an axle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wheels<T> {
    /// Of the left wheel.
    pub left: T,
    /// Of the right wheel.
    pub right: T,
}

impl<T> Wheels<T> {
    /// The same for both wheels.
    pub const fn both(value: T) -> Self
    where
        T: Copy,
    {
        Self {
            left: value,
            right: value,
        }
    }

    /// The result of a function for each wheel, left first.
    pub fn map<U>(self, mut function: impl FnMut(T) -> U) -> Wheels<U> {
        Wheels {
            left: function(self.left),
            right: function(self.right),
        }
    }

    /// Left, then right.
    pub fn list(self) -> [T; 2] {
        [self.left, self.right]
    }
}

impl<T> Index<Side> for Wheels<T> {
    type Output = T;

    fn index(&self, side: Side) -> &T {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }
}

impl<T> IndexMut<Side> for Wheels<T> {
    fn index_mut(&mut self, side: Side) -> &mut T {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }
}

impl<T> From<[T; 2]> for Wheels<T> {
    /// From left and right.
    fn from([left, right]: [T; 2]) -> Self {
        Self { left, right }
    }
}

/// A board of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Role {
    /// Front axle and lead node.
    Front,
    /// Rear axle.
    Rear,
    /// Instrumented frame.
    Beam,
}

impl Role {
    /// All boards of a robot, in the order their messages enter the simulated bus.
    pub const ALL: [Self; 3] = [Self::Front, Self::Rear, Self::Beam];

    /// Name in lower case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Rear => "rear",
            Self::Beam => "beam",
        }
    }
}

enumeration! {
    /// A node of the robot. The bus description has the names.
    Node {
        /// Central node, on the front board.
        Lead,
        /// Front axle board.
        FrontAxle,
        /// Rear axle board.
        RearAxle,
        /// Beam board.
        Beam,
        /// A person's tool on the bus; not part of a running robot.
        Service,
    }
}

impl Node {
    /// Board of the node; a service tool has none.
    pub const fn board(self) -> Option<Role> {
        match self {
            Self::Lead | Self::FrontAxle => Some(Role::Front),
            Self::RearAxle => Some(Role::Rear),
            Self::Beam => Some(Role::Beam),
            Self::Service => None,
        }
    }
}
