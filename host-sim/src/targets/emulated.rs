//! Boards in QEMU; see `docs/emulation.md` for what of a board is emulated.

use super::board_log::BoardLog;
use super::link::{Descriptors, Link, make_flash_file};
use super::{Remote, Target, images};
use crate::base::error::Error;
use core_algos::topology::Role;
use rustix::fs::{CWD, Mode, OFlags};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions};
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// The oldest QEMU whose model of the chip does.
pub const OLDEST_QEMU: u32 = 9;
/// Time in which an emulated board opens its link.
const START: Duration = Duration::from_secs(20);

/// Link to an emulated board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// Two named pipes, by semihosting: fast.
    Pipe,
    /// The board's serial port.
    Uart,
}

/// Why a program does not do as the emulator.
#[derive(Debug)]
pub enum QemuFault {
    /// It cannot be started.
    Absent(io::Error),
    /// It is something else.
    Other,
    /// It is this version.
    TooOld(String),
}

/// Version of QEMU, if `program` is that and new enough.
pub fn find_qemu(program: &str) -> Result<String, QemuFault> {
    let output = Command::new(program)
        .arg("--version")
        .stdin(Stdio::null())
        .output()
        .map_err(QemuFault::Absent)?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let version = text
        .split_once("version ")
        .and_then(|(_, rest)| rest.split_whitespace().next())
        .unwrap_or_default();
    let major = version.split('.').next().and_then(|n| n.parse().ok());
    match major {
        Some(major) if u32::ge(&major, &OLDEST_QEMU) => Ok(version.to_owned()),
        Some(_) => Err(QemuFault::TooOld(version.to_owned())),
        None => Err(QemuFault::Other),
    }
}

/// The same with an error that says what is needed.
pub fn check_qemu(program: &str) -> Result<String, Error> {
    let need = format!(
        "emulated boards need qemu-system-arm {OLDEST_QEMU}.0 or newer: tools/scripts/install_qemu.sh \
         installs it on Debian (from the backports suite where the release's own is older), other \
         systems have it in their package qemu or qemu-system-arm"
    );
    find_qemu(program).map_err(|fault| {
        let found = match fault {
            QemuFault::Absent(error) => format!("{program}: {error}"),
            QemuFault::Other => format!("{program} is not QEMU"),
            QemuFault::TooOld(version) => format!("{program} is version {version}, too old"),
        };
        Error::Failure(format!("{found}; {need}"))
    })
}

/// Images of both kinds of board, built for emulation.
#[derive(Clone, Debug)]
pub struct Images {
    directory: Arc<Scratch>,
    axle: Arc<Vec<u8>>,
    beam: Arc<Vec<u8>>,
}

impl Images {
    /// Builds what is not up to date.
    pub fn build() -> Result<Self, Error> {
        let directory = Arc::new(Scratch::new()?);
        let image = |package: &str| -> Result<Arc<Vec<u8>>, Error> {
            // A copy, so that another build does not exchange it in the middle of a run.
            let bytes = images::build(package, Some("emulated"))?;
            fs::write(directory.path.join(package), &bytes)?;
            Ok(Arc::new(bytes))
        };
        Ok(Self {
            axle: image("firmware-axle")?,
            beam: image("firmware-beam")?,
            directory,
        })
    }

    /// Starts all boards of a robot, behind links of this kind.
    pub fn start(
        &self,
        qemu: &str,
        wire: Wire,
        logs: &[BoardLog; 3],
    ) -> Result<[Box<dyn Target>; 3], Error> {
        let board = |role: Role| -> Result<Box<dyn Target>, Error> {
            let log = logs[role as usize].clone();
            let link = Emulated::start(qemu, role, wire, self, log, None)?;
            Ok(Box::new(Remote::new(role, Box::new(link))))
        };
        Ok([board(Role::Front)?, board(Role::Rear)?, board(Role::Beam)?])
    }

    fn of(&self, role: Role) -> (PathBuf, Arc<Vec<u8>>) {
        match role {
            Role::Front | Role::Rear => {
                (self.directory.path.join("firmware-axle"), self.axle.clone())
            }
            Role::Beam => (self.directory.path.join("firmware-beam"), self.beam.clone()),
        }
    }
}

/// A directory for images, pipes and sockets that goes when it is no longer needed.
#[derive(Debug)]
struct Scratch {
    path: PathBuf,
}

