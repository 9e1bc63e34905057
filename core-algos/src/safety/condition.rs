//! Conditions: the table of codes, classes, times, meanings and remedies.

use crate::time::Micros;

/// Class of a condition by the required reaction. The upper two bits of a code are its class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// A limit was met or something small was lost; reported only. Codes 0x01 to 0x3f.
    Notice,
    /// The robot may drive on for a limited time and distance. Codes 0x40 to 0x7f.
    Degraded,
    /// Coordinated stop, then motors off. Codes 0x80 to 0xbf.
    Stop,
    /// Motors off at once: control itself cannot be trusted. Codes 0xc0 to 0xff.
    Cut,
}

impl Class {
    /// The class of a code.
    pub const fn of(code: u8) -> Self {
        match code >> 6 {
            0 => Self::Notice,
            1 => Self::Degraded,
            2 => Self::Stop,
            _ => Self::Cut,
        }
    }

    /// True if the condition ends the drive and is latched until cleared.
    pub const fn is_hard(self) -> bool {
        matches!(self, Self::Stop | Self::Cut)
    }

    /// Name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Notice => "notice",
            Self::Degraded => "degraded",
            Self::Stop => "stop",
            Self::Cut => "cut",
        }
    }
}

/// Row of the table of conditions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// The condition.
    pub condition: Condition,
    /// Code on the bus and in reports; never reused for another meaning.
    pub code: u8,
    /// Name in reports.
    pub name: &'static str,
    /// Time that the condition must hold without a break before it counts.
    pub hold: Micros,
    /// Meaning of the condition.
    pub meaning: &'static str,
    /// User's action that remedies the condition.
    pub remedy: &'static str,
}

macro_rules! conditions {
    ($($name:ident = $code:literal $(bit $bit:literal)? $text:literal $hold_ms:literal ms: $meaning:literal; $remedy:literal.)+) => {
        /// Condition that a node reports.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
        #[repr(u8)]
        pub enum Condition {
            $(#[doc = $meaning] $name $(= $bit)?,)+
        }

        /// Every condition, in the order of the enumeration.
        pub const TABLE: [Entry; COUNT] = [$(*Condition::$name.entry()),+];

        /// Number of conditions.
        pub const COUNT: usize = [$($code),+].len();

        impl Condition {
            /// Every condition.
            pub const ALL: [Self; COUNT] = [$(Self::$name),+];

            /// Row of the condition in the table.
            pub const fn entry(self) -> &'static Entry {
                match self {
                    $(Self::$name => &Entry {
                        condition: Self::$name,
                        code: $code,
                        name: $text,
                        hold: $hold_ms * 1_000,
                        meaning: $meaning,
                        remedy: $remedy,
                    },)+
                }
            }
        }
    };
}

