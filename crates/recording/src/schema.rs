//! Schemas of a log's messages. Each message is declared once, as a struct, and its schema follows from the
//! declaration.

use output::files::Cell;
use serde_json::{Value, json};

/// Type of a message's field in a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Integer.
    Integer,
    /// Number; a board's NaN or infinity is written as its bits in hexadecimal.
    Number,
    /// Boolean.
    Truth,
    /// Text.
    Text,
    /// Bytes in hexadecimal.
    Bytes,
    /// List of this many integers; missing integers are null.
    Integers(usize),
    /// List of this many numbers.
    Numbers(usize),
    /// A list of texts.
    Texts,
    /// Object with x_m, y_m (m) and phi_rad (rad).
    Pose,
    /// A posture and its covariance.
    Estimate,
    /// List of frames, each with name, frame and message; the fields of the message depend on the name.
    Frames,
}

/// One field of a message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name of the field.
    pub name: &'static str,
    /// Type of the field.
    pub kind: Kind,
    /// True if the field may be null.
    pub optional: bool,
    /// Unit and meaning of the field.
    pub text: &'static str,
}

/// Schema of a message.
#[derive(Clone, Copy, Debug)]
pub struct Schema {
    /// Name of the schema. A message with a Foxglove schema is encoded as protobuf, a message of this project as JSON.
    pub name: &'static str,
    /// Description of the message.
    pub text: &'static str,
    /// Fields; empty if the schema is Foxglove's.
    pub fields: &'static [Field],
}

/// Rust type that can be a field of a message.
pub trait Logged {
    /// Field type in the schema.
    const KIND: Kind;
    /// True if the field may be null.
    const OPTIONAL: bool = false;

    /// Appends a cell for each of [`Kind::columns`].
    fn cells(&self, to: &mut Vec<Cell>);
}

impl<T: Logged> Logged for Option<T> {
    const KIND: Kind = T::KIND;
    const OPTIONAL: bool = true;

    fn cells(&self, to: &mut Vec<Cell>) {
        match self {
            Some(value) => value.cells(to),
            None => to.extend(T::KIND.columns().iter().map(|_| Cell::Empty)),
        }
    }
}

/// Declares for Rust types their kind in a schema and their cells in a table.
macro_rules! kinds {
    ($($kind:expr => $type:ty, $value:ident: $cells:expr;)*) => {$(
        impl $crate::schema::Logged for $type {
            const KIND: Kind = $kind;

            fn cells(&self, to: &mut Vec<Cell>) {
                let $value = self;
                to.extend($cells);
            }
        }
    )*};
}

/// Declares messages: structs with name and meaning, and their fields with unit and meaning.
macro_rules! messages {
    ($($(#[$attribute:meta])* pub struct $type:ident = $name:literal, $text:literal {
        $($field:ident: $kind:ty, $meaning:literal;)*
    })*) => {$(
        #[doc = $text]
        $(#[$attribute])*
        pub struct $type {
            $(#[doc = $meaning] pub $field: $kind,)*
        }

        impl $type {
            /// Schema of the message.
            pub const SCHEMA: Schema = Schema {
                name: $name,
                text: $text,
                fields: &[$(Field {
                    name: stringify!($field),
                    kind: <$kind as $crate::schema::Logged>::KIND,
                    optional: <$kind as $crate::schema::Logged>::OPTIONAL,
                    text: $meaning,
                },)*],
            };

            /// Cells of the columns in a table, in the order of [`Schema::columns`].
            pub fn cells(&self) -> Vec<Cell> {
                let mut cells = Vec::new();
                $($crate::schema::Logged::cells(&self.$field, &mut cells);)*
                cells
            }
        }
    )*};
}

pub(super) use {kinds, messages};

/// JSON schema of a list of `count` items; of a list of any length if `count` is `None`.
fn list(items: &Value, count: Option<usize>) -> Value {
    let mut schema = json!({ "type": "array", "items": items });
    if let Some(count) = count {
        schema["minItems"] = count.into();
        schema["maxItems"] = count.into();
    }
    schema
}

/// JSON schema of an object with exactly these properties.
fn object<'a>(properties: impl IntoIterator<Item = (&'a str, Value)>) -> Value {
    let (names, schemas): (Vec<_>, Vec<_>) = properties.into_iter().unzip();
    let named = names.iter().map(|name| (*name).to_owned()).zip(schemas);
    let properties: serde_json::Map<_, _> = named.collect();
    json!({
        "type": "object", "additionalProperties": false, "required": names, "properties": properties,
    })
}