impl Scratch {
    fn new() -> Result<Self, Error> {
        let base = std::env::temp_dir();
        let process = std::process::id();
        for attempt in 0..1000 {
            let path = base.join(format!("cfmmr-{process}-{attempt}"));
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => {
                    return Err(Error::Failure(format!("{}: {error}", path.display())));
                }
            }
        }
        Err(Error::Failure(format!("{}: no room", base.display())))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // Nothing depends on it.
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// A board in QEMU.
pub struct Emulated {
    qemu: String,
    role: Role,
    wire: Wire,
    images: Images,
    log: BoardLog,
    /// File with the flash of the board.
    flash: Option<PathBuf>,
    /// Number of this start among all that share the images.
    start: u32,
    running: Option<Running>,
}

/// QEMU while it runs. It is killed when this goes, whatever the reason.
struct Running {
    child: Child,
    link: Option<Descriptors>,
    log: Option<JoinHandle<()>>,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.link = None;
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if let Some(log) = self.log.take() {
            let _ = log.join();
        }
    }
}

impl Emulated {
    /// Starts a board; its log goes to `log`, its flash is in the file `flash`. Without one it is
    /// blank and cannot be written.
    pub fn start(
        qemu: &str,
        role: Role,
        wire: Wire,
        images: &Images,
        log: BoardLog,
        flash: Option<&Path>,
    ) -> Result<Self, Error> {
        if let Some(file) = flash {
            make_flash_file(file)?;
        }
        let flash = flash.map(std::path::absolute).transpose()?;
        let mut board = Self {
            qemu: qemu.to_owned(),
            role,
            wire,
            images: images.clone(),
            log,
            flash,
            start: 0,
            running: None,
        };
        board.revive()?;
        Ok(board)
    }

    /// A path for this start of the board, of no other and without blanks and commas.
    fn path(&self, name: &str) -> PathBuf {
        let (role, start) = (self.role.name(), self.start);
        self.images
            .directory
            .path
            .join(format!("{role}-{start}-{name}"))
    }

    fn spawn(&self, arguments: &[String], command_line: &str) -> Result<Running, Error> {
        let (image, bytes) = self.images.of(self.role);
        let mut semihosting = format!(
            "enable=on,target=native,arg=role={},{command_line}",
            self.role.name()
        );
        if let Some(file) = &self.flash {
            // By another name: the file's own may have blanks and commas in it.
            let path = self.path("flash");
            std::os::unix::fs::symlink(file, &path)?;
            semihosting += &format!(",arg=flash={}", path.display());
        }
        let mut child = Command::new(&self.qemu)
            .args([
                "-M",
                "olimex-stm32-h405",
                "-display",
                "none",
                "-monitor",
                "none",
            ])
            .arg("-kernel")
            .arg(&image)
            .args(["-serial", "null"])
            .args(arguments)
            .args(["-semihosting-config", &semihosting])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Error::Failure(format!("{}: {error}", self.qemu)))?;
        let log = child
            .stdout
            .take()
            .map(|output| self.log.follow(self.role, bytes, output));
        Ok(Running {
            child,
            link: None,
            log,
        })
    }

    fn start_with_pipes(&self) -> Result<Running, Error> {
        let (to, from) = (self.path("in"), self.path("out"));
        for path in [&to, &from] {
            rustix::fs::mknodat(
                CWD,
                path,
                rustix::fs::FileType::Fifo,
                Mode::RUSR | Mode::WUSR,
                0,
            )
            .map_err(|error| Error::Failure(format!("{}: {error}", path.display())))?;
        }
        let line = format!(
            "arg=link=pipe,arg=in={},arg=out={}",
            to.display(),
            from.display()
        );
        let mut running = self.spawn(&[], &line)?;
        // Without a writer yet, so that the board's opening does not have to wait.
        let from = open(&from, OFlags::RDONLY)?;
        let to = self.await_start(&mut running, || match open(&to, OFlags::WRONLY) {
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::NXIO.raw_os_error()) => {
                Ok(None)
            }
            other => other.map(Some),
        })?;
        running.link = Some(Descriptors::new(from, to));
        Ok(running)
    }

    fn start_with_uart(&self) -> Result<Running, Error> {
        let paths = [self.path("to"), self.path("from")];
        let mut listeners = Vec::new();
        let mut arguments = Vec::new();
        for path in &paths {
            let listener = UnixListener::bind(path)?;
            listener.set_nonblocking(true)?;
            listeners.push(listener);
            arguments.extend(["-serial".to_owned(), format!("unix:{}", path.display())]);
        }
        let mut running = self.spawn(&arguments, "arg=link=uart")?;
        let mut files = Vec::new();
        for listener in &listeners {
            let stream = self.await_start(&mut running, || match listener.accept() {
                Ok((stream, _)) => Ok(Some(stream)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
                Err(error) => Err(error),
            })?;
            stream.set_nonblocking(false)?;
            files.push(File::from(OwnedFd::from(stream)));
        }
        if let (Some(from), Some(to)) = (files.pop(), files.pop()) {
            running.link = Some(Descriptors::new(from, to));
        }
        Ok(running)
    }

    /// Sends the emulator a signal, if it runs, and waits until it has stopped or ended by it.
    fn signal(&self, signal: Signal) -> Result<(), Error> {
        let Some(running) = &self.running else {
            return Ok(());
        };
        let (process, role) = (Pid::from_child(&running.child), self.role.name());
        let failure = |error| Error::Failure(format!("{role} board: {error}"));
        rustix::process::kill_process(process, signal).map_err(failure)?;
        if signal != Signal::CONT {
            // What there is to know stays for the one that waits for its end.
            let options = WaitIdOptions::STOPPED | WaitIdOptions::EXITED | WaitIdOptions::NOWAIT;
            rustix::process::waitid(WaitId::Pid(process), options).map_err(failure)?;
        }
        Ok(())
    }

    /// Tries until the board has opened its end, unless QEMU ends before that.
    fn await_start<T>(
        &self,
        running: &mut Running,
        mut attempt: impl FnMut() -> io::Result<Option<T>>,
    ) -> Result<T, Error> {
        let role = self.role.name();
        let deadline = Instant::now() + START;
        loop {
            if let Some(value) = attempt()? {
                return Ok(value);
            }
            if let Some(status) = running.child.try_wait()? {
                return Err(Error::Failure(format!(
                    "{role} board: QEMU ended before the board opened its link ({status})"
                )));
            }
            if Instant::now() > deadline {
                return Err(Error::Failure(format!(
                    "{role} board: did not open its link within {START:?}"
                )));
            }
            thread::sleep(Duration::from_millis(2));
        }
    }
}

