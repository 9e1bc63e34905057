//! Bits of registers.

/// Bits of registers: a constant for each name and place.
macro_rules! bits {
    (pub($scope:tt): $($name:ident $bit:literal),* $(,)?) => {
        $(pub($scope) const $name: u32 = 1 << $bit;)*
    };
    ($($name:ident $bit:literal),* $(,)?) => { $(const $name: u32 = 1 << $bit;)* };
}