conditions! {
    TorqueLimited = 0x01 "torque limited" 100 ms:
        "the commanded torque exceeds the torque limit of the motors"; "lower the speed or acceleration limits".
    MeasurementRefused = 0x02 "measurement refused" 0 ms:
        "an innovation gate rejected a measurement"; "if it repeats, check for slipping wheels or a loose sensor".
    GaugeLost = 0x03 "gauge lost" 0 ms:
        "a strain gauge failed; the other gauges give the posture"; "check the bridge named in the beam board's report".
    // Reserved: codes 0x04 and 0xc6.
    MessageLost = 0x05 bit 4 "message lost" 0 ms:
        "an expected message did not arrive"; "check cable, termination and bus load".
    InertialLost = 0x06 "inertial sensor lost" 20 ms:
        "gyro or accelerometer gives no sample; the robot drives on without it"; "check the wiring of the sensor".
    TemperatureHigh = 0x07 "temperature high" 500 ms:
        "a motor or driver is near its temperature limit; its current is reduced"; "let the motor and its driver cool".
    SupplyWarning = 0x08 "supply near its limit" 200 ms:
        "the supply voltage is near its lower limit"; "charge the battery".
    ParameterDefault = 0x09 "default parameter in use" 0 ms:
        "a stored parameter is damaged; its default is used"; "set the parameter and save it".
    ClockStepped = 0x0a "clock stepped" 0 ms:
        "the clock was corrected by more than its drift explains"; "harmless once after a start".
    TickLate = 0x0b "tick late" 0 ms:
        "a tick ended after its deadline"; "reduce the load of the board".
    ConversionsLost = 0x0c "conversions lost" 0 ms:
        "samples of the strain bridges were lost; the scan was restarted"; "if it repeats, check for a faulty converter or an overload".
    ReachedUncertain = 0x0d "goal uncertain" 0 ms:
        "the robot is at its goal, but distance and 95 % error exceed the tolerance, or a sensor is inconsistent"; "set placement accuracy and floor drift, calibrate, or drive a shorter path".
    EstimateVague = 0x0e bit 38 "estimate vague" 200 ms:
        "the standard deviation of the robot's posture exceeds its bound"; "set the pose, or drive a shorter path".
    CommanderSilent = 0x0f bit 39 "commander silent" 0 ms:
        "no speed command for 200 ms, or no message from the commanding host for 1 s; the robot stops"; "check the cable to the computer".
    GaveUp = 0x10 bit 3 "gave up" 0 ms:
        "the robot did not reach its goal in the allowed attempts, or missed the end of its path"; "calibrate, set the pose, or choose a nearer goal or a shorter path".
    WheelsInconsistent = 0x11 bit 35 "wheels inconsistent" 1000 ms:
        "the other sensors contradict the configured wheels or tyres"; "measure wheels and track; check for a loose wheel or a slippery floor".
    GaugesInconsistent = 0x12 bit 40 "gauges inconsistent" 1000 ms:
        "zeros or gains of the strain gauges contradict the other sensors or each other, or a gauge is noisy"; "calibrate the gauges; check the clamps of the strip and the wires of the bridges".
    GyrosInconsistent = 0x13 bit 41 "gyros inconsistent" 1000 ms:
        "the other sensors contradict the calibrated bias or scale of a gyro"; "calibrate the inertial sensors; check that they are fixed".
    BeamInconsistent = 0x14 bit 42 "beam inconsistent" 1000 ms:
        "the squared normalised innovation of the beam is far above its mean of 0.1 to 0.5"; "check the clamps and the length of the strip".
    NoProgress = 0x15 bit 43 "no progress" 0 ms:
        "the robot was commanded to move and did not move for 2 s"; "check for an obstacle, a slope, friction that exceeds the motor torque, or a path that starts with too much curvature".
    BeamLost = 0x40 bit 13 "relative position sensor lost" 50 ms:
        "no posture of the beam board was used for 0.1 s; the estimate continues from the encoders"; "check the beam board, its cable and the latency of the bus".
    EmergencyStop = 0x80 "emergency stop" 0 ms:
        "the emergency stop was pressed or commanded"; "release the emergency stop and clear the fault".
    CommandTimeout = 0x81 "command timeout" 0 ms:
        "no references arrive"; "check the lead node and the bus".
    NeighbourLost = 0x82 "neighbour lost" 0 ms:
        "the heartbeat of another node is missing"; "check supply and cable of that board".
    NeighbourFault = 0x83 "neighbour stopped" 0 ms:
        "another node is stopping, in fault, or does not arm"; "read the code of that node".
    BusOff = 0x84 "bus off" 20 ms:
        "the CAN controller is in bus-off after too many errors"; "check cable, termination and bit rate".
    EstimateInconsistent = 0x85 "estimate inconsistent" 200 ms:
        "the beam contradicts wheels and gyros: uneven or slippery ground, or a wrong sensor"; "drive on a floor with grip and no steps above 10 mm; there, check wheels, gauges and calibration".
    FrameBent = 0x86 "frame bent" 30 ms:
        "the steering exceeds the limit of the frame"; "check for an obstacle or a slipping wheel; straighten the frame".
    WrenchHigh = 0x87 "wrench high" 30 ms:
        "the wrench of the frame exceeds its limit"; "check for a blocked wheel, a step in the ground or axles driving against each other".
    TrackingLost = 0x88 "tracking lost" 150 ms:
        "an axle does not follow its reference"; "check for a weak motor, a lifted wheel or a blocked wheel".
    OverTemperature = 0x89 "over temperature" 200 ms:
        "a motor or driver exceeds its temperature limit"; "let the motor and its driver cool; reduce the load".
    SupplyLow = 0x8a "supply low" 20 ms:
        "the supply voltage is below its lower limit"; "charge the battery; check the cable".
    TickOverrun = 0x8b "ticks overrun" 5 ms:
        "several ticks in succession were missed"; "reduce the load of the board".
    DegradedTooLong = 0x8c "degraded too long" 0 ms:
        "the time or distance limit of degraded driving is reached"; "remove the cause of the degradation".
    WheelSlip = 0x8d "wheel slip" 100 ms:
        "the wheels disagree with the inertial sensor or the beam"; "check for a lifted wheel, a slippery floor or a loose encoder wire".
    SupplyHigh = 0x8e "supply high" 20 ms:
        "the supply voltage is above its upper limit"; "check battery and charger; braking feeds energy back".
    PathLost = 0x8f bit 44 "path lost" 0 ms:
        "the robot is farther from its path or trajectory than the largest deviation"; "place the robot at the start of the path, set the pose, or drive slower".
    NotANumber = 0xc0 bit 29 "not a number" 0 ms:
        "a result of control or estimation is not finite"; "report the log; restart the board".
    EncoderFault = 0xc1 "encoder fault" 5 ms:
        "an encoder is missing, jumps, or contradicts its motor"; "check the encoder and its cable".
    OverCurrent = 0xc2 "over current" 2 ms:
        "the current of a motor exceeds its limit"; "check for a short circuit or a blocked wheel".
    MotorStall = 0xc3 "motor stalled" 300 ms:
        "a wheel does not turn at full motor torque"; "check for a blocked wheel or a broken encoder".
    DriverFault = 0xc4 "driver fault" 0 ms:
        "a motor driver reports a fault"; "check motor and driver".
    MotorUnresponsive = 0xc5 "motor unresponsive" 50 ms:
        "a motor's current does not follow its command"; "check the wires of the motor and its encoder; A and B may be swapped".
    Restarted = 0xc7 bit 36 "restarted" 0 ms:
        "the board was reset by its watchdog, a panic or a hard fault"; "report the crash record; clear the fault".
    StopNotFollowed = 0xc8 "stop not followed" 20 ms:
        "an axle does not decelerate as the coordinated stop requires"; "check the driver for a motor that stays on".
    RoleTaken = 0xc9 bit 45 "role taken" 0 ms:
        "another board on the bus has the role of this board"; "check the role straps (PC13) of both axle boards".
}

