//! Tables of a scenario or world file.

/// Declares a table (see the crate `declare`). A key that a file omits has its default.
macro_rules! table {
    ($(#[$doc:meta])* pub struct $($rest:tt)*) => {
        declare::declare! {
            $(#[$doc])*
            #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(deny_unknown_fields, default)]
            pub struct $($rest)*
        }
    };
}
pub(crate) use table;
