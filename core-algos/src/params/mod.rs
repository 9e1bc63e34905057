//! Parameters that a user calibrates or tunes: a table of names, units and ranges, and their stored form.
//!
//! [`table`] holds the table; [`drive`] the circuits behind the pins of an axle board; [`stored`] encodes values as
//! items and decides after a start which stored items are used. The caller reads and writes the flash.
//!
//! # Panic contract
//!
//! No stored bytes cause a panic. A value is used only if it is in range, and the set of values only if the nodes can
//! be built from it.
//!
//! # Example
//!
//! ```
//! use core_algos::topology::Role;
//! use core_algos::params::{Settings, find};
//!
//! let mut settings = Settings::default();
//! let radius = find("robot.geometry.wheel_radius_m").expect("a parameter");
//! radius.set(&mut settings, 0.0731)?;
//! assert_eq!(settings.robot.geometry.wheel_radius_m, 0.0731);
//! settings.check(Role::LEAD)?;
//! // Millimetres are refused, and nothing is changed.
//! assert_eq!(radius.set(&mut settings, 73.1).unwrap_err().field, radius.name);
//! assert_eq!(radius.get(&settings), 0.0731);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

pub mod drive;
pub mod stored;
pub mod table;

pub use drive::Drive;
pub use stored::{Contents, Item, Source, StoreReport};
pub use table::{COUNT, Parameter, TABLE, find, fingerprint};

use crate::acquisition::oversampling::{FULL_SCALE, SCANS};
use crate::beam::PerGauge;
use crate::config::{Allowed, ConfigError, declare, require};
use crate::math::Posture;
use crate::node::board::Board;
use crate::node::robot::{RobotConfig, START};
use crate::safety::{OperatingState, Permit};
use crate::topology::{AxleId, FrameId, Role};
use declare::{Declared, Field, Kind};

::declare::declare! {
    /// Parameters of a board.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Configuration of the nodes.
        pub robot: RobotConfig = RobotConfig::default();
        /// Scale of the board's inertial sensor.
        pub inertial: Inertial = Inertial::default();
        /// Motors, drivers and supply of an axle's board.
        pub drive: Drive = Drive::default();
        /// Drive that the front board's button starts.
        pub button: Button = Button::default();
        /// Place of the board in the robot.
        pub board: Place = Place::default();
    }
}

declare! {
    /// Place of a board in the robot.
    pub struct Place {
        /// Number of the board's axle or frame from the front, beginning with 0. An axle board with an open strap is
        /// the front axle, whatever this value is; with the strap at ground, 0 is refused.
        pub place: u32 = 0, "": Range(0.0, 4.0);
    }
}

/// Kind of a board, fixed by its image and its strap. The kind and the stored place give the role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// Axle board with an open strap: the front axle.
    FrontAxle,
    /// Axle board with its strap at ground: the axle at the stored place.
    PlacedAxle,
    /// Beam board: the frame at the stored place.
    Beam,
}

impl BoardKind {
    /// Kind of the board with this role.
    pub const fn of(role: Role) -> Self {
        match role {
            Role::Axle(AxleId(0)) => Self::FrontAxle,
            Role::Axle(_) => Self::PlacedAxle,
            Role::Beam(_) => Self::Beam,
        }
    }

    /// Role of a board with an empty store: one of the roles of a robot of two axles.
    pub const fn unplaced(self) -> Role {
        match self {
            Self::FrontAxle => Role::LEAD,
            Self::PlacedAxle => Role::axle(1),
            Self::Beam => Role::beam(0),
        }
    }
}

::declare::declare! {
    /// Drive that the front board's button starts.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Button {
        /// Posture at which the robot is placed.
        pub start: Posture = START;
        /// Goal of the drive.
        pub goal: Posture = Posture::ORIGIN;
        /// Action of the button while the robot is at rest. While the robot drives, the button stops it.
        pub action: Press = Press::Again;
    }
}

declare! {
    /// Action of the button.
    pub enum Press, default Again {
        /// Drive to the latest goal; to the button's goal if there was none.
        Again = "again",
        /// Drive from the button's start to the button's goal.
        StartAndGoal = "start-and-goal",
        /// Nothing.
        Nothing = "nothing",
    }
}

impl Declared for Posture {
    const KIND: Kind = {
        const fn field(
            name: &'static str,
            doc: &'static str,
            unit: &'static str,
            most: f32,
        ) -> Field {
            let allowed = Allowed::Range(-most, most);
            let whole = false;
            Field {
                name,
                doc,
                kind: Kind::Number {
                    unit,
                    allowed,
                    whole,
                },
            }
        }
        Kind::Table(&[
            field("x", "Position of the midpoint along x.", "m", 50.0),
            field("y", "Position of the midpoint along y.", "m", 50.0),
            field("phi", "Heading.", "rad", 3.2),
        ])
    };
}

