//! File of a log, temporary until complete and then renamed.
//!
//! A log that is dropped before it is closed is also completed and renamed, so an interrupted run leaves a readable
//! file. Write errors are reported at the end: a log is no reason to stop a robot.

use super::live::Server;
use foxglove::{Context, McapWriter, McapWriterHandle};
use host_sim::base::error::Error;
use output::files;
use output::files::OutputError;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tempfile::{NamedTempFile, TempPath};

/// First write error of a log, kept here because the MCAP writer does not report its errors.
type FirstError = Arc<Mutex<Option<io::Error>>>;

/// File of a log; stores its first write error.
struct LogFile {
    file: BufWriter<File>,
    error: FirstError,
}

impl LogFile {
    fn keep_error<T>(&self, result: io::Result<T>) -> io::Result<T> {
        result.map_err(|error| {
            let kind = error.kind();
            let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
            first.get_or_insert(error);
            kind.into()
        })
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes);
        self.keep_error(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = self.file.flush();
        self.keep_error(flushed)
    }
}

impl Seek for LogFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = self.file.seek(to);
        self.keep_error(position)
    }
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> OutputError + use<> {
    let path = path.to_path_buf();
    move |source| OutputError {
        action: "write",
        path,
        source,
    }
}

/// Creates the file under its temporary name.
fn create(path: &Path) -> Result<NamedTempFile, OutputError> {
    // A log is read from its end, which pipes and devices do not allow.
    if fs::metadata(path).is_ok_and(|data| !data.is_file()) {
        let what = io::Error::new(ErrorKind::InvalidInput, "must be a regular file");
        return Err(failed(path)(what));
    }
    files::temporary_beside(path)
}

/// Log being written to a file, served to viewers, or both.
pub struct Sink {
    context: Arc<Context>,
    handle: Option<McapWriterHandle<LogFile>>,
    server: Option<Server>,
    error: FirstError,
    /// Path of the temporary file, used until the log is complete; below, final path.
    temporary: Option<TempPath>,
    path: Option<PathBuf>,
}

impl Sink {
    /// Opens a log in a file, which appears when the log is closed or dropped.
    pub fn to_file(path: &Path) -> Result<Self, OutputError> {
        let (file, temporary) = create(path)?.into_parts();
        let mut sink = Self::open(BufWriter::new(file)).map_err(failed(path))?;
        (sink.temporary, sink.path) = (Some(temporary), Some(path.to_path_buf()));
        Ok(sink)
    }

    /// A log without a file, for live viewers.
    pub fn without_file() -> Self {
        Self {
            context: Context::new(),
            handle: None,
            server: None,
            error: FirstError::default(),
            temporary: None,
            path: None,
        }
    }

    /// True if the log goes to a file.
    pub fn is_file(&self) -> bool {
        self.handle.is_some()
    }

    /// Starts a server of the log for viewers at this address. Web pages of other machines may connect only from
    /// these origins.
    pub fn serve(&mut self, address: SocketAddr, origins: &[String]) -> Result<(), Error> {
        self.server = Some(Server::start(&self.context, address, origins.to_vec())?);
        Ok(())
    }

    /// Server, if the log is served.
    pub fn server(&self) -> Option<&Server> {
        self.server.as_ref()
    }

    fn open(file: BufWriter<File>) -> io::Result<Self> {
        let mut sink = Self::without_file();
        let log_file = LogFile {
            file,
            error: sink.error.clone(),
        };
        let handle = McapWriter::with_options(foxglove::McapWriteOptions::new().profile("cfmmr"))
            .context(&sink.context)
            .create(log_file)
            .map_err(io::Error::other)?;
        sink.handle = Some(handle);
        Ok(sink)
    }

    /// Final path of the file; `None` for a log without a file.
    pub fn path(&self) -> Option<PathBuf> {
        self.path.clone()
    }

    /// Foxglove context of the log's channels.
    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Writes a metadata record.
    pub fn metadata(&self, name: &str, entries: &[(impl ToString, String)]) {
        let entries = entries.iter();
        let map = entries.map(|(key, value)| (key.to_string(), value.clone()));
        if let Some(handle) = &self.handle {
            // An error is reported at the end, as all write errors.
            let _ = handle.write_metadata(name, map.collect());
        }
    }

    /// Stops the server and completes the log. After a write error no file appears.
    pub fn close(&mut self) -> Result<(), OutputError> {
        if let Some(server) = self.server.take() {
            server.stop();
        }
        let Some(handle) = self.handle.take() else {
            return Ok(());
        };
        let closed = handle.close().map_err(io::Error::other);
        let mut result = closed.map(|mut log_file| drop(log_file.flush()));
        let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = first.take() {
            result = Err(error);
        }
        let (Some(temporary), Some(path)) = (self.temporary.take(), &self.path) else {
            return Ok(());
        };
        let result = result.and_then(|()| Ok(temporary.persist(path)?));
        result.map_err(failed(path))
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // `drop` cannot return an error.
        let _ = self.close();
    }
}
