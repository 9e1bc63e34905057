//! Macros for enumerations with a list of their values and names.

/// An enumeration with the list of its values and their names.
macro_rules! enumeration {
    ($(#[$attribute:meta])* $name:ident { $($(#[$note:meta])* $value:ident,)+ }) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
        pub enum $name { $($(#[$note])* $value,)+ }

        impl $name {
            /// Every value, in the order of its number.
            pub const ALL: [Self; [$(stringify!($value)),+].len()] = [$(Self::$value),+];

            /// Name of the value.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$value => stringify!($value),)+ }
            }
        }
    };
}

/// An enumeration that is sent on the bus as a number; each value has a name in the bus description.
macro_rules! wire_enum {
    ($(#[$attribute:meta])* $name:ident { $($(#[$note:meta])* $value:ident = $label:literal,)+ }) => {
        enumeration! { $(#[$attribute])* #[derive(Default)] $name { $($(#[$note])* $value,)+ } }

        impl $name {
            /// Names in the bus description, in the order of the numbers.
            pub const NAMES: [&'static str; Self::ALL.len()] = [$($label),+];

            /// The value with this number.
            pub fn from_number(number: u8) -> Option<Self> {
                Self::ALL.get(usize::from(number)).copied()
            }
        }
    };
}
