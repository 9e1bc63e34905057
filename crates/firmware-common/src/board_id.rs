//! Strap that selects the axle of an axle board: PC13 open is the front axle, PC13 at ground the axle that the image
//! names.
//!
//! No board stores an axle: on a two-axle robot a grounded strap means [`REAR`].

use core_algos::topology::AxleId;
#[cfg(target_os = "none")]
use embassy_stm32::{
    Peri,
    gpio::{Input, Pull},
    peripherals::PC13,
};

/// Axle of a board with a grounded strap in a two-axle robot.
pub const REAR: AxleId = AxleId(1);

/// Level of the strap pin that selects the axle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strap {
    /// Strap pin not connected: front axle.
    Open,
    /// Strap pin connected to ground: the axle that the image names.
    Ground,
}

impl Strap {
    /// Reads the strap; call it once, at the start of the board.
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

    /// Axle of the board; `grounded_axle` is the axle for a grounded strap.
    pub const fn axle(self, grounded_axle: AxleId) -> AxleId {
        match self {
            Self::Open => AxleId(0),
            Self::Ground => grounded_axle,
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

    /// An open strap is always axle 0: a board with a missing strap never drives as an inner axle.
    #[test]
    fn grounded_axle_counts_only_with_the_strap_at_ground() {
        for grounded_axle in (1..MAX_AXLES as u8).map(AxleId) {
            assert_eq!(Strap::Open.axle(grounded_axle), AxleId(0));
            assert_eq!(Strap::Ground.axle(grounded_axle), grounded_axle);
        }
    }
}
