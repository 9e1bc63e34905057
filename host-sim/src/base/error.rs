//! Error type of all commands, with the exit code.

use core_algos::config::ConfigError;
use std::fmt;

/// Failure of a command, with the kind that selects the exit code.
#[derive(Clone, Debug)]
pub enum Error {
    /// Invalid user input; the text names the field, the value and the allowed range.
    Input(String),
    /// A parameter with a value that is not allowed.
    Parameter(Box<Refusal>),
    /// Other failure: a file cannot be written, a thread pool does not start.
    Failure(String),
    /// The robot does not answer.
    NoAnswer(String),
    /// The user interrupted the run; the results cover the finished part.
    Interrupted(String),
}

/// Refused value of a parameter, with the allowed values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Key of the parameter; several keys are joined by " or ".
    pub field: String,
    /// Refused value as text.
    pub value: String,
    /// Allowed values in words.
    pub allowed: String,
}

impl Refusal {
    /// Refusal from a failed range check; `before` precedes the name of the field, for example `plant.`.
    pub fn of(before: &str, error: &ConfigError) -> Self {
        let text = error.to_string();
        let field = text.split(" = ").next().unwrap_or_default();
        Self {
            field: format!("{before}{field}"),
            value: error.value.to_string(),
            allowed: error.allowed.to_string(),
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} = {}: must be {}",
            self.field, self.value, self.allowed
        )
    }
}

impl Error {
    /// Error about user input; `text` names field, value and allowed range.
    pub fn input(text: impl Into<String>) -> Self {
        Self::Input(text.into())
    }

    /// The refused value; `None` if the error is about no single value. An error in text form is parsed as
    /// `FIELD = VALUE: must be ALLOWED`; the name of a file and a line may precede it.
    pub fn refusal(&self) -> Option<Refusal> {
        let text = match self {
            Self::Parameter(refusal) => return Some((**refusal).clone()),
            Self::Input(text) => text,
            _ => return None,
        };
        let (before, allowed) = text.split_once(": must be ")?;
        let (field, value) = before.split_once(" = ")?;
        let field = field.rsplit(": ").next()?;
        Some(Refusal {
            field: field.to_owned(),
            value: value.to_owned(),
            allowed: allowed.to_owned(),
        })
    }

    /// The exit code of the process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) | Self::Parameter(_) => 2,
            Self::Failure(_) | Self::NoAnswer(_) => 1,
            Self::Interrupted(_) => 130,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(refusal) => refusal.fmt(f),
            Self::Input(text)
            | Self::Failure(text)
            | Self::NoAnswer(text)
            | Self::Interrupted(text) => f.write_str(text),
        }
    }
}

impl std::error::Error for Error {}

impl From<std::io::Error> for Error {
    fn from(error: std::io::Error) -> Self {
        Self::Failure(error.to_string())
    }
}

/// Result of a range check, with the name of the table before the key of a refused field.
pub fn within(table: &str, checked: Result<(), ConfigError>) -> Result<(), Error> {
    checked.map_err(|error| Refusal::of(&format!("{table}."), &error).into())
}

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        Self::Parameter(Box::new(refusal))
    }
}

impl From<ConfigError> for Error {
    fn from(error: ConfigError) -> Self {
        Refusal::of("", &error).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::config::positive;

    #[test]
    fn refusal_is_the_same_from_a_check_and_from_its_text() {
        let error = within("plant", positive("mass_kg", -1.5).map(drop)).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let text = Error::input(format!("file.toml: line 3: {error}"));
        let refusal = text.refusal().unwrap();
        assert_eq!(refusal.to_string(), error.to_string());
        assert_eq!(error.refusal(), Some(refusal));
        assert_eq!(Error::input("not TOML").refusal(), None);
        assert_eq!(Error::Failure(error.to_string()).refusal(), None);
    }
}
