//! Serialized form of axles, boards and nodes: the names of a robot of two axles in text, numbers in binary formats.

use super::{AxleId, FrameId, MAX_AXLES, MAX_FRAMES, Node, Role, Topology};
use core::fmt;
use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A type with a name in text and a number in binary formats.
trait Named: Copy + 'static {
    const EXPECTED: &'static str;
    /// Every value that has a number.
    fn all() -> impl Iterator<Item = Self>;
    /// The values of a robot of two axles, which have a name.
    fn pair() -> impl Iterator<Item = Self>;
    fn name(self) -> &'static str;
    fn code(self) -> u8;
}

fn roles() -> impl Iterator<Item = Role> {
    let frames = (0..MAX_FRAMES as u8).map(Role::beam);
    (0..MAX_AXLES as u8).map(Role::axle).chain(frames)
}

impl Named for Role {
    const EXPECTED: &'static str = "a board: front, rear or beam";

    fn all() -> impl Iterator<Item = Self> {
        roles()
    }

    fn pair() -> impl Iterator<Item = Self> {
        Topology::PAIR.boards()
    }

    fn name(self) -> &'static str {
        Topology::PAIR.name(self)
    }

    /// The values of a robot of two axles come first, with the numbers of version 0.1.
    fn code(self) -> u8 {
        match self {
            Self::Axle(AxleId(axle @ ..2)) => axle,
            Self::Beam(FrameId(0)) => 2,
            Self::Axle(AxleId(axle)) => axle + 1,
            Self::Beam(FrameId(frame)) => MAX_AXLES as u8 + frame,
        }
    }
}

impl Named for AxleId {
    const EXPECTED: &'static str = "an axle: front or rear";

    fn all() -> impl Iterator<Item = Self> {
        (0..MAX_AXLES as u8).map(Self)
    }

    fn pair() -> impl Iterator<Item = Self> {
        Topology::PAIR.axles()
    }

    fn name(self) -> &'static str {
        Topology::PAIR.name(Role::Axle(self))
    }

    fn code(self) -> u8 {
        self.0
    }
}

impl Named for Node {
    const EXPECTED: &'static str = "a node: lead, front-axle, rear-axle, beam or service";

    fn all() -> impl Iterator<Item = Self> {
        let boards = roles().map(|role| match role {
            Role::Axle(axle) => Self::Axle(axle),
            Role::Beam(frame) => Self::Beam(frame),
        });
        [Self::Lead, Self::Service].into_iter().chain(boards)
    }

    fn pair() -> impl Iterator<Item = Self> {
        Topology::PAIR.nodes().chain([Self::Service])
    }

    fn name(self) -> &'static str {
        match self {
            Self::Lead => "lead",
            Self::Axle(AxleId(0)) => "front-axle",
            Self::Axle(AxleId(1)) => "rear-axle",
            Self::Axle(axle) => Topology::PAIR.name(Role::Axle(axle)),
            Self::Beam(frame) => Topology::PAIR.name(Role::Beam(frame)),
            Self::Service => "service",
        }
    }

    fn code(self) -> u8 {
        Self::all().position(|node| node == self).unwrap_or(0) as u8
    }
}

fn serialize<T: Named, S: Serializer>(value: T, serializer: S) -> Result<S::Ok, S::Error> {
    match serializer.is_human_readable() {
        true => serializer.serialize_str(value.name()),
        false => serializer.serialize_u8(value.code()),
    }
}

fn deserialize<'de, T: Named, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    struct Name<T>(core::marker::PhantomData<T>);

    impl<T: Named> Visitor<'_> for Name<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str(T::EXPECTED)
        }

        fn visit_str<E: Error>(self, name: &str) -> Result<T, E> {
            let found = T::pair().find(|value| value.name() == name);
            found.ok_or_else(|| E::invalid_value(Unexpected::Str(name), &self))
        }
    }

    if deserializer.is_human_readable() {
        return deserializer.deserialize_str(Name(core::marker::PhantomData));
    }
    let code = u8::deserialize(deserializer)?;
    let found = T::all().find(|value| value.code() == code);
    found.ok_or_else(|| D::Error::invalid_value(Unexpected::Unsigned(code.into()), &T::EXPECTED))
}

macro_rules! by_name {
    ($($named:ty)*) => {
        $(impl Serialize for $named {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serialize(*self, serializer)
            }
        }

        impl<'de> Deserialize<'de> for $named {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                deserialize(deserializer)
            }
        })*
    };
}
by_name! { AxleId Role Node }
