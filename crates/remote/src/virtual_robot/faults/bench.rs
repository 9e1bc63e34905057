//! Robot under test. A fault acts on its boards, sensors, motors and bus through this module.

use super::{AXLE, Campaign, frame};
use crate::board_log::BoardLog;
use crate::virtual_robot::axle::AxleBoard;
use crate::virtual_robot::beam::BeamBoard;
use crate::virtual_robot::{Options, VirtualRobot};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::robot::Robot;
use rand::RngExt;
use rand_pcg::Pcg64;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::core::{System, Transfer};
use virtual_board::wire::{BitTiming, Fault, Settings, VirtualNode};

/// Longest time from the press of the button to the first motion of a robot that plans, ms.
const LONGEST_PLANNING_MS: u64 = 5_000;
/// Speed of an axle above which the robot moves, m/s.
pub const MOVING_M_S: f64 = 0.02;

/// Robot and the board that a fault affects.
#[derive(Clone)]
pub struct FaultBench {
    pub robot: VirtualRobot,
    pub random: Pcg64,
    seed: u64,
    /// Board that the fault affects; `None` until an act selects a board.
    pub affected: Option<Role>,
    /// Failure observed by an act; `None` without one.
    pub violation: Option<String>,
}

impl FaultBench {
    /// Lowest address of a board's stack; `None` if the image has no such symbol.
    pub fn end_of_stack(&self, role: Role) -> Option<u32> {
        self.robot.images.of(role).symbol("_stack_end")
    }

    /// Robot with its boards switched off.
    pub fn new(campaign: &Campaign, options: Options, seed: u64) -> Result<Self, Error> {
        use host_sim::world::random::{Stream, generator};
        let options = Options {
            extra_nodes: 1,
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
            affected: None,
            violation: None,
        };
        bench.wire(Fault::Piece {
            node: bench.extra_node(),
            piece: 1,
        });
        Ok(bench)
    }

    /// Index of the additional bus node, which belongs to no board.
    fn extra_node(&self) -> usize {
        self.robot.roles.len()
    }

    /// Present simulated time.
    pub fn now(&self) -> Time {
        self.robot.network.now()
    }

    /// Presses the button.
    pub fn press(&mut self) {
        self.robot.press();
    }

    /// Presses the button. A robot of three or more axles plans before it drives: waits for its first motion.
    pub fn begin_drive(&mut self) {
        self.press();
        for _ in 0..LONGEST_PLANNING_MS {
            if !self.has_inner_axle() || self.robot.speed() > MOVING_M_S {
                return;
            }
            self.run_for(1);
        }
    }

    /// Random number below `end`.
    pub fn draw(&mut self, end: u64) -> u64 {
        self.random.random_range(0..end)
    }

    /// Advances to a random instant within the next millisecond, so that acts are not synchronised with the boards.
    pub fn advance_randomly(&mut self) {
        let until = self.now() + Time::from_nanos(self.draw(1_000_000));
        self.robot.network.run_until(until);
    }

    /// True if the robot has an axle with neighbours on both sides, at which faults then occur.
    fn has_inner_axle(&self) -> bool {
        self.robot.topology.axle_count() > 2
    }

    /// Wheel selected by the seed, of the second axle if the robot has three or more. The board of the wheel's axle
    /// becomes the affected board.
    pub fn wheel(&mut self) -> (Role, usize) {
        let (role, side) = match self.has_inner_axle() {
            true => (Role::Axle(AXLE), self.seed),
            false => (Role::axle((self.seed % 2) as u8), self.seed / 2),
        };
        self.affected = Some(role);
        (role, (side % 2) as usize)
    }

    /// Board of the frame at which faults occur.
    pub fn frame(&self) -> Role {
        Role::Beam(frame(self.robot.topology))
    }

    /// Board selected by the seed, of the second axle and the frame behind it if the robot has three or more axles. The
    /// board becomes the affected board.
    pub fn any(&mut self) -> Role {
        let inner = [Role::Axle(AXLE), self.frame()];
        let boards = match self.has_inner_axle() {
            true => &inner[..],
            false => &self.robot.roles,
        };
        let role = boards[self.seed as usize % boards.len()];
        self.affected = Some(role);
        role
    }

    /// Performs `act` on a board. The board becomes the affected board if no board is affected yet.
    pub fn board(&mut self, role: Role, act: impl FnOnce(&mut Board)) {
        self.affected.get_or_insert(role);
        if let Some(place) = self.robot.place(role)
            && let Some(board) = self.robot.network.board(place)
        {
            act(board);
        }
    }

    /// Reads a register of a board's chip. The read must have no side effects.
    pub fn register(&mut self, role: Role, address: u32) -> u32 {
        let mut value = 0;
        self.board(role, |board| {
            let (core, chip) = board.parts();
            let read = chip.read(Transfer::word(address, 0), &mut core.cycles());
            value = read.unwrap_or_default();
        });
        value
    }

    /// Performs `act` on the circuit of an axle board.
    pub fn axle(&mut self, role: Role, act: impl FnOnce(&mut AxleBoard, Time)) {
        self.affected.get_or_insert(role);
        let now = self.now();
        if let Some(axle) = self.robot.axle(role) {
            act(axle, now);
        }
    }

    /// Performs `act` on the circuit and the side of [`Self::wheel`].
    pub fn at_wheel(&mut self, act: impl FnOnce(&mut AxleBoard, usize, Time)) {
        let (role, side) = self.wheel();
        self.axle(role, |axle, now| act(axle, side, now));
    }

    /// Performs `act` on the circuit of the board of [`Self::frame`].
    pub fn beam(&mut self, act: impl FnOnce(&mut BeamBoard, Time)) {
        let role = self.frame();
        self.affected.get_or_insert(role);
        let now = self.now();
        if let Role::Beam(frame) = role
            && let Some(beam) = self.robot.beam(frame)
        {
            act(beam, now);
        }
    }

    /// Starts a fault of the bus wire.
    pub fn wire(&mut self, fault: Fault) {
        let now = self.now();
        self.robot.network.wire().inject(now, fault);
    }

    /// Connects the additional node to the bus and performs `act` on it.
    pub fn intruder(&mut self, act: impl FnOnce(&mut VirtualNode, Time)) {
        let now = self.now();
        self.wire(Fault::Piece {
            node: self.extra_node(),
            piece: 0,
        });
        if let Some(node) = self.robot.network.others().first_mut() {
            act(node, now);
        }
    }

    /// Sets whether a board's transceiver sends and receives.
    pub fn transceiver(&mut self, role: Role, transmit_enabled: bool, receive_enabled: bool) {
        self.affected.get_or_insert(role);
        self.wire(Fault::Transceiver {
            node: self.robot.topology.place(role),
            transmit_enabled,
            receive_enabled,
        });
    }

    /// Connects a board to a piece of the cut bus wire.
    pub fn piece(&mut self, role: Role, piece: u8) {
        self.affected.get_or_insert(role);
        self.wire(Fault::Piece {
            node: self.robot.topology.place(role),
            piece,
        });
    }
}