fn open(path: &Path, access: OFlags) -> io::Result<File> {
    let flags = access | OFlags::NONBLOCK | OFlags::CLOEXEC;
    Ok(File::from(rustix::fs::open(path, flags, Mode::empty())?))
}

impl Link for Emulated {
    fn name(&self) -> &'static str {
        match self.wire {
            Wire::Pipe => "emulated, pipe",
            Wire::Uart => "emulated, UART",
        }
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let running = self.running.as_mut().and_then(|r| r.link.as_mut());
        running.ok_or(ErrorKind::BrokenPipe)?.send(bytes)
    }

    fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let running = self.running.as_mut().and_then(|r| r.link.as_mut());
        running.ok_or(ErrorKind::BrokenPipe)?.receive(room, timeout)
    }

    fn crash(&mut self) -> Result<(), Error> {
        self.signal(Signal::KILL)
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        self.signal(match halted {
            true => Signal::STOP,
            false => Signal::CONT,
        })
    }

    fn kill(&mut self) -> Result<(), Error> {
        self.running = None;
        Ok(())
    }

    fn revive(&mut self) -> Result<(), Error> {
        static STARTS: AtomicU32 = AtomicU32::new(0);
        self.running = None;
        self.start = STARTS.fetch_add(1, Relaxed);
        self.running = Some(match self.wire {
            Wire::Pipe => self.start_with_pipes()?,
            Wire::Uart => self.start_with_uart()?,
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    /// A program that says it is this version.
    fn fake(directory: &Path, version: &str) -> String {
        let path = directory.join("qemu");
        fs::write(&path, format!("#!/bin/sh\necho \"{version}\"\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_missing_or_old_qemu_is_refused_with_what_is_needed_and_how_to_get_it() {
        let directory = tempfile::tempdir().unwrap();
        let old = fake(directory.path(), "QEMU emulator version 7.2.19 (Debian)");
        for (program, found) in [(old.as_str(), "7.2.19"), ("no-such-qemu", "no-such-qemu")] {
            let text = check_qemu(program).unwrap_err().to_string();
            for word in [found, "9.0 or newer", "tools/scripts/install_qemu.sh"] {
                assert!(text.contains(word), "no {word} in {text}");
            }
        }
        let other = fake(directory.path(), "something else");
        assert!(
            check_qemu(&other)
                .unwrap_err()
                .to_string()
                .contains("not QEMU")
        );
        let new = fake(directory.path(), "QEMU emulator version 10.0.2");
        assert_eq!(check_qemu(&new).unwrap(), "10.0.2");
    }

    #[test]
    fn scratch_directories_go_and_are_never_shared() {
        let (a, b) = (Scratch::new().unwrap(), Scratch::new().unwrap());
        assert_ne!(a.path, b.path);
        let path = a.path.clone();
        fs::write(path.join("file"), "x").unwrap();
        drop(a);
        assert!(!path.exists() && b.path.exists());
    }
}
