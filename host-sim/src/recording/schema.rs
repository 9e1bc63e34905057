//! Schemas of a log's messages: each message is declared once, as a struct of which the schema follows.

use serde_json::{Value, json};

/// Type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A whole number.
    Integer,
    /// A number; of the boards one that is not finite stands as its bits in hexadecimal.
    Number,
    /// Yes or no.
    Truth,
    /// Text.
    Text,
    /// A list of so many whole numbers; those missing are null.
    Integers(usize),
    /// A list of so many numbers.
    Numbers(usize),
    /// A list of numbers.
    List,
    /// A list of texts.
    Texts,
    /// x_m, y_m (m) and phi_rad (rad).
    Pose,
    /// A posture and its covariance.
    Estimate,
    /// A list of frames, each with name, frame and message, whose fields depend on the name.
    Frames,
}

/// One field of a message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// Type.
    pub kind: Kind,
    /// True if the field may be null.
    pub optional: bool,
    /// Unit and meaning.
    pub text: &'static str,
}

/// A kind of message.
#[derive(Clone, Copy, Debug)]
pub struct Schema {
    /// Name; those of Foxglove are encoded as protobuf, ours as JSON.
    pub name: &'static str,
    /// Description of the message.
    pub text: &'static str,
    /// Fields; none where the schema is Foxglove's.
    pub fields: &'static [Field],
}

/// A type that a field of a message may have.
pub trait Logged {
    /// Its kind.
    const KIND: Kind;
    /// True if it may be null.
    const OPTIONAL: bool = false;
}

impl<T: Logged> Logged for Option<T> {
    const KIND: Kind = T::KIND;
    const OPTIONAL: bool = true;
}

/// Declares kinds of types.
macro_rules! kinds {
    ($($kind:expr => $($type:ty),+;)*) => {$($(
        impl $crate::recording::schema::Logged for $type {
            const KIND: Kind = $kind;
        }
    )+)*};
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
            /// Its schema.
            pub const SCHEMA: Schema = Schema {
                name: $name,
                text: $text,
                fields: &[$(Field {
                    name: stringify!($field),
                    kind: <$kind as $crate::recording::schema::Logged>::KIND,
                    optional: <$kind as $crate::recording::schema::Logged>::OPTIONAL,
                    text: $meaning,
                },)*],
            };
        }
    )*};
}

pub(super) use {kinds, messages};

impl Kind {
    fn schema(self) -> Value {
        let number = json!({ "type": ["number", "string", "null"] });
        let pose = [("x_m", "m"), ("y_m", "m"), ("phi_rad", "rad")];
        let mut properties: serde_json::Map<String, Value> = pose
            .into_iter()
            .map(|(name, unit)| {
                (
                    name.to_owned(),
                    json!({ "type": "number", "description": unit }),
                )
            })
            .collect();
        match self {
            Self::Integer => json!({ "type": "integer" }),
            Self::Number => number,
            Self::Truth => json!({ "type": "boolean" }),
            Self::Text => json!({ "type": "string" }),
            Self::Integers(n) => json!({
                "type": "array", "minItems": n, "maxItems": n,
                "items": { "type": ["integer", "null"] },
            }),
            Self::Numbers(n) => {
                json!({ "type": "array", "minItems": n, "maxItems": n, "items": number })
            }
            Self::List => json!({ "type": "array", "items": number }),
            Self::Texts => json!({ "type": "array", "items": { "type": "string" } }),
            Self::Pose => json!({
                "type": "object", "additionalProperties": false,
                "required": ["x_m", "y_m", "phi_rad"], "properties": properties,
            }),
            Self::Estimate => {
                let row = json!({ "type": "array", "minItems": 3, "maxItems": 3, "items": number });
                let covariance = json!({
                    "description": "m², m rad, rad²: covariance of (x, y, phi)",
                    "type": "array", "minItems": 3, "maxItems": 3, "items": row,
                });
                properties.insert("covariance".to_owned(), covariance);
                json!({
                    "type": "object", "additionalProperties": false,
                    "required": ["x_m", "y_m", "phi_rad", "covariance"], "properties": properties,
                })
            }
            Self::Frames => {
                let text = json!({ "type": "string" });
                json!({
                    "type": "array",
                    "items": {
                        "type": "object", "additionalProperties": false,
                        "required": ["name", "frame", "message"],
                        "properties": {
                            "name": text, "frame": text, "message": { "type": ["object", "null"] },
                        },
                    },
                })
            }
        }
    }
}

impl Schema {
    /// As JSON schema.
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