impl Kind {
    /// Suffixes that give the names of the columns when appended to the field's name, such as `.x_m`; an empty list for
    /// bytes, frames and lists of variable length, which have no columns.
    pub fn columns(self) -> Vec<String> {
        let numbered = |n: usize| (0..n).map(|i| format!("[{i}]")).collect();
        let pose = [".x_m", ".y_m", ".phi_rad"].map(str::to_owned).to_vec();
        match self {
            Self::Integer | Self::Number | Self::Truth | Self::Text => vec![String::new()],
            Self::Integers(n) | Self::Numbers(n) => numbered(n),
            Self::Pose => pose,
            Self::Estimate => {
                let covariance = (0..9).map(|i| format!(".covariance[{}][{}]", i / 3, i % 3));
                pose.into_iter().chain(covariance).collect()
            }
            Self::Bytes | Self::Texts | Self::Frames => Vec::new(),
        }
    }

    fn schema(self) -> Value {
        let text = json!({ "type": "string" });
        let number = json!({ "type": ["number", "string", "null"] });
        let pose = [("x_m", "m"), ("y_m", "m"), ("phi_rad", "rad")]
            .map(|(name, unit)| (name, json!({ "type": "number", "description": unit })));
        match self {
            Self::Integer => json!({ "type": "integer" }),
            Self::Number => number,
            Self::Truth => json!({ "type": "boolean" }),
            Self::Text | Self::Bytes => text,
            Self::Integers(n) => list(&json!({ "type": ["integer", "null"] }), Some(n)),
            Self::Numbers(n) => list(&number, Some(n)),
            Self::Texts => list(&text, None),
            Self::Pose => object(pose),
            Self::Estimate => {
                let mut covariance = list(&list(&number, Some(3)), Some(3));
                covariance["description"] = "m², m rad, rad²: covariance of (x, y, phi)".into();
                object(pose.into_iter().chain([("covariance", covariance)]))
            }
            Self::Frames => {
                let message = json!({ "type": ["object", "null"] });
                let frame = object([
                    ("name", text.clone()),
                    ("frame", text),
                    ("message", message),
                ]);
                list(&frame, None)
            }
        }
    }
}

impl Schema {
    /// Names of the message's columns in a table.
    pub fn columns(&self) -> Vec<String> {
        let columns = |field: &Field| {
            let name = field.name;
            let suffixes = field.kind.columns().into_iter();
            suffixes.map(move |suffix| format!("{name}{suffix}"))
        };
        self.fields.iter().flat_map(columns).collect()
    }

    /// The schema as JSON schema.
    pub fn json(&self) -> String {
        let property = |field: &Field| {
            let mut schema = field.kind.schema();
            schema["description"] = field.text.into();
            if field.optional
                && let Some(text) = schema["type"].as_str()
            {
                schema["type"] = json!([text, "null"]);
            }
            (field.name.to_owned(), schema)
        };
        let properties: serde_json::Map<_, _> = self.fields.iter().map(property).collect();
        let required: Vec<_> = self.fields.iter().map(|field| field.name).collect();
        json!({
            "$schema": "http://json-schema.org/draft-07/schema#",
            "title": self.name,
            "description": self.text,
            "type": "object",
            "additionalProperties": false,
            "required": required,
            "properties": properties,
        })
        .to_string()
    }
}
