//! What tests of peripherals share.

use super::shared::Shared;
use super::surroundings::Bare;

/// What peripherals share, after a reset and with nothing around.
pub(crate) fn shared() -> Shared {
    Shared::new(Box::new(Bare), 0)
}
