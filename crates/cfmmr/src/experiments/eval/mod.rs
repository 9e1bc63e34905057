//! Single on-board algorithms on cases from standard input: one JSON object per line in, one result per line out, for
//! comparison with other implementations.

pub mod bus;
pub mod cascade;
pub mod check;
pub mod ci;
pub mod ekf;
pub mod frame;
pub mod ipec;
pub mod kinematic;
pub mod rps;

use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::io::{self, BufRead, ErrorKind, Read, Write};

/// Maximum length of an input line, bytes.
const LONGEST_LINE: u64 = 8 << 20;

/// Algorithm that evaluates one line at a time.
pub trait Kernel {
    /// Result of one input line, or an error that names the wrong field. A configuration line gives
    /// [`Value::Null`], for which nothing is written.
    fn line(&mut self, text: &str) -> Result<Value, String>;
}

/// State of a kernel whose first line configures it.
#[derive(Clone, Debug, Default)]
pub enum KernelState<T> {
    /// No line was read.
    #[default]
    Unconfigured,
    /// The first line was refused; every later line is refused too.
    Refused,
    /// The first line was accepted.
    Running(T),
}

impl<T> KernelState<T> {
    /// Result of a line: `start` evaluates the first line, `step` every later line.
    fn line<Setup: DeserializeOwned, Step: DeserializeOwned>(
        &mut self,
        text: &str,
        start: impl FnOnce(&Setup) -> Result<T, String>,
        step: impl FnOnce(&mut T, &Step) -> Result<Value, String>,
    ) -> Result<Value, String> {
        match self {
            Self::Refused => {
                Err("the first line was rejected, so the algorithm is not configured".to_owned())
            }
            Self::Running(run) => step(run, &parse(text)?),
            Self::Unconfigured => {
                *self = Self::Refused;
                *self = Self::Running(start(&parse(text)?)?);
                Ok(Value::Null)
            }
        }
    }
}

/// Reads one JSON object; an error names the field.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let mut reader = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string();
        match path.as_str() {
            "." => error.inner().to_string(),
            path => format!("{path}: {}", error.inner()),
        }
    })?;
    reader.end().map_err(|error| error.to_string())?;
    Ok(value)
}

/// Evaluates each line of `input` by `kernel` and writes one line of JSON. A refused line gives `{"error": …}` and does
/// not stop the run. Empty lines are skipped. Returns true if no line was refused.
pub fn run(
    kernel: &mut dyn Kernel,
    mut input: impl BufRead,
    mut output: impl Write,
) -> io::Result<bool> {
    let mut good = true;
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = input
            .by_ref()
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line);
        if read.map_err(|error| io::Error::new(ErrorKind::InvalidInput, error))? == 0 {
            break;
        }
        if line.len() as u64 == LONGEST_LINE && !line.ends_with(b"\n") {
            let what = format!("a line is longer than {LONGEST_LINE} bytes");
            return Err(io::Error::new(ErrorKind::InvalidInput, what));
        }
        let result = std::str::from_utf8(&line)
            .map_err(|error| format!("line is not UTF-8: {error}"))
            .and_then(|text| match text.trim() {
                "" => Ok(None),
                text => kernel.line(text).map(Some),
            });
        match result {
            Ok(None | Some(Value::Null)) => {}
            Ok(Some(value)) => writeln!(output, "{value}")?,
            Err(error) => {
                good = false;
                writeln!(output, "{}", json!({ "error": error }))?;
            }
        }
    }
    output.flush()?;
    Ok(good)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct DoubleCase {
        length: f32,
    }

    struct Double;

    impl Kernel for Double {
        fn line(&mut self, text: &str) -> Result<Value, String> {
            let case: DoubleCase = parse(text)?;
            if case.length == 0.0 {
                return Ok(Value::Null);
            }
            Ok(json!({ "twice": 2.0 * case.length }))
        }
    }

    #[test]
    fn error_names_the_field_and_later_lines_run() {
        let input =
            b"{\"length\": \"a\"}\n\n{\"length\": 0}\n{\"length\": 2}\n{\"width\": 1}\n\xff\n"
                as &[u8];
        let mut output = Vec::new();
        assert!(!run(&mut Double, input, &mut output).unwrap());
        let lines: Vec<Value> = String::from_utf8(output)
            .unwrap()
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert!(lines[0]["error"].as_str().unwrap().starts_with("length: "));
        assert_eq!(lines[1]["twice"], 4.0);
        assert!(lines[2]["error"].as_str().unwrap().contains("width"));
        assert!(lines[3]["error"].as_str().unwrap().contains("UTF-8"));
        assert_eq!(lines.len(), 4);
    }
}
