//! Result files: written completely, all or none.
//!
//! A command collects its files in an [`OutputDir`] while it works and writes them at the end with
//! [`OutputDir::commit`]. Each file gets a temporary name in the same directory first; when all files are complete,
//! they are renamed. An error before the renaming, or an `OutputDir` that is dropped, leaves the directory unchanged.

use host_sim::base::error::Error;
use serde::Serialize;
use std::io::Write;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::{fmt, fs, io};
use tempfile::{Builder, NamedTempFile};

/// Failed operation on a file or directory.
#[derive(Debug)]
pub struct OutputError {
    /// Failed operation, as text after "cannot".
    pub action: &'static str,
    /// File or directory of the operation.
    pub path: PathBuf,
    /// Cause of the failure.
    pub source: io::Error,
}

impl fmt::Display for OutputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            action,
            path,
            source,
        } = self;
        write!(f, "cannot {action} {}: {source}", path.display())
    }
}

impl std::error::Error for OutputError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.source)
    }
}

impl From<OutputError> for Error {
    fn from(error: OutputError) -> Self {
        Self::Failure(error.to_string())
    }
}

fn failed<'a>(
    action: &'static str,
    path: &'a Path,
) -> impl FnOnce(io::Error) -> OutputError + use<'a> {
    move |source| OutputError {
        action,
        path: path.to_path_buf(),
        source,
    }
}

/// A directory locked against other runs while this value lives. A missing directory is created, and removed at the
/// end if it is still empty.
#[derive(Debug)]
pub struct Reserved {
    made: Vec<PathBuf>,
    _held: fs::File,
}

impl Reserved {
    /// Reserves a directory into which files can be written.
    pub fn new(path: &Path) -> Result<Self, OutputError> {
        OutputDir::create(path)?;
        let made = create_missing(path)?;
        let held = fs::File::open(path).map_err(failed("open", path))?;
        // The kernel releases the lock at any end of the process.
        let taken = held.try_lock().map_err(|error| match error {
            fs::TryLockError::WouldBlock => io::Error::other("another run writes into it"),
            fs::TryLockError::Error(error) => error,
        });
        taken.map_err(failed("reserve", path))?;
        Ok(Self { made, _held: held })
    }
}

impl Drop for Reserved {
    fn drop(&mut self) {
        remove_all(&self.made);
    }
}

/// Files to be written together into one directory.
#[derive(Debug)]
pub struct OutputDir {
    path: PathBuf,
    files: Vec<(String, Vec<u8>)>,
}

impl OutputDir {
    /// Prepares to write into `path`; [`Self::commit`] creates a missing directory. Checks at once, before hours of
    /// work, that files can be written there; the check leaves no trace.
    pub fn create(path: impl Into<PathBuf>) -> Result<Self, OutputError> {
        let path = path.into();
        let made = create_missing(&path)?;
        let tried = temporary_in(&path, "probe").map(drop);
        remove_all(&made);
        tried.map(|()| Self {
            path,
            files: Vec::new(),
        })
    }

    /// Adds a file, or replaces an added file of the same name.
    ///
    /// # Panics
    ///
    /// If `name` is not a plain file name.
    pub fn bytes(&mut self, name: &str, content: impl Into<Vec<u8>>) {
        assert!(
            Path::new(name)
                .file_name()
                .is_some_and(|plain| plain == name),
            "{name:?} is not a plain file name"
        );
        self.files.retain(|(other, _)| other != name);
        self.files.push((name.to_string(), content.into()));
    }

    /// Adds a text file; see [`Self::bytes`].
    pub fn text(&mut self, name: &str, content: impl Into<String>) {
        self.bytes(name, content.into());
    }

    /// Adds a JSON file; see [`Self::bytes`] and [`json`].
    pub fn json(&mut self, name: &str, value: &impl Serialize) {
        self.bytes(name, json(value));
    }

    /// Adds a table of numbers; see [`Self::bytes`].
    pub fn csv(&mut self, name: &str, content: Csv) {
        self.bytes(name, content.into_bytes());
    }