declare! {
    /// Scale of an inertial sensor; its biases are estimated at every standstill.
    pub struct Inertial {
        /// True yaw rate divided by the measured yaw rate.
        pub gyro_gain: f32 = 1.0, "": Range(0.9, 1.1);
        /// True acceleration divided by the measured acceleration.
        pub accelerometer_gain: f32 = 1.0, "": Range(0.9, 1.1);
    }
}

impl Settings {
    /// Settings of a board with this configuration.
    pub fn new(robot: RobotConfig) -> Self {
        Self {
            robot,
            ..Self::default()
        }
    }

    /// Settings of a board with an empty store. The beam board's converter gives sums of [`SCANS`] conversions.
    pub fn of(kind: BoardKind) -> Self {
        let mut robot = RobotConfig::default();
        if kind == BoardKind::Beam {
            let calibration = &mut robot.beam.calibration;
            calibration.full_scale_counts = FULL_SCALE;
            calibration.rail_margin_counts *= SCANS as i32;
            calibration.strain_per_count /= SCANS as f32;
            let zeros = &mut calibration.zero_counts;
            let scaled = zeros.padded().map(|zero| zero * SCANS as f32);
            *zeros = scaled
                .get(..zeros.count())
                .and_then(PerGauge::new)
                .unwrap_or(*zeros);
        }
        let settings = Self::new(robot);
        settings.placed(kind.unplaced())
    }

    /// These settings with the place of a role.
    pub fn placed(self, role: Role) -> Self {
        let place = match role {
            Role::Axle(axle) => axle.0,
            Role::Beam(frame) => frame.0,
        };
        Self {
            board: Place {
                place: place.into(),
            },
            ..self
        }
    }

    /// Role of a board of this kind at its place; the error names the place.
    pub fn role(&self, kind: BoardKind) -> Result<Role, ConfigError> {
        let place = u8::try_from(self.board.place).unwrap_or(u8::MAX);
        let role = match kind {
            BoardKind::FrontAxle => Role::LEAD,
            BoardKind::PlacedAxle => Role::axle(place),
            BoardKind::Beam => Role::beam(place),
        };
        let allowed = BoardKind::of(role) == kind && self.robot.topology().has(role);
        self.require_place(allowed)?;
        Ok(role)
    }

    /// [`Self::role`], if the nodes of the board can be built from the settings; the error names the field.
    pub fn check_role(&self, kind: BoardKind) -> Result<Role, ConfigError> {
        let role = self.role(kind)?;
        self.check(role).map(|()| role)
    }

    fn require_place(&self, allowed: bool) -> Result<(), ConfigError> {
        require(
            allowed,
            "board.place",
            self.board.place as f32,
            Allowed::Condition(
                "a place of the robot: 1 to robot.geometry.axles - 1 with the strap at ground, 0 to \
                 robot.geometry.axles - 2 of a beam board",
            ),
        )
        .map(|_| ())
    }

    /// Checks that the nodes of a board can be built from the settings; the error names the field.
    pub fn check(&self, role: Role) -> Result<(), ConfigError> {
        self.inertial.check_ranges()?;
        self.require_place(self.robot.topology().has(role))?;
        if !role.is_beam() {
            self.drive.check()?;
        }
        match role {
            Role::Axle(axle) => {
                check_axle(&self.robot, axle)?;
                match role {
                    Role::LEAD => check_lead(&self.robot),
                    _ => Ok(()),
                }
            }
            Role::Beam(frame) => check_beam(&self.robot, frame),
        }
    }
}

// Not inlined: nodes are large, and the stack of a board must hold only one at a time.

#[inline(never)]
fn check_axle(robot: &RobotConfig, axle: AxleId) -> Result<(), ConfigError> {
    robot.build_axle(axle).map(|_| ())
}

#[inline(never)]
fn check_lead(robot: &RobotConfig) -> Result<(), ConfigError> {
    robot.build_lead().map(|_| ())
}

#[inline(never)]
fn check_beam(robot: &RobotConfig, frame: FrameId) -> Result<(), ConfigError> {
    robot.build_beam(frame).map(|_| ())
}

/// Proof that the motors are off. A flash write requires this proof, because the write halts the core: an erase for
/// half a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disarmed(());

