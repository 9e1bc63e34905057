//! Log of a virtual board: defmt frames, decoded line by line.

use core_algos::topology::Topology;
#[cfg(feature = "board-logs")]
use defmt_decoder::{DecodeError, Table};
#[cfg(feature = "board-logs")]
use defmt_parser::Level;
use host_sim::base::error::Error;
use output::files::OutputDir;
#[cfg(not(feature = "board-logs"))]
use output::terminal::left_out;
use output::terminal::note;
use std::io::Read;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

/// Lines of a board's log, over all starts of the board.
#[derive(Clone, Debug)]
pub struct BoardLog {
    /// Name of the board.
    board: &'static str,
    lines: Arc<Mutex<String>>,
    quiet: bool,
}

impl BoardLog {
    /// Empty log of a board with this name.
    pub fn new(board: &'static str) -> Self {
        Self {
            board,
            lines: Arc::default(),
            quiet: false,
        }
    }

    /// Empty logs of a robot's boards.
    pub fn of_boards(robot: Topology) -> Vec<Self> {
        let boards = robot.boards();
        boards.map(|role| Self::new(robot.name(role))).collect()
    }

    /// Empty logs of a robot's boards; warnings and errors are not repeated on standard error.
    pub fn quiet(robot: Topology) -> Vec<Self> {
        let mut logs = Self::of_boards(robot);
        logs.iter_mut().for_each(|log| log.quiet = true);
        logs
    }

    /// Decoded lines of the log so far.
    pub fn text(&self) -> String {
        self.lines
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn append(&self, line: &str) {
        let mut text = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        text.push_str(line);
        text.push('\n');
    }

    /// Decodes the log of a board that runs this image, until the log ends. Repeats warnings and errors on standard
    /// error.
    #[cfg(feature = "board-logs")]
    pub fn follow(
        &self,
        image: Arc<Vec<u8>>,
        mut from: impl Read + Send + 'static,
    ) -> JoinHandle<()> {
        let log = self.clone();
        thread::spawn(move || {
            let Ok(Some(table)) = Table::parse(&image) else {
                return log.append("the image contains no table of log messages");
            };
            let mut decoder = table.new_stream_decoder();
            let mut buffer = [0; 1024];
            while let Ok(count @ 1..) = from.read(&mut buffer) {
                decoder.received(buffer.get(..count).unwrap_or_default());
                loop {
                    match decoder.decode() {
                        Ok(frame) => {
                            let line = frame.display(false).to_string();
                            if !log.quiet && frame.level().is_some_and(|level| level >= Level::Warn)
                            {
                                note(format!("{} board: {line}", log.board));
                            }
                            log.append(&line);
                        }
                        Err(DecodeError::UnexpectedEof) => break,
                        Err(DecodeError::Malformed) => log.append("a damaged log message"),
                    }
                }
            }
        })
    }

    /// Reads the log of a board until its end without decoding it: this build has no decoder.
    #[cfg(not(feature = "board-logs"))]
    pub fn follow(
        &self,
        _image: Arc<Vec<u8>>,
        mut from: impl Read + Send + 'static,
    ) -> JoinHandle<()> {
        let log = self.clone();
        thread::spawn(move || {
            let mut buffer = [0; 1024];
            let mut written = false;
            while let Ok(1..) = from.read(&mut buffer) {
                if !std::mem::replace(&mut written, true) {
                    let error = left_out(&format!("text of the {} board's log", log.board));
                    log.append(&error.to_string());
                    if !log.quiet {
                        note(error);
                    }
                }
            }
        })
    }
}

/// Returns the result of a run. On an error, writes the logs to the output folder first, where they may show the
/// reason.
pub fn keep_logs_on_error<T>(
    result: Result<T, Error>,
    logs: &[BoardLog],
    output: impl FnOnce() -> Result<OutputDir, Error>,
) -> Result<T, Error> {
    if result.is_err() {
        let logs = files(logs);
        let mut files = output()?;
        if !logs.is_empty() {
            for (name, text) in logs {
                files.text(&name, text);
            }
            files.commit()?;
        }
    }
    result
}

/// Logs that are not empty: file names and contents.
pub fn files(logs: &[BoardLog]) -> Vec<(String, String)> {
    let named = logs.iter();
    let named = named.map(|log| (format!("board-{}.log", log.board), log.text()));
    named.filter(|(_, text)| !text.is_empty()).collect()
}