    /// Writes all files, replacing files of the same name, and gives their paths. An error before the last file is
    /// complete changes nothing.
    pub fn commit(self) -> Result<Vec<PathBuf>, OutputError> {
        let made = create_missing(&self.path)?;
        let mut complete = Vec::new();
        let written = self.files.iter().try_for_each(|(name, content)| {
            let target = self.path.join(name);
            if target.is_dir() {
                let is_a_directory = io::Error::from(io::ErrorKind::IsADirectory);
                return Err(failed("replace", &target)(is_a_directory));
            }
            let mut file = temporary_in(&self.path, name)?;
            file.write_all(content).map_err(failed("write", &target))?;
            complete.push((file, target));
            Ok(())
        });
        let rename = |(file, target): (NamedTempFile, PathBuf)| match file.persist(&target) {
            Ok(_) => Ok(target),
            Err(error) => Err(failed("replace", &target)(error.error)),
        };
        let renamed = written.and_then(|()| complete.into_iter().map(rename).collect());
        if renamed.is_err() {
            remove_all(&made);
        }
        renamed
    }
}

/// Writes one file, completely or not at all. A pipe, a terminal or a device is written to directly.
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<(), OutputError> {
    let special = fs::metadata(path).is_ok_and(|data| !data.is_file());
    if special {
        let opened = open_special(path).map_err(failed("write", path));
        return opened?
            .write_all(content.as_ref())
            .map_err(failed("write", path));
    }
    let mut temporary = temporary_beside(path)?;
    let written = temporary.write_all(content.as_ref());
    let renamed = written.and_then(|()| Ok(temporary.persist(path)?));
    renamed.map(drop).map_err(failed("write", path))
}

/// Opens a pipe, a terminal or a device. A pipe without a reader is an error, because opening it would block.
fn open_special(path: &Path) -> io::Result<fs::File> {
    let flags = rustix::fs::OFlags::NONBLOCK.bits() as i32;
    let mut options = fs::OpenOptions::new();
    let opened = options.write(true).custom_flags(flags).open(path);
    let file = opened.map_err(|error| match error.raw_os_error() {
        Some(code) if code == rustix::io::Errno::NXIO.raw_os_error() => {
            io::Error::new(error.kind(), "a pipe without a reader")
        }
        _ => error,
    })?;
    rustix::io::ioctl_fionbio(&file, false)?;
    Ok(file)
}

/// A hidden temporary file in the directory of `path`; a missing directory is created. The file is removed unless it is
/// renamed.
pub fn temporary_beside(path: &Path) -> Result<NamedTempFile, OutputError> {
    let directory = directory_of(path);
    create_missing(directory)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    temporary_in(directory, &name)
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Checks that a file can be written at `path`; leaves no trace.
pub fn try_file(path: &Path) -> Result<(), OutputError> {
    if path.is_dir() {
        return Err(failed("write", path)(io::ErrorKind::IsADirectory.into()));
    }
    if fs::metadata(path).is_ok_and(|data| !data.is_file()) {
        return open_special(path).map(drop).map_err(failed("write", path));
    }
    let made = create_missing(directory_of(path))?;
    let tried = temporary_beside(path).map(drop);
    remove_all(&made);
    tried
}

/// Creates `path` and its missing parents; gives the created directories, innermost first.
fn create_missing(path: &Path) -> Result<Vec<PathBuf>, OutputError> {
    let made: Vec<PathBuf> = path
        .ancestors()
        .filter(|part| !part.as_os_str().is_empty())
        .take_while(|part| !part.exists())
        .map(Path::to_path_buf)
        .collect();
    fs::create_dir_all(path).map_err(|error| {
        remove_all(&made);
        failed("create", path)(error)
    })?;
    Ok(made)
}

/// Removes directories created by this process, if they are empty.
fn remove_all(made: &[PathBuf]) {
    for directory in made {
        let _ = fs::remove_dir(directory);
    }
}

fn temporary_in(directory: &Path, name: &str) -> Result<NamedTempFile, OutputError> {
    let (prefix, everyone) = (format!(".{name}."), fs::Permissions::from_mode(0o666));
    let mut builder = Builder::new();
    let builder = builder.prefix(&prefix).suffix(".partial");
    let file = builder.permissions(everyone).tempfile_in(directory);
    // Reports only the kind of the error, because the library's text repeats the path.
    file.map_err(|error| failed("write into", directory)(error.kind().into()))
}

/// `value` as indented JSON with a newline at the end. Numbers have the shortest text that reads back to the same
/// value; NaN and infinity become null.
///
/// # Panics
///
/// If `value` cannot be JSON (a map whose keys are not strings, or a `Serialize` that fails).
pub fn json(value: &impl Serialize) -> String {
    let mut text = serde_json::to_string_pretty(value).expect("a value that is JSON");
    text.push('\n');
    text
}

/// One cell of a [`Csv`] row.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Double-precision number of the simulation.
    Double(f64),
    /// Single-precision number of the on-board code; its text is shorter than the text of the equal `f64`.
    Single(f32),
    /// A counter.
    Integer(i64),
    /// A word.
    Text(String),
    /// No value.
    Empty,
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // `Debug` of a float is the shortest text that reads back to the same bits, with an exponent where that is
        // shorter.
        match self {
            Self::Double(value) => write!(f, "{value:?}"),
            Self::Single(value) => write!(f, "{value:?}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Text(value) => f.write_str(value),
            Self::Empty => Ok(()),
        }
    }
}