impl Disarmed {
    /// The proof, if the operating state permits no torque; `None` otherwise.
    pub const fn by(state: OperatingState) -> Option<Self> {
        match state.permit() {
            Permit::Off => Some(Self(())),
            _ => None,
        }
    }

    /// The proof for a board with these nodes, or without nodes. A beam board behind a link receives no motor state of
    /// other boards, so it has the proof only without nodes.
    pub fn of(board: Option<&Board>) -> Option<Self> {
        match board {
            None => Some(Self(())),
            Some(Board::Axle { axle, .. }) => Self::by(axle.supervision().operating()),
            Some(Board::Beam(_)) => None,
        }
    }

    /// The proof on a board without motors, from the motor state on the bus; `None` if motors are on.
    pub const fn when(motors_off: bool) -> Option<Self> {
        if motors_off { Some(Self(())) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::Topology;

    /// A sum of conversions gives the same strain and the same margin to the rails as a single conversion.
    #[test]
    fn beam_board_scales_its_calibration_to_sums_of_conversions() {
        assert_eq!(Settings::of(BoardKind::FrontAxle), Settings::default());
        let [one, sum] = [Settings::default(), Settings::of(BoardKind::Beam)]
            .map(|settings| settings.robot.beam.calibration);
        let many = SCANS as i32;
        assert_eq!(sum.full_scale_counts, many * one.full_scale_counts);
        assert_eq!(sum.rail_margin_counts, many * one.rail_margin_counts);
        let zeros = [one, sum].map(|calibration| calibration.zero_counts.padded());
        for (zero, zero_of_sum) in zeros[0].iter().zip(zeros[1]) {
            let strain = one.strain_per_count * (1000.0 - zero);
            let of_sum = sum.strain_per_count * (1000.0 * SCANS as f32 - zero_of_sum);
            assert!((of_sum / strain - 1.0).abs() < 1e-5, "{of_sum} {strain}");
        }
    }

    /// The allowed places are listed by hand: an axle board at ground has place 1 to N − 1, a beam board 0 to N − 2.
    #[test]
    fn stored_place_gives_the_role_within_the_robot() {
        for axles in 2..=5u8 {
            for place in 0..=5u8 {
                let mut settings = Settings::default();
                settings.robot.geometry.axles = axles.into();
                settings.board.place = place.into();
                let role = |kind| settings.role(kind).map_err(|error| error.field);
                assert_eq!(role(BoardKind::FrontAxle), Ok(Role::LEAD));
                let axle = match place {
                    1.. if place < axles => Ok(Role::axle(place)),
                    _ => Err("board.place"),
                };
                assert_eq!(role(BoardKind::PlacedAxle), axle, "{place} of {axles}");
                let beam = match place + 1 < axles {
                    true => Ok(Role::beam(place)),
                    false => Err("board.place"),
                };
                assert_eq!(role(BoardKind::Beam), beam, "{place} of {axles}");
                for role in axle.into_iter().chain(beam) {
                    assert_eq!(settings.check_role(BoardKind::of(role)), Ok(role));
                    assert_eq!(Settings::default().placed(role).board, settings.board);
                }
            }
        }
        let unplaced = [BoardKind::FrontAxle, BoardKind::PlacedAxle, BoardKind::Beam]
            .map(|kind| Settings::of(kind).check_role(kind));
        assert_eq!(unplaced, Role::PAIR.map(Ok));
    }

    #[test]
    fn check_gives_the_same_result_as_building_the_board() {
        let mut wrong = vec![Settings::default()];
        for parameter in &TABLE {
            for value in [parameter.range.0, parameter.range.1] {
                let mut settings = Settings::default();
                parameter.set(&mut settings, value).unwrap();
                wrong.push(settings);
            }
        }
        let spoils: [fn(&mut RobotConfig); 4] = [
            |robot| robot.geometry.frame_length_m = -1.0,
            |robot| robot.axle.rest_hold_s = -1.0,
            |robot| robot.lead.report_timeout_s = 9.0,
            |robot| robot.beam.strip.half_thickness_m = 0.0,
        ];
        for spoil in spoils {
            let mut settings = Settings::default();
            spoil(&mut settings.robot);
            wrong.push(settings);
        }
        let mut refused = 0;
        for settings in &wrong {
            for role in Topology::PAIR.boards() {
                let built = Board::new(&settings.robot, role).map(|_| ());
                assert_eq!(settings.check(role), built);
                refused += usize::from(built.is_err());
            }
        }
        assert!(refused >= spoils.len() + 2, "{refused}");
    }
}
