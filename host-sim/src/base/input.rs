//! Files that a user names: regular ones, of limited size.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Largest size of a text that people write, bytes.
const TEXT: u64 = 8 << 20;
/// Largest size of a log, a block of a campaign or a board's flash, bytes.
const DATA: u64 = 8 << 30;

/// Content of a file.
pub fn bytes(path: &Path) -> io::Result<Vec<u8>> {
    read(path, DATA)
}

/// Content of a file in UTF-8, without a byte-order mark.
pub fn text(path: &Path) -> io::Result<String> {
    let text = String::from_utf8(read(path, TEXT)?).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let what = format!("not UTF-8 from byte {valid} on");
        io::Error::new(ErrorKind::InvalidData, what)
    })?;
    let unmarked = text.strip_prefix('\u{feff}').map(str::to_owned);
    Ok(unmarked.unwrap_or(text))
}

fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let refuse = |what: String| Err(io::Error::new(ErrorKind::InvalidInput, what));
    // Asked before it is opened: a pipe opens only when somebody writes to it.
    if !fs::metadata(path)?.is_file() {
        return refuse("must be a regular file".to_owned());
    }
    let mut content = Vec::new();
    // A file of /proc has no size, and others may grow.
    File::open(path)?
        .take(limit + 1)
        .read_to_end(&mut content)?;
    match content.len() as u64 > limit {
        true => refuse(format!("larger than {limit} bytes")),
        false => Ok(content),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_the_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        let said = |read: io::Result<Vec<u8>>| read.unwrap_err().to_string();
        assert_eq!(bytes(&path).unwrap_err().kind(), ErrorKind::NotFound);
        for other in [folder.path(), Path::new("/dev/zero")] {
            assert_eq!(said(bytes(other)), "must be a regular file");
        }
        fs::write(&path, "\u{feff}1234").unwrap();
        assert_eq!(text(&path).unwrap(), "1234");
        assert_eq!(read(&path, 7).unwrap().len(), 7);
        assert_eq!(said(read(&path, 6)), "larger than 6 bytes");
        fs::write(&path, b"ab\xff").unwrap();
        let error = text(&path).unwrap_err().to_string();
        assert_eq!(error, "not UTF-8 from byte 2 on");
    }
}
