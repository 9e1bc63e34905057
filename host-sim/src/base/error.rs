//! Error type of all commands, with the exit code.

use core_algos::config::ConfigError;
use std::fmt;

/// Failure of a command.
#[derive(Debug)]
pub enum Error {
    /// Invalid user input; the text names the field, the value and the allowed range.
    Input(String),
    /// Other failure: a file cannot be written, a thread pool does not start.
    Failure(String),
    /// The robot does not answer.
    NoAnswer(String),
    /// The user interrupted the run; the results cover the finished part.
    Interrupted(String),
}

impl Error {
    /// Error of user input.
    pub fn input(text: impl Into<String>) -> Self {
        Self::Input(text.into())
    }

    /// The exit code of the process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::Failure(_) | Self::NoAnswer(_) => 1,
            Self::Interrupted(_) => 130,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
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

/// Prefixes the key in an error with the name of its table.
pub fn within(table: &str, checked: Result<(), ConfigError>) -> Result<(), Error> {
    checked.map_err(|error| Error::Input(format!("{table}.{error}")))
}

impl From<ConfigError> for Error {
    fn from(error: ConfigError) -> Self {
        Self::Input(error.to_string())
    }
}
