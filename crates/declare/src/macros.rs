//! The macro `declare!`.

/// Declares a table of parameters or an enumeration; see the example of the crate.
///
/// A key is `pub name: type = default, "unit": allowed;` if it holds numbers, and
/// `pub name: type = default;` if its type is [`Declared`](crate::Declared). `allowed` is a constant
/// [`Allowed`](crate::Allowed). Keys in `derived { … }` are not read from files: the program sets them.
/// The caller adds the attributes of the type, such as derives.
#[macro_export]
macro_rules! declare {
    (
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $(
                $(#[doc = $doc:literal])+
                pub $field:ident: $type:ty = $default:expr $(, $unit:tt: $allowed:expr)?;
            )*
            $(derived {
                $(
                    $(#[doc = $derived_doc:literal])+
                    pub $derived:ident: $derived_type:ty = $derived_default:expr
                        $(, $derived_unit:tt: $derived_allowed:expr)?;
                )*
            })?
        }
    ) => {
        $(#[$attribute])*
        pub struct $name {
            $($(#[doc = $doc])+ $(#[doc = $crate::note!($unit, $allowed)])? pub $field: $type,)*
            $($(
                $(#[doc = $derived_doc])+
                $(#[doc = $crate::note!($derived_unit, $derived_allowed)])?
                #[cfg_attr(feature = "serde", serde(skip))]
                pub $derived: $derived_type,
            )*)?
        }

        impl Default for $name {
            fn default() -> Self {
                Self {
                    $($field: $default,)*
                    $($($derived: $derived_default,)*)?
                }
            }
        }

        impl $crate::Declared for $name {
            const KIND: $crate::Kind = $crate::Kind::Table(Self::FIELDS);
        }

        impl $name {
            /// Description of the keys.
            pub const FIELDS: &'static [$crate::Field] = {
                #[allow(unused_imports)]
                use $crate::Allowed::{Finite, NonNegative, OneOf, Positive, Range};
                &[$($crate::Field {
                    name: stringify!($field),
                    doc: concat!($($doc),+),
                    kind: $crate::kind!($type $(, $unit, $allowed)?),
                },)*]
            };

            /// Checks each number by itself; the error names its key.
            #[allow(dead_code, unused_imports)]
            pub(crate) fn check_ranges(&self) -> Result<(), $crate::ConfigError> {
                use $crate::Allowed::{Finite, NonNegative, OneOf, Positive, Range};
                $($($crate::Checked::check(&self.$field, stringify!($field), $allowed)?;)?)*
                $($($(
                    $crate::Checked::check(&self.$derived, stringify!($derived), $derived_allowed)?;
                )?)*)?
                Ok(())
            }
        }
    };
    (
        $(#[$attribute:meta])*
        pub enum $name:ident, default $default:ident {
            $($(#[doc = $doc:literal])+ $value:ident = $label:literal $(or $other:literal)?,)+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Eq)]
        pub enum $name {
            $(
                $(#[doc = $doc])+
                #[cfg_attr(feature = "serde", serde(rename = $label $(, alias = $other)?))]
                $value,
            )+
        }

        impl Default for $name {
            fn default() -> Self {
                Self::$default
            }
        }

        impl $crate::Declared for $name {
            const KIND: $crate::Kind = $crate::Kind::Choice(&[$($crate::Choice {
                name: $label,
                doc: concat!($($doc),+),
            },)+]);
        }

        impl $name {
            /// Every value, in the order of its number.
            pub const ALL: &'static [Self] = &[$(Self::$value),+];

            /// Name in a file.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $label,)+
                }
            }
        }
    };
}

/// Kind of a key's value: a number if unit and allowed values are given, otherwise the kind of its type.
#[doc(hidden)]
#[macro_export]
macro_rules! kind {
    ($type:ty) => {
        <$type as $crate::Declared>::KIND
    };
    ($type:ty, $unit:tt, $allowed:expr) => {
        $crate::Kind::Number {
            unit: $unit,
            allowed: $allowed,
            whole: <$type as $crate::Checked>::WHOLE,
        }
    };
}

/// Line of documentation with the unit and the allowed values.
#[doc(hidden)]
#[macro_export]
macro_rules! note {
    ("", $allowed:expr) => {
        concat!("\n\n`", stringify!($allowed), "`")
    };
    ($unit:tt, $allowed:expr) => {
        concat!("\n\n", $unit, ", `", stringify!($allowed), "`")
    };
}

#[cfg(test)]
mod tests {
    use crate::{Kind, field_at, find};

    declare! {
        /// Motor.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Motor {
            /// Torque at rest.
            ///
            /// Of one motor.
            pub torque_n_m: f64 = 2.0, "N m": Positive;
            /// Law of the
            /// current.
            pub law: Law = Law::Linear;
            derived {
                /// Time of a step.
                pub period_s: f32 = 1e-3, "s": Range(1e-4, 1.0);
            }
        }
    }

    declare! {
        /// Axle.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Axle {
            /// Left and right motor.
            pub motor: Motor = Motor::default();
            /// Teeth of each gear.
            pub teeth: [u32; 2] = [30, 31], "": OneOf(&[30.0, 31.0, 60.0]);
        }
    }

    declare! {
        /// Law.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Law, default Linear {
            /// In proportion.
            Linear = "linear",
            /// As its square.
            Square = "square",
        }
    }

    #[test]
    fn description_holds_declared_keys_without_derived_ones() {
        let names = Motor::FIELDS.iter().map(|field| field.name);
        assert!(names.eq(["torque_n_m", "law"]));
        const TORQUE: crate::Field = field_at(Axle::FIELDS, "motor.torque_n_m");
        assert_eq!(TORQUE.meaning(), "Torque at rest. Of one motor.");
        assert_eq!(TORQUE.summary(), "Torque at rest");
        assert!(matches!(
            TORQUE.kind,
            Kind::Number {
                unit: "N m",
                whole: false,
                ..
            }
        ));
        assert_eq!(
            field_at(Axle::FIELDS, "motor.law").meaning(),
            "Law of the current."
        );
        for nowhere in ["motor.torque", "motor.law.x", "", "motor..law", "teeth."] {
            assert!(find(Axle::FIELDS, nowhere).is_none(), "{nowhere}");
        }
        let Kind::Choice(laws) = <Law as crate::Declared>::KIND else {
            panic!()
        };
        assert!(
            laws.iter()
                .map(|law| law.name)
                .eq(Law::ALL.iter().map(|law| law.name()))
        );
        assert!(matches!(
            field_at(Axle::FIELDS, "teeth").kind,
            Kind::Number { whole: true, .. }
        ));
    }

    #[test]
    fn every_number_is_checked_derived_ones_included() {
        let good = Axle::default();
        assert_eq!(good.check_ranges(), Ok(()));
        assert_eq!((good.motor.law, good.motor.period_s), (Law::Linear, 1e-3));
        let mut bad = good;
        bad.teeth[1] = 32;
        let error = bad.check_ranges().unwrap_err();
        assert_eq!((error.field, error.index), ("teeth", [Some(1), None]));
        let mut bad = good.motor;
        bad.period_s = f32::NAN;
        assert_eq!(bad.check_ranges().unwrap_err().field, "period_s");
        bad.torque_n_m = 0.0;
        assert_eq!(bad.check_ranges().unwrap_err().field, "torque_n_m");
    }
}
