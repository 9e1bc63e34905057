//! Tables of a scenario or world file.

/// Declares a table, or the choices of a key (see the crate `declare`). A key that a file omits has its default.
macro_rules! table {
    ($(#[$doc:meta])* pub struct $($rest:tt)*) => {
        declare::declare! {
            $(#[$doc])*
            #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(deny_unknown_fields, default)]
            pub struct $($rest)*
        }
    };
    ($(#[$doc:meta])* pub enum $($rest:tt)*) => {
        declare::declare! {
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(rename_all = "kebab-case")]
            pub enum $($rest)*
        }
    };
}
pub(crate) use table;
