//! Axle of an axle board by a strap: PC13 open is the front axle, to ground the axle at the board's place.
//!
//! No board stores a place: a robot of two axles has one other axle, [`REAR`].

use core_algos::topology::AxleId;
#[cfg(target_os = "none")]
use embassy_stm32::{
    Peri,
    gpio::{Input, Pull},
    peripherals::PC13,
};

/// Place of a board with its strap at ground in a robot of two axles.
pub const REAR: AxleId = AxleId(1);

/// Level of the strap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strap {
    /// Not connected.
    Open,
    /// To ground.
    Ground,
}

impl Strap {
    /// Reads the strap; it counts at start only.
    #[cfg(target_os = "none")]
    pub fn read(pin: Peri<'static, PC13>) -> Self {
        let strap = Input::new(pin, Pull::Up);
        // The pull-up of 40 kΩ charges the pin's few picofarads within a microsecond.
        cortex_m::asm::delay(crate::clock::CORE_HZ / 100_000);
        match strap.is_high() {
            true => Self::Open,
            false => Self::Ground,
        }
    }

    /// The axle of a board that has this place if its strap is at ground.
    pub const fn axle(self, place: AxleId) -> AxleId {
        match self {
            Self::Open => AxleId(0),
            Self::Ground => place,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::topology::{MAX_AXLES, Role, Topology};

    #[test]
    fn boards_of_two_axles_are_front_and_rear() {
        let boards = [Strap::Open, Strap::Ground].map(|strap| Role::Axle(strap.axle(REAR)));
        let names = boards.map(|board| Topology::PAIR.name(board));
        assert_eq!(names, ["front", "rear"]);
    }

    /// An open strap is axle 0, whatever the store holds: a board without its strap never drives as an inner axle.
    #[test]
    fn place_counts_only_with_the_strap_at_ground() {
        for place in (1..MAX_AXLES as u8).map(AxleId) {
            assert_eq!(Strap::Open.axle(place), AxleId(0));
            assert_eq!(Strap::Ground.axle(place), place);
        }
    }
}