impl Condition {
    /// Code of the condition.
    pub const fn code(self) -> u8 {
        self.entry().code
    }

    /// Class of the condition.
    pub const fn class(self) -> Class {
        Class::of(self.entry().code)
    }

    /// The condition of a code, or `None`.
    pub fn from_code(code: u8) -> Option<Self> {
        let entry = TABLE.iter().find(|entry| entry.code == code)?;
        Some(entry.condition)
    }
}

/// Number of bits of a set, reserved bits included. A heartbeat carries the lower 44 bits, which hold all notices and
/// degradations.
pub(super) const BITS: usize = 46;

/// Condition of each bit of a set; `None` for an unused bit.
const BY_BIT: [Option<Condition>; BITS] = {
    let mut conditions = [None; BITS];
    let mut i = 0;
    while i < COUNT {
        conditions[Condition::ALL[i] as usize] = Some(Condition::ALL[i]);
        i += 1;
    }
    conditions
};

/// A set of conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Conditions(u64);

impl Conditions {
    /// No condition.
    pub const NONE: Self = Self(0);

    /// Set of one condition.
    pub const fn only(condition: Condition) -> Self {
        Self(1 << condition as u8)
    }

    /// Adds `condition` if `holds`.
    pub const fn set(&mut self, condition: Condition, holds: bool) {
        if holds {
            self.0 |= 1 << condition as u8;
        }
    }

    /// This set, with `condition` added if `holds`.
    #[must_use]
    pub const fn with(mut self, condition: Condition, holds: bool) -> Self {
        self.set(condition, holds);
        self
    }

    /// Every condition from class `least` to class `most`.
    const fn between(least: Class, most: Class) -> Self {
        let mut set = Self::NONE;
        let mut i = 0;
        while i < COUNT {
            let class = Condition::ALL[i].class() as u8;
            set.set(
                Condition::ALL[i],
                least as u8 <= class && class <= most as u8,
            );
            i += 1;
        }
        set
    }

