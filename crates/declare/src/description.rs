//! Description of a table of parameters.

use crate::Allowed;

/// Description of a parameter or of a table of parameters.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Key of the parameter or table in a configuration file.
    pub name: &'static str,
    /// Doc comment, lines joined; each line begins with a space.
    pub doc: &'static str,
    /// Kind of the value.
    pub kind: Kind,
}

/// Kind of a value: numbers, flag, name or table.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A number or a list of numbers.
    Number {
        /// Unit; empty for a pure number.
        unit: &'static str,
        /// Allowed values of each number.
        allowed: Allowed,
        /// True if the values are whole numbers.
        whole: bool,
    },
    /// A flag, true or false.
    Flag,
    /// A name, one of those listed here.
    Choice(&'static [Choice]),
    /// A table with these fields.
    Table(&'static [Field]),
}

/// Value of an enumeration.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// Name of the value in a configuration file.
    pub name: &'static str,
    /// Doc comment, in the form of [`Field::doc`].
    pub doc: &'static str,
}

/// Type of a key in a file.
pub trait Declared {
    /// Kind of the values of this type.
    const KIND: Kind;
}

impl Declared for bool {
    const KIND: Kind = Kind::Flag;
}

impl<T: Declared> Declared for Option<T> {
    const KIND: Kind = T::KIND;
}

impl Field {
    /// Meaning: the doc comment on one line.
    pub const fn meaning(&self) -> &'static str {
        self.doc.trim_ascii()
    }

    /// First sentence of the meaning.
    pub const fn summary(&self) -> &'static str {
        let text = self.meaning();
        let bytes = text.as_bytes();
        let mut end = 0;
        while end + 1 < bytes.len() && !(bytes[end] == b'.' && bytes[end + 1] == b' ') {
            end += 1;
        }
        text.split_at(end).0.trim_ascii()
    }
}

impl Kind {
    /// Unit; empty for a pure number and for a flag, a name or a table.
    pub const fn unit(&self) -> &'static str {
        match self {
            Self::Number { unit, .. } => unit,
            _ => "",
        }
    }
}

impl Choice {
    /// Meaning: the doc comment on one line.
    pub const fn meaning(&self) -> &'static str {
        self.doc.trim_ascii()
    }
}

/// Field at a path of keys separated by dots; `None` if no field has this path.
pub const fn find(fields: &'static [Field], path: &str) -> Option<Field> {
    let bytes = path.as_bytes();
    let (mut fields, mut start) = (fields, 0);
    loop {
        let mut end = start;
        while end < bytes.len() && bytes[end] != b'.' {
            end += 1;
        }
        let key = bytes.split_at(start).1.split_at(end - start).0;
        let mut i = 0;
        while i < fields.len() && !equal(fields[i].name.as_bytes(), key) {
            i += 1;
        }
        if i == fields.len() {
            return None;
        }
        match fields[i].kind {
            _ if end == bytes.len() => return Some(fields[i]),
            Kind::Table(inner) => fields = inner,
            _ => return None,
        }
        start = end + 1;
    }
}

/// Field at a path, for constants: an unknown path is a compile error.
pub const fn field_at(fields: &'static [Field], path: &str) -> Field {
    match find(fields, path) {
        Some(field) => field,
        None => panic!("no such key"),
    }
}

const fn equal(a: &[u8], b: &[u8]) -> bool {
    let mut i = 0;
    while i < a.len() && i < b.len() && a[i] == b[i] {
        i += 1;
    }
    i == a.len() && i == b.len()
}
