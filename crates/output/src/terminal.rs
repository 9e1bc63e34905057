//! Text on the terminal: standard output and its width.

use host_sim::base::error::Error;
use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

/// Columns of the terminal at standard output; 80 without a terminal.
pub fn width() -> usize {
    let size = rustix::termios::tcgetwinsize(io::stdout());
    match size {
        Ok(size) if size.ws_col > 0 => size.ws_col.into(),
        _ => 80,
    }
}

/// Prints a line to standard error; errors of printing are ignored.
pub fn note(text: impl Display) {
    let text = text.to_string();
    let _ = writeln!(io::stderr(), "{}", short_numbers(&visible(&text)));
}

/// Prints to standard output; a pipe closed by its reader is no error.
pub fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out
        .write_all(visible(text).as_bytes())
        .and_then(|()| out.flush())
    {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Error::Failure(format!(
            "cannot write to standard output: {error}"
        ))),
        _ => Ok(()),
    }
}

/// Text with control characters escaped as in JSON. Names come from files and may hold terminal codes or characters
/// that change the direction of writing.
pub fn visible(text: &str) -> Cow<'_, str> {
    let is_hidden = |c: char| {
        c.is_control() && c != '\n' && c != '\t'
            || matches!(c, '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match is_hidden(c) {
            true => shown += &format!("\\u{:04x}", u32::from(c)),
            false => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

/// Text in which numbers of more than 40 digits are shortened.
fn short_numbers(text: &str) -> Cow<'_, str> {
    const MOST: usize = 40;
    const KEPT: usize = 8;
    let is_digit = |c: char| c.is_ascii_digit();
    if !text
        .split(|c| !is_digit(c))
        .any(|digits| digits.len() > MOST)
    {
        return Cow::Borrowed(text);
    }
    let (mut short, mut rest) = (String::new(), text);
    while let Some(start) = rest.find(is_digit) {
        let (before, digits) = rest.split_at(start);
        let (digits, after) =
            digits.split_at(digits.find(|c| !is_digit(c)).unwrap_or(digits.len()));
        short += before;
        match digits.len() > MOST {
            true => short += &format!("{}… ({} digits)", &digits[..KEPT], digits.len()),
            false => short += digits,
        }
        rest = after;
    }
    Cow::Owned(short + rest)
}

/// True if standard input and standard output are terminals.
pub fn is_interactive() -> bool {
    io::stdin().is_terminal() && io::stdout().is_terminal()
}

/// Prints a page of Markdown: unchanged to a file or a pipe, laid out on a terminal.
pub fn print_page(markdown: &str) -> Result<(), Error> {
    if !io::stdout().is_terminal() {
        return print(markdown);
    }
    #[cfg(feature = "pages")]
    let markdown = &termimad::MadSkin::no_style()
        .text(markdown, Some(width()))
        .to_string();
    print(markdown)
}

/// Error for a feature that is not in this build, with the command that builds it.
pub fn left_out(part: &str) -> Error {
    let arguments = std::env::args().skip(1).collect::<Vec<_>>();
    let arguments = shlex::try_join(arguments.iter().map(String::as_str)).unwrap_or_default();
    Error::input(format!(
        "{part}: not in this build; type: cargo cfmmr {arguments}"
    ))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_many_digits_are_cut() {
        let long = format!("a = 1.5, b = -{}.25", "9".repeat(60));
        assert_eq!(
            short_numbers(&long),
            "a = 1.5, b = -99999999… (60 digits).25"
        );
        let most = "1".repeat(40);
        assert_eq!(short_numbers(&most), most);
    }

    #[test]
    fn control_characters_are_escaped_and_json_stays_json() {
        assert_eq!(visible("name\u{1b}[31m\n\tµ"), "name\\u001b[31m\n\tµ");
        assert_eq!(
            visible("a\r\u{7}\u{7f}\u{9b}\u{202e}"),
            "a\\u000d\\u0007\\u007f\\u009b\\u202e"
        );
        let json = serde_json::json!({ "name": "a\u{202e}\u{9b}\u{1b}" });
        let shown = visible(&json.to_string()).into_owned();
        assert!(shown.is_ascii());
        assert_eq!(
            serde_json::from_str::<serde_json::Value>(&shown).unwrap(),
            json
        );
    }
}