    /// The members of class stop and cut.
    #[must_use]
    pub const fn hard(self) -> Self {
        const HARD: Conditions = Conditions::between(Class::Stop, Class::Cut);
        self.both(HARD)
    }

    /// The members of class degraded.
    #[must_use]
    pub const fn degraded(self) -> Self {
        const DEGRADED: Conditions = Conditions::between(Class::Degraded, Class::Degraded);
        self.both(DEGRADED)
    }

    /// True if `condition` is in the set.
    pub const fn contains(self, condition: Condition) -> bool {
        self.0 & (1 << condition as u8) != 0
    }

    /// Union of the sets.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Intersection of the sets.
    #[must_use]
    pub const fn both(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// The members of class notice and degraded.
    #[must_use]
    pub const fn soft(self) -> Self {
        const SOFT: Conditions = Conditions::between(Class::Notice, Class::Degraded);
        self.both(SOFT)
    }

    /// The set as bits.
    pub const fn bits(self) -> u64 {
        self.0
    }

    /// Set of these bits; unknown bits, which other versions may have, are kept.
    pub const fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// True if the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The conditions in the set.
    pub fn iter(self) -> impl Iterator<Item = Condition> {
        let mut rest = self.0;
        core::iter::from_fn(move || {
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                if let Some(Some(condition)) = BY_BIT.get(bit) {
                    return Some(*condition);
                }
            }
            None
        })
    }

    /// The most severe condition; the first in the table among equals.
    pub fn worst(self) -> Option<Condition> {
        self.iter()
            .reduce(|worst, c| if c.class() > worst.class() { c } else { worst })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop, prop_assert_eq};

    #[test]
    fn codes_are_unique_and_rise_within_the_table() {
        for pair in TABLE.windows(2) {
            assert!(pair[0].code < pair[1].code, "{}", pair[1].name);
        }
        assert!(TABLE[0].code > 0, "zero means no code");
    }

    /// Reserved codes and bits stay unused, so that those in logs of earlier versions keep their meaning.
    #[test]
    fn reserved_codes_and_bits_have_no_condition() {
        for code in [0x04, 0xc6] {
            assert_eq!(Condition::from_code(code), None);
        }
        for (condition, bit) in [
            (Condition::TorqueLimited, 0),
            (Condition::MessageLost, 4),
            (Condition::BeamLost, 13),
            (Condition::MotorUnresponsive, 34),
            (Condition::StopNotFollowed, 37),
        ] {
            assert_eq!(condition as u8, bit, "{condition:?}");
        }
        let mut unknown = Conditions::from_bits(1 << 46 | 1 << 13 | 1 << 63).iter();
        assert_eq!(unknown.next(), Some(Condition::BeamLost));
        assert_eq!(unknown.next(), None);
    }

    #[test]
    fn every_row_has_its_condition_and_texts() {
        for (condition, entry) in Condition::ALL.into_iter().zip(&TABLE) {
            assert_eq!(entry.condition, condition);
            assert_eq!(Condition::from_code(condition.code()), Some(condition));
            assert!(entry.name.len() > 3 && entry.meaning.len() > 10 && entry.remedy.len() > 5);
        }
        assert_eq!(Condition::from_code(0), None);
        assert_eq!(Condition::from_code(0xff), None);
    }

    #[test]
    fn worst_condition_has_the_highest_class() {
        let set = Conditions::only(Condition::TickLate)
            .with(Condition::SupplyLow, true)
            .with(Condition::FrameBent, true)
            .with(Condition::NotANumber, false);
        assert_eq!(set.worst(), Some(Condition::FrameBent));
        assert_eq!(Conditions::NONE.worst(), None);
    }

    properties! {
        #[test]
        fn conditions_match_a_set_of_the_standard_library(members in prop::collection::btree_set(0..COUNT, 0..COUNT)) {
            let mut set = Conditions::NONE;
            for &k in &members {
                set.set(Condition::ALL[k], true);
            }
            let mut members: Vec<Condition> = members.iter().map(|&k| Condition::ALL[k]).collect();
            members.sort_by_key(|&condition| condition as u8);
            prop_assert_eq!(set.iter().collect::<Vec<_>>(), members);
        }
    }
}
