//! The error every command ends with.

use core_algos::config::ConfigError;
use std::fmt;

/// Why a command failed.
#[derive(Debug)]
pub enum Error {
    /// Something the user gave is wrong; the text names the field, the value and what is allowed.
    Input(String),
    /// Something else failed (a file could not be written, a thread pool not started).
    Failure(String),
    /// The robot does not answer.
    NoAnswer(String),
    /// The user ended the run; the results are those of what was done.
    Interrupted(String),
}

impl Error {
    /// An error about the user's input.
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

/// Puts the table that holds a refused key before its name.
pub fn within(table: &str, checked: Result<(), ConfigError>) -> Result<(), Error> {
    checked.map_err(|error| Error::Input(format!("{table}.{error}")))
}

impl From<ConfigError> for Error {
    fn from(error: ConfigError) -> Self {
        Self::Input(error.to_string())
    }
}
