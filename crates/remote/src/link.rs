//! Byte links to boards: in this process, or through file descriptors.

use core_algos::link::protocol::StackUse;
use core_algos::link::{Identity, SimLink};
use core_algos::params::{BoardKind, Disarmed, Settings};
use core_algos::topology::{Role, Topology};
use firmware_common::store::Store;
use firmware_common::store::simulated::{Flash, run};
use host_sim::base::error::Error;
use host_sim::base::input;
use output::files;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Byte stream to and from one board.
pub trait Link: Send {
    /// Name of the link in reports.
    fn name(&self) -> &'static str;

    /// Sends bytes to the board.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits for bytes from the board; 0 after the timeout. An error means that the board is gone.
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize>;

    /// A second handle for sending; `None` if the link supports none.
    fn second(&self) -> Option<File> {
        None
    }

    /// Switches the board off.
    fn switch_off(&mut self) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: this program cannot switch the board off"
        )))
    }

    /// Ends the board as if it had failed, so that only an error of the link reports the end.
    fn crash(&mut self) -> Result<(), Error> {
        self.switch_off()
    }

    /// Halts the board's processor with its link open, or resumes it.
    fn halt(&mut self, _halted: bool) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: this program cannot halt the board"
        )))
    }

    /// Switches the board on again after [`Self::switch_off`] or [`Self::crash`].
    fn switch_on(&mut self) -> Result<(), Error> {
        let name = self.name();
        Err(Error::input(format!(
            "{name}: this program cannot switch the board on"
        )))
    }
}

/// Number of flash sectors of a board's parameter store, as on the chip.
const SECTORS: usize = 3;
const SECTOR: usize = 16 * 1024;

/// Board in this process, connected by encoded frames, with its parameter store in a simulated flash.
pub struct Loopback {
    identity: Identity,
    sim_link: Option<SimLink>,
    halted: bool,
    waiting: VecDeque<u8>,
    store: Store<Flash<SECTOR>>,
    /// File that holds the flash; `None` if the flash is in memory only.
    file: Option<PathBuf>,
}

impl Loopback {
    /// A board that has just started, with a blank flash.
    pub fn new(identity: Identity) -> Self {
        Self::with(identity, Flash::new(SECTORS, 1), None)
    }

    /// A board of a robot, with its flash in a file; its flash has only its place if the file does not exist.
    pub fn keeping(robot: Topology, identity: Identity, file: &Path) -> Result<Self, Error> {
        let mut flash = Flash::new(SECTORS, 1);
        flash.bytes = match flash_file(file)? {
            Some(bytes) => bytes,
            None => placed_flash(robot, identity.role)?,
        };
        Ok(Self::with(identity, flash, Some(file.to_owned())))
    }

    fn with(identity: Identity, flash: Flash<SECTOR>, file: Option<PathBuf>) -> Self {
        let range = flash.range();
        let mut board = Self {
            identity,
            sim_link: None,
            halted: false,
            waiting: VecDeque::new(),
            store: Store::new(flash, range).expect("whole sectors"),
            file,
        };
        board.start();
        board
    }

    fn start(&mut self) {
        let mut sim_link = SimLink::new(self.identity, StackUse::unknown);
        sim_link.load(run(self.store.load()));
        self.sim_link = Some(sim_link);
    }
}

/// Reads a board's flash from a file; `None` if the file does not exist.
pub fn flash_file(path: &Path) -> Result<Option<Vec<u8>>, Error> {
    let wrong = |why: String| Error::input(format!("{}: {why}", path.display()));
    match input::bytes(path, input::MAX_DATA_BYTES) {
        Ok(bytes) if bytes.len() == SECTORS * SECTOR => Ok(Some(bytes)),
        Ok(bytes) => Err(wrong(format!(
            "{} bytes: the flash of a board must have {}",
            bytes.len(),
            SECTORS * SECTOR
        ))),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(wrong(error.to_string())),
    }
}

/// Flash of a board that stores only its place in a robot; blank for the place that a board has without a stored place.
pub fn placed_flash(robot: Topology, role: Role) -> Result<Vec<u8>, Error> {
    let base = Settings::of(BoardKind::of(role));
    let mut settings = base.placed(role);
    settings.robot.geometry.axles = robot.axle_count() as u32;
    stored_flash(&settings, &base)
}

/// Flash of a board that stores `settings`; `base` are its settings with a blank flash.
pub fn stored_flash(settings: &Settings, base: &Settings) -> Result<Vec<u8>, Error> {
    let failed = |what: &str| Error::Failure(format!("store: {what}"));
    let off = Disarmed::when(true).ok_or_else(|| failed("armed"))?;
    let flash = Flash::<SECTOR>::new(SECTORS, 1);
    let range = flash.range();
    let mut store = Store::new(flash, range).ok_or_else(|| failed("its sectors"))?;
    let saved = run(store.save(settings, base, off));
    saved.map_err(|error| failed(&format!("{error:?}")))?;
    Ok(store.into_flash().bytes)
}

impl Link for Loopback {
    fn name(&self) -> &'static str {
        "frames in process"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let sim_link = self.sim_link.as_mut().ok_or(ErrorKind::BrokenPipe)?;
        if self.halted {
            return Ok(());
        }
        let mut answer = |bytes: &[u8]| self.waiting.extend(bytes);
        sim_link.receive(bytes, &mut answer);
        if let Some(save) = sim_link.save() {
            let saved = run(self.store.save(&save.settings, &save.base, save.off));
            if let Some(file) = &self.file {
                let written = files::write_file(file, &self.store.flash().bytes);
                written.map_err(|error| io::Error::other(error.to_string()))?;
            }
            let done = saved.ok().map(|values| (values, self.store.contents()));
            sim_link.saved(done, &mut answer);
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
        self.waiting.read(buffer)
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.sim_link = None;
        self.waiting.clear();
        Ok(())
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        self.halted = halted;
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        self.start();
        Ok(())
    }
}

/// A link through file descriptors: pipes, a socket, a serial port.
#[derive(Debug)]
pub struct Descriptors {
    from: File,
    to: File,
}

impl Descriptors {
    /// Reads from `from` and writes to `to`.
    pub fn new(from: File, to: File) -> Self {
        Self { from, to }
    }

    /// A second handle for sending; `None` if the descriptor cannot be duplicated.
    pub fn second(&self) -> Option<File> {
        self.to.try_clone().ok()
    }

    /// Writes bytes to the descriptor for sending.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.to.write_all(bytes)
    }

    /// Waits for bytes; 0 after the timeout or a signal. The end of the input is an error.
    pub fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let timeout = Timespec::try_from(timeout).map_err(|_| ErrorKind::InvalidInput)?;
        let mut waiting = [PollFd::new(&self.from, PollFlags::IN)];
        match poll(&mut waiting, Some(&timeout)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(0),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        match self.from.read(buffer) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(0),
            other => other,
        }
    }
}
