//! Text for people: standard output and its width.

use crate::base::error::Error;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// Columns of the terminal that standard output is; 80 where it is none.
pub fn width() -> usize {
    let size = rustix::termios::tcgetwinsize(io::stdout());
    match size {
        Ok(size) if size.ws_col > 0 => size.ws_col.into(),
        _ => 80,
    }
}

/// Prints a line for people to standard error; one that cannot be printed is lost.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Prints to standard output; a reader that has seen enough is no failure.
pub fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Error::Failure(format!(
            "cannot write to standard output: {error}"
        ))),
        _ => Ok(()),
    }
}

/// Prints a page: as it is into a file or a pipe, laid out for reading on a terminal.
pub fn print_page(markdown: &str) -> Result<(), Error> {
    if !io::stdout().is_terminal() {
        return print(markdown);
    }
    let skin = termimad::MadSkin::no_style();
    print(&skin.text(markdown, Some(width())).to_string())
}

/// Text with lines of at most the width of the terminal.
pub fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let length = lines[lines.len() - 1].chars().count();
        if length > 0 && length + 1 + word.chars().count() > width() {
            lines.push(String::new());
        }
        let line = lines.last_mut().expect("at least one line");
        *line += if line.is_empty() { "" } else { " " };
        *line += word;
    }
    lines.join("\n") + "\n"
}
