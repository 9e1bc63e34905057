//! The robot with what an act of a fault can reach.

use super::Campaign;
use crate::board_log::BoardLog;
use crate::virtual_robot::axle::AxleBoard;
use crate::virtual_robot::beam::BeamBoard;
use crate::virtual_robot::{Options, VirtualRobot};
use core_algos::topology::{FrameId, Role};
use host_sim::base::error::Error;
use rand::RngExt;
use rand_pcg::Pcg64;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::core::{System, Transfer};
use virtual_board::wire::{BitTiming, Fault, Settings, VirtualNode};

/// The robot, and whom a fault strikes.
#[derive(Clone)]
pub struct Bench {
    pub robot: VirtualRobot,
    pub random: Pcg64,
    seed: u64,
    /// The board that was struck.
    pub struck: Option<Role>,
    /// Failure that an act has seen.
    pub wrong: Option<String>,
}

impl Bench {
    /// The lowest address of a board's stack, if its image tells.
    pub fn end_of_stack(&self, role: Role) -> Option<u32> {
        self.robot.images.of(role).symbol("_stack_end")
    }

    /// The robot, its boards still off.
    pub fn new(campaign: &Campaign, options: Options, seed: u64) -> Result<Self, Error> {
        use host_sim::world::random::{Stream, generator};
        let options = Options {
            others: 1,
            ..options
        };
        let (scenario, images) = (&campaign.scenario, campaign.images()?);
        let logs = BoardLog::quiet(scenario.robot.topology());
        let mut robot = VirtualRobot::without_power(scenario, images, seed, 0, &options, &logs)?;
        let mut node = VirtualNode::new(Settings::new(BitTiming::megabit()));
        node.babble(None);
        robot.network.add(node);
        let mut bench = Self {
            robot,
            random: generator(seed, 0, Stream::Other(0x300)),
            seed,
            struck: None,
            wrong: None,
        };
        bench.wire(Fault::Piece {
            node: bench.other(),
            piece: 1,
        });
        Ok(bench)
    }

    /// Place of the node at the bus that is no board.
    fn other(&self) -> usize {
        self.robot.roles.len()
    }

    /// The present.
    pub fn now(&self) -> Time {
        self.robot.network.now()
    }

    /// Presses the button.
    pub fn press(&mut self) {
        self.robot.press();
    }

    /// One of several, by chance.
    pub fn draw(&mut self, end: u64) -> u64 {
        self.random.random_range(0..end)
    }

    /// Goes on to some instant within the next millisecond: nothing of the boards is in step with the
    /// calls of acts any more.
    pub fn somewhen(&mut self) {
        let until = self.now() + Time::from_nanos(self.draw(1_000_000));
        self.robot.network.run_until(until);
    }

    /// A wheel, by seed: its axle is struck.
    pub fn wheel(&mut self) -> (Role, usize) {
        let axles = self.robot.topology.axle_count() as u64;
        let role = Role::axle((self.seed % axles) as u8);
        self.struck = Some(role);
        (role, (self.seed / axles % 2) as usize)
    }

    /// Any board, by seed: it is struck.
    pub fn any(&mut self) -> Role {
        let boards = &self.robot.roles;
        let role = boards[self.seed as usize % boards.len()];
        self.struck = Some(role);
        role
    }

    /// Does something to a board.
    pub fn board(&mut self, role: Role, act: impl FnOnce(&mut Board)) {
        self.struck.get_or_insert(role);
        if let Some(place) = self.robot.place(role)
            && let Some(board) = self.robot.network.board(place)
        {
            act(board);
        }
    }

    /// A register of a board's chip that does not mind being read.
    pub fn register(&mut self, role: Role, address: u32) -> u32 {
        let mut value = 0;
        self.board(role, |board| {
            let (core, chip) = board.parts();
            let read = chip.read(Transfer::word(address, 0), &mut core.cycles());
            value = read.unwrap_or_default();
        });
        value
    }

    /// Does something to the parts of an axle.
    pub fn axle(&mut self, role: Role, act: impl FnOnce(&mut AxleBoard, Time)) {
        self.struck.get_or_insert(role);
        let now = self.now();
        if let Some(axle) = self.robot.axle(role) {
            act(axle, now);
        }
    }

    /// Does something to the parts of the axle of [`Self::wheel`].
    pub fn at_wheel(&mut self, act: impl FnOnce(&mut AxleBoard, usize, Time)) {
        let (role, side) = self.wheel();
        self.axle(role, |axle, now| act(axle, side, now));
    }

    /// Does something to the parts of the beam.
    pub fn beam(&mut self, act: impl FnOnce(&mut BeamBoard, Time)) {
        self.struck.get_or_insert(Role::beam(0));
        let now = self.now();
        if let Some(beam) = self.robot.beam(FrameId(0)) {
            act(beam, now);
        }
    }

    /// Brings a fault of the wire about now.
    pub fn wire(&mut self, fault: Fault) {
        let now = self.now();
        self.robot.network.wire().inject(now, fault);
    }

    /// The node that is no board, on the bus from now on.
    pub fn intruder(&mut self, act: impl FnOnce(&mut VirtualNode, Time)) {
        let now = self.now();
        self.wire(Fault::Piece {
            node: self.other(),
            piece: 0,
        });
        if let Some(node) = self.robot.network.others().first_mut() {
            act(node, now);
        }
    }

    /// A transceiver sends or hears no more.
    pub fn transceiver(&mut self, role: Role, sends: bool, hears: bool) {
        self.struck.get_or_insert(role);
        self.wire(Fault::Transceiver {
            node: self.robot.topology.place(role),
            sends,
            hears,
        });
    }

    /// A board hangs on a piece of the cut wire.
    pub fn piece(&mut self, role: Role, piece: u8) {
        self.struck.get_or_insert(role);
        self.wire(Fault::Piece {
            node: self.robot.topology.place(role),
            piece,
        });
    }
}
