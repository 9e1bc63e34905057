//! Reads files named by the user: regular files of limited size.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest allowed size of a text file, bytes.
const MAX_TEXT_BYTES: u64 = 8 << 20;
/// Largest allowed size of a log, bytes.
pub const MAX_LOG_BYTES: u64 = 8 << 30;
/// Largest allowed size of a board image, a flash image or a campaign block, bytes.
pub const MAX_DATA_BYTES: u64 = 256 << 20;
/// Largest allowed size of a waypoint file, bytes.
pub const MAX_WAYPOINTS_BYTES: u64 = 32 << 20;

/// Content of a file of at most `limit` bytes.
pub fn bytes(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read(path, limit)
}

/// Two flags of a regular file: true if the file begins with `mark`, true if the file ends with `mark`.
pub fn has_edges(path: &Path, mark: &[u8]) -> io::Result<[bool; 2]> {
    let size = size_of(path)?;
    let mut file = File::open(path)?;
    let length = mark.len() as u64;
    let mut has_mark = |place: u64| {
        let mut found = Vec::new();
        file.seek(SeekFrom::Start(place))?;
        (&mut file).take(length).read_to_end(&mut found)?;
        Ok::<_, io::Error>(found == mark)
    };
    Ok([has_mark(0)?, has_mark(size.saturating_sub(length))?])
}

/// Content of a file in UTF-8, without a byte-order mark.
pub fn text(path: &Path) -> io::Result<String> {
    let text = String::from_utf8(read(path, MAX_TEXT_BYTES)?).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let what = format!("not UTF-8 from byte {valid} on");
        io::Error::new(ErrorKind::InvalidData, what)
    })?;
    let unmarked = text.strip_prefix('\u{feff}').map(str::to_owned);
    Ok(unmarked.unwrap_or(text))
}

/// Opens a regular file of at most `limit` bytes.
pub fn open(path: &Path, limit: u64) -> io::Result<File> {
    match size_of(path)? {
        size if size > limit => Err(too_large(size, limit)),
        _ => File::open(path),
    }
}

fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let mut content = Vec::new();
    // The size is limited again: a file of /proc reports size 0, and a file may grow.
    open(path, limit)?
        .take(limit + 1)
        .read_to_end(&mut content)?;
    match content.len() as u64 > limit {
        true => Err(too_large(limit + 1, limit)),
        false => Ok(content),
    }
}

fn too_large(size: u64, limit: u64) -> io::Error {
    let what = format!("{}: must be at most {}", shown(size), shown(limit));
    io::Error::new(ErrorKind::InvalidInput, what)
}

/// Size of a regular file. The file is not opened: opening a pipe blocks until a writer opens it.
fn size_of(path: &Path) -> io::Result<u64> {
    let data = fs::metadata(path)?;
    match data.is_file() {
        true => Ok(data.len()),
        false => Err(io::Error::new(
            ErrorKind::InvalidInput,
            "must be a regular file",
        )),
    }
}

/// Size as text, in bytes or MiB.
fn shown(bytes: u64) -> String {
    const MIB: u64 = 1 << 20;
    match bytes {
        ..MIB => format!("{bytes} bytes"),
        _ => format!("{:.1} MiB", bytes as f64 / MIB as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_that_is_irregular_or_too_large_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        let error_text = |read: io::Result<Vec<u8>>| read.unwrap_err().to_string();
        assert_eq!(
            bytes(&path, MAX_DATA_BYTES).unwrap_err().kind(),
            ErrorKind::NotFound
        );
        for other in [folder.path(), Path::new("/dev/zero")] {
            assert_eq!(
                error_text(bytes(other, MAX_DATA_BYTES)),
                "must be a regular file"
            );
        }
        fs::write(&path, "\u{feff}1234").unwrap();
        assert_eq!(text(&path).unwrap(), "1234");
        assert_eq!(read(&path, 7).unwrap().len(), 7);
        assert_eq!(
            error_text(read(&path, 6)),
            "7 bytes: must be at most 6 bytes"
        );
        // Sparse file: refused by its size, without reading the content.
        let large = fs::File::create(folder.path().join("large")).unwrap();
        large.set_len(3 << 30).unwrap();
        let refused = error_text(bytes(&folder.path().join("large"), MAX_WAYPOINTS_BYTES));
        assert_eq!(refused, "3072.0 MiB: must be at most 32.0 MiB");
        fs::write(&path, b"ab\xff").unwrap();
        let error = text(&path).unwrap_err().to_string();
        assert_eq!(error, "not UTF-8 from byte 2 on");
    }
}
