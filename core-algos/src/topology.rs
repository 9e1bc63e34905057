//! Axles, frames, boards, nodes and wheels of the robot.
//!
//! Axles count from 0 at the front. A frame joins two neighbouring axles: frame 0 has axle 0 at its tip and axle 1 at
//! its root. Each axle has a board, and so has each frame. The lead node runs on the board of axle 0.

#[cfg(feature = "serde")]
mod names;

use core::ops::{Index, IndexMut};

/// Largest number of axles of a robot.
pub const MAX_AXLES: usize = 5;
/// Largest number of frames of a robot.
pub const MAX_FRAMES: usize = MAX_AXLES - 1;
/// Largest number of boards of a robot.
pub const MAX_BOARDS: usize = MAX_AXLES + MAX_FRAMES;

/// Number of an axle, 0 at the front.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxleId(pub u8);

impl AxleId {
    /// The number as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Number of a frame, 0 at the front.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FrameId(pub u8);

impl FrameId {
    /// True for the frame behind the first axle, the only one of a robot of two axles.
    pub const fn is_first(&self) -> bool {
        self.0 == 0
    }

    /// The number as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Side of an axle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Left, seen along the heading.
    Left,
    /// Right, seen along the heading.
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
    /// Left wheel's value.
    pub left: T,
    /// Right wheel's value.
    pub right: T,
}

impl<T> Wheels<T> {
    /// One value for both wheels.
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

    /// Values of the left wheel, then the right wheel.
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
    /// Quantity of each wheel from the values of the left and the right wheel.
    fn from([left, right]: [T; 2]) -> Self {
        Self { left, right }
    }
}

/// Role of a board: the axle or frame that it serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Board of an axle.
    Axle(AxleId),
    /// Board of an instrumented frame.
    Beam(FrameId),
}

impl Role {
    /// The board with the lead node.
    pub const LEAD: Self = Self::axle(0);

    /// The boards of a robot of two axles, in the order of [`Topology::boards`].
    pub const PAIR: [Self; 3] = [Self::axle(0), Self::axle(1), Self::beam(0)];

    /// Board of the axle with this number.
    pub const fn axle(number: u8) -> Self {
        Self::Axle(AxleId(number))
    }

    /// Board of the frame with this number.
    pub const fn beam(number: u8) -> Self {
        Self::Beam(FrameId(number))
    }

    /// True for the board of a frame.
    pub const fn is_beam(self) -> bool {
        matches!(self, Self::Beam(_))
    }
}

/// A node of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// Central node, on the board of axle 0.
    Lead,
    /// Node of an axle.
    Axle(AxleId),
    /// Node of a frame.
    Beam(FrameId),
    /// A person's tool on the bus; not part of a running robot.
    Service,
}

impl Node {
    /// Node of the axle with this number.
    pub const fn axle(number: u8) -> Self {
        Self::Axle(AxleId(number))
    }

    /// Node of the frame with this number.
    pub const fn beam(number: u8) -> Self {
        Self::Beam(FrameId(number))
    }

    /// Board of the node; a service tool has none.
    pub const fn board(self) -> Option<Role> {
        match self {
            Self::Lead => Some(Role::LEAD),
            Self::Axle(axle) => Some(Role::Axle(axle)),
            Self::Beam(frame) => Some(Role::Beam(frame)),
            Self::Service => None,
        }
    }
}

/// Axles, frames, boards and nodes of a robot, given by its number of axles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topology {
    axles: u8,
}

impl Default for Topology {
    /// Two axles.
    fn default() -> Self {
        Self::PAIR
    }
}

impl Topology {
    /// Two axles, joined by one frame.
    pub const PAIR: Self = Self { axles: 2 };

    /// A robot with `axles` axles; `None` outside of 2 to [`MAX_AXLES`].
    pub const fn new(axles: usize) -> Option<Self> {
        match axles {
            2..=MAX_AXLES => Some(Self { axles: axles as u8 }),
            _ => None,
        }
    }

    /// Number of axles.
    pub const fn axle_count(self) -> usize {
        self.axles as usize
    }

    /// Number of frames.
    pub const fn frame_count(self) -> usize {
        self.axle_count() - 1
    }

    /// Number of boards.
    pub const fn board_count(self) -> usize {
        2 * self.axle_count() - 1
    }

    /// Number of nodes.
    pub const fn node_count(self) -> usize {
        1 + self.board_count()
    }

    /// The axles, front first.
    pub fn axles(self) -> impl Iterator<Item = AxleId> + Clone {
        (0..self.axles).map(AxleId)
    }

    /// The frames, front first.
    pub fn frames(self) -> impl Iterator<Item = FrameId> + Clone {
        (0..self.axles - 1).map(FrameId)
    }

    /// The boards in the order in which their messages enter the simulated bus: those of the axles, then those of the
    /// frames.
    pub fn boards(self) -> impl Iterator<Item = Role> + Clone {
        let frames = self.frames().map(Role::Beam);
        self.axles().map(Role::Axle).chain(frames)
    }

    /// The nodes: the lead node, those of the axles, then those of the frames.
    pub fn nodes(self) -> impl Iterator<Item = Node> + Clone {
        let frames = self.frames().map(Node::Beam);
        let axles = self.axles().map(Node::Axle);
        core::iter::once(Node::Lead).chain(axles).chain(frames)
    }

    /// True if the robot has this board.
    pub fn has(self, board: Role) -> bool {
        self.boards().any(|own| own == board)
    }

    /// The frame ahead of an axle, which has the axle at its root; the first axle has none.
    pub const fn ahead(self, axle: AxleId) -> Option<FrameId> {
        match axle.0 {
            0 => None,
            number => Some(FrameId(number - 1)),
        }
    }

