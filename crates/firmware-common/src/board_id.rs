//! Strap that selects the kind of an axle board: PC13 open is the front axle, PC13 at ground the axle whose place the
//! board stores.

use core_algos::params::BoardKind;
#[cfg(target_os = "none")]
use embassy_stm32::{
    Peri,
    gpio::{Input, Pull},
    peripherals::PC13,
};

/// Level of the strap pin that selects the kind of an axle board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strap {
    /// Strap pin not connected: front axle.
    Open,
    /// Strap pin connected to ground: the axle of the parameter `board.place`.
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

    /// Kind of the board.
    pub const fn kind(self) -> BoardKind {
        match self {
            Self::Open => BoardKind::FrontAxle,
            Self::Ground => BoardKind::PlacedAxle,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::params::Settings;
    use core_algos::topology::{MAX_AXLES, Role, Topology};

    #[test]
    fn axle_boards_without_a_place_are_front_and_rear() {
        let boards = [Strap::Open, Strap::Ground].map(|strap| strap.kind().unplaced());
        let names = boards.map(|board| Topology::PAIR.name(board));
        assert_eq!(names, ["front", "rear"]);
    }

    /// An open strap is always axle 0: a board with a broken strap never drives as an inner axle.
    #[test]
    fn stored_place_counts_only_with_the_strap_at_ground() {
        let mut settings = Settings::default();
        settings.robot.geometry.axles = MAX_AXLES as u32;
        for place in 1..MAX_AXLES as u8 {
            settings.board.place = place.into();
            let roles = [Strap::Open, Strap::Ground].map(|strap| settings.role(strap.kind()));
            assert_eq!(roles, [Ok(Role::LEAD), Ok(Role::axle(place))]);
        }
    }
}