macro_rules! cells {
    ($($from:ty, $value:ident => $cell:expr;)*) => {$(
        impl From<$from> for Cell {
            fn from($value: $from) -> Self {
                $cell
            }
        }
    )*};
}
cells! {
    f64, value => Self::Double(value);
    f32, value => Self::Single(value);
    i32, value => Self::Integer(value.into());
    u32, value => Self::Integer(value.into());
    usize, value => Self::Integer(value as i64);
    bool, value => Self::Integer(value.into());
    &str, value => Self::Text(value.to_string());
}

impl<T: Into<Cell>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Empty, Into::into)
    }
}

/// A table as comma-separated text: a header of column names with units, then rows of the same
/// length. Numbers have the shortest text that reads back to the same value.
#[derive(Debug)]
pub struct Csv(csv::Writer<Vec<u8>>);

impl Csv {
    /// A table without rows.
    pub fn new<S: AsRef<str>>(header: impl IntoIterator<Item = S>) -> Self {
        let mut csv = Self(csv::Writer::from_writer(Vec::new()));
        csv.row(header.into_iter().map(|name| Cell::from(name.as_ref())));
        csv
    }

    /// Adds a row.
    ///
    /// # Panics
    ///
    /// If the row has not as many cells as the header.
    pub fn row<C: Into<Cell>>(&mut self, cells: impl IntoIterator<Item = C>) {
        let cells = cells.into_iter().map(|cell| cell.into().to_string());
        // Writing to memory cannot fail.
        let written = self.0.write_record(cells.map(String::into_bytes));
        written.expect("as many cells in a row as in the header");
    }

    /// Header and rows as text.
    pub fn into_bytes(self) -> Vec<u8> {
        self.0.into_inner().expect("rows in memory")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn names(path: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(path)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn files_appear_together_at_commit() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a/b");
        let mut output = OutputDir::create(&path).unwrap();
        output.text("note.txt", "one\n");
        output.json("result.json", &serde_json::json!({ "e_m": 0.1 }));
        assert!(names(root.path()).is_empty());
        let written = output.commit().unwrap();
        assert_eq!(written, [path.join("note.txt"), path.join("result.json")]);
        assert_eq!(names(&path), ["note.txt", "result.json"]);
        let text = fs::read_to_string(&written[1]).unwrap();
        assert_eq!(text, "{\n  \"e_m\": 0.1\n}\n");
    }

    #[test]
    fn reserved_directory_excludes_other_runs_and_is_removed_if_empty() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a/b");
        let first = Reserved::new(&path).unwrap();
        let error = Reserved::new(&path).unwrap_err().to_string();
        assert!(error.ends_with("another run writes into it"), "{error}");
        drop(first);
        assert!(names(root.path()).is_empty());
        let second = Reserved::new(&path).unwrap();
        write_file(&path.join("kept"), "x").unwrap();
        drop(second);
        assert_eq!(names(&path), ["kept"]);
    }

    #[test]
    fn dropped_output_leaves_no_file() {
        let root = tempfile::tempdir().unwrap();
        let mut output = OutputDir::create(root.path().join("new")).unwrap();
        output.text("note.txt", "one\n");
        drop(output);
        assert!(names(root.path()).is_empty());
    }