    /// The frame behind an axle, which has the axle at its tip; the last axle has none.
    pub const fn behind(self, axle: AxleId) -> Option<FrameId> {
        match axle.0 + 1 < self.axles {
            true => Some(FrameId(axle.0)),
            false => None,
        }
    }

    /// Index of a board among [`Self::boards`].
    pub const fn place(self, board: Role) -> usize {
        match board {
            Role::Axle(axle) => axle.index(),
            Role::Beam(frame) => self.axle_count() + frame.index(),
        }
    }

    /// Index of a node among [`Self::nodes`]; `None` if the robot does not have the node.
    pub fn place_of_node(self, node: Node) -> Option<usize> {
        self.nodes().position(|own| own == node)
    }

    /// Name of a board: `front`, `axle-2` …, `rear`; `beam`, or `beam-1` … from the front.
    pub const fn name(self, board: Role) -> &'static str {
        match board {
            Role::Axle(AxleId(0)) => "front",
            Role::Axle(AxleId(axle)) if axle + 1 == self.axles => "rear",
            Role::Axle(AxleId(1)) => "axle-2",
            Role::Axle(AxleId(2)) => "axle-3",
            Role::Axle(AxleId(3)) => "axle-4",
            Role::Axle(_) => "axle-5",
            Role::Beam(FrameId(0)) if self.axles == 2 => "beam",
            Role::Beam(FrameId(0)) => "beam-1",
            Role::Beam(FrameId(1)) => "beam-2",
            Role::Beam(FrameId(2)) => "beam-3",
            Role::Beam(_) => "beam-4",
        }
    }

    /// Name of a node in the bus description.
    pub const fn node_name(self, node: Node) -> &'static str {
        match node {
            Node::Lead => "Lead",
            Node::Axle(AxleId(0)) => "FrontAxle",
            Node::Axle(AxleId(axle)) if axle + 1 == self.axles => "RearAxle",
            Node::Axle(AxleId(1)) => "Axle2",
            Node::Axle(AxleId(2)) => "Axle3",
            Node::Axle(AxleId(3)) => "Axle4",
            Node::Axle(_) => "Axle5",
            Node::Beam(FrameId(0)) if self.axles == 2 => "Beam",
            Node::Beam(FrameId(0)) => "Beam1",
            Node::Beam(FrameId(1)) => "Beam2",
            Node::Beam(FrameId(2)) => "Beam3",
            Node::Beam(_) => "Beam4",
            Node::Service => "Service",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expected names for three axles are listed by hand; the indices are checked for every number of axles.
    #[test]
    fn boards_and_nodes_of_three_axles_have_their_places_and_names() {
        let robot = Topology::new(3).unwrap();
        let names: Vec<_> = robot.boards().map(|board| robot.name(board)).collect();
        assert_eq!(names, ["front", "axle-2", "rear", "beam-1", "beam-2"]);
        let nodes: Vec<_> = robot.nodes().map(|node| robot.node_name(node)).collect();
        let expected = ["Lead", "FrontAxle", "Axle2", "RearAxle", "Beam1", "Beam2"];
        assert_eq!(nodes, expected);
        for axles in 2..=MAX_AXLES {
            let robot = Topology::new(axles).unwrap();
            let places = robot.boards().map(|board| robot.place(board));
            assert!(places.eq(0..robot.board_count()));
            assert!(robot.boards().all(|board| robot.has(board)));
            assert_eq!(robot.frames().count(), robot.frame_count());
            let beams = robot.boards().filter(|board| board.is_beam());
            assert!(beams.eq(robot.frames().map(Role::Beam)));
            let places = robot.nodes().map(|node| robot.place_of_node(node));
            assert!(places.eq((0..robot.node_count()).map(Some)));
            let stranger = Node::axle(axles as u8);
            assert_eq!(robot.place_of_node(stranger), None);
            assert_eq!(robot.place_of_node(Node::beam(axles as u8 - 1)), None);
            assert_eq!(robot.place_of_node(Node::Service), None);
        }
        assert_eq!([0, 1, 6].map(Topology::new), [None; 3]);
        assert!(Topology::PAIR.boards().eq(Role::PAIR));
        assert!(!Topology::PAIR.has(Role::axle(2)) && !Topology::PAIR.has(Role::beam(1)));
    }

    #[test]
    fn each_frame_lies_between_neighbouring_axles() {
        for axles in 2..=MAX_AXLES {
            let robot = Topology::new(axles).unwrap();
            for frame in robot.frames() {
                assert_eq!(robot.behind(AxleId(frame.0)), Some(frame));
                assert_eq!(robot.ahead(AxleId(frame.0 + 1)), Some(frame));
            }
            assert_eq!(robot.ahead(AxleId(0)), None);
            assert_eq!(robot.behind(AxleId(axles as u8 - 1)), None);
        }
    }

    /// Numbers of boards in links: front 0, rear 1, beam 2.
    #[cfg(feature = "link")]
    #[test]
    fn boards_of_two_axles_keep_their_numbers_in_links() {
        let codes = Role::PAIR.map(|board| {
            let mut room = [0; 4];
            postcard::to_slice(&board, &mut room).unwrap().to_vec()
        });
        assert_eq!(codes, [[0], [1], [2]]);
        let robot = Topology::new(MAX_AXLES).unwrap();
        for board in robot.boards() {
            let mut room = [0; 4];
            let bytes = postcard::to_slice(&board, &mut room).unwrap();
            assert_eq!(postcard::from_bytes(bytes), Ok(board));
        }
        assert!(postcard::from_bytes::<Role>(&[9]).is_err());
    }
}