    #[test]
    fn commit_replaces_its_files_and_keeps_others() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("mine"), "keep").unwrap();
        fs::write(root.path().join("note.txt"), "old and longer").unwrap();
        let mut output = OutputDir::create(root.path()).unwrap();
        output.text("note.txt", "first");
        output.text("note.txt", "new");
        output.commit().unwrap();
        assert_eq!(names(root.path()), ["mine", "note.txt"]);
        assert_eq!(fs::read(root.path().join("note.txt")).unwrap(), b"new");
    }

    #[test]
    fn file_that_cannot_be_replaced_leaves_directory_unchanged() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("first"), "old").unwrap();
        fs::create_dir(root.path().join("second")).unwrap();
        let mut output = OutputDir::create(root.path()).unwrap();
        output.text("first", "new");
        output.text("second", "new");
        let error = output.commit().unwrap_err();
        assert!(error.to_string().contains("second"), "{error}");
        assert_eq!(names(root.path()), ["first", "second"]);
        assert_eq!(fs::read(root.path().join("first")).unwrap(), b"old");
    }

    #[test]
    fn write_creates_directory_and_check_leaves_no_trace() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a/b/table.json");
        try_file(&path).unwrap();
        assert!(names(root.path()).is_empty());
        write_file(&path, "longer").unwrap();
        write_file(&path, "{}").unwrap();
        try_file(&path).unwrap();
        assert_eq!(names(path.parent().unwrap()), ["table.json"]);
        assert_eq!(fs::read(&path).unwrap(), b"{}");
        // A directory is not a file, and a path cannot continue below a file.
        assert!(try_file(root.path()).is_err());
        assert!(try_file(&path.join("below")).is_err());
        assert!(write_file(&path.join("below"), "x").is_err());
    }

    #[test]
    fn pipe_is_written_with_a_reader_and_refused_without() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        let refused = try_file(&path).unwrap_err().to_string();
        assert!(refused.contains("a pipe without a reader"), "{refused}");
        assert!(write_file(&path, "x").is_err());
        let mut options = fs::OpenOptions::new();
        let mut reader = options.read(true).write(true).open(&path).unwrap();
        write_file(&path, "text").unwrap();
        let mut text = [0; 4];
        io::Read::read_exact(&mut reader, &mut text).unwrap();
        assert_eq!(&text, b"text");
    }

    #[test]
    fn path_through_a_file_is_refused_by_name_at_creation() {
        let root = tempfile::tempdir().unwrap();
        let file = root.path().join("file");
        fs::write(&file, "x").unwrap();
        for path in [file.clone(), file.join("below")] {
            let error = OutputDir::create(&path).unwrap_err();
            assert!(
                error.to_string().contains(path.to_str().unwrap()),
                "{error}"
            );
        }
        assert_eq!(names(root.path()), ["file"]);
    }

    #[test]
    #[should_panic(expected = "plain file name")]
    fn file_name_outside_the_directory_is_refused() {
        let root = tempfile::tempdir().unwrap();
        OutputDir::create(root.path()).unwrap().text("../up", "x");
    }

    #[test]
    fn single_and_double_precision_have_shortest_texts() {
        let mut csv = Csv::new(["t_s", "estimate_m", "gyro, raw", "n"]);
        csv.row([Cell::from(0.1), 0.1f32.into(), None::<f32>.into(), 3.into()]);
        csv.row([
            Cell::from(1e-9),
            2.0f32.into(),
            Some(0.5f32).into(),
            true.into(),
        ]);
        let text = String::from_utf8(csv.into_bytes()).unwrap();
        assert_eq!(
            text,
            "t_s,estimate_m,\"gyro, raw\",n\n0.1,0.1,,3\n1e-9,2.0,0.5,1\n"
        );
    }

    #[test]
    #[should_panic(expected = "as many cells")]
    fn a_row_of_the_wrong_length_is_refused() {
        Csv::new(["a", "b"]).row([1.0]);
    }

    properties! {
        #[test]
        fn numbers_read_back_the_same(bits: u64, short_bits: u32) {
            let (double, single) = (f64::from_bits(bits), f32::from_bits(short_bits));
            let text = Cell::from(double).to_string();
            let back: f64 = text.parse().unwrap();
            prop_assert!(back.to_bits() == bits || (back.is_nan() && double.is_nan()));
            let back: f32 = Cell::from(single).to_string().parse().unwrap();
            prop_assert!(back.to_bits() == short_bits || (back.is_nan() && single.is_nan()));
        }
    }
}
