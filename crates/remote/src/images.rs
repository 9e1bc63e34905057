//! Firmware images of the boards, built from this workspace or read from files.

use core_algos::link::framing::crc32c;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::base::input;
use output::terminal::note;
use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, IsTerminal};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use twox_hash::XxHash3_64;
use virtual_board::image::Image;

/// Rust target of the firmware images.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Environment variables that name the firmware files of the axle boards and of the beam board.
const AXLE_IMAGE: &str = "CFMMR_AXLE_IMAGE";
const BEAM_IMAGE: &str = "CFMMR_BEAM_IMAGE";

/// Duration of a build, after which the program reports that a build is running.
const LONG_BUILD: Duration = Duration::from_secs(3);
/// Polling interval while a build is running.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Cargo profile of the firmware images.
const PROFILE: &str = "image";

/// Builds a package's image if it is out of date, and returns the bytes of the ELF file. A lock keeps two runs from
/// building at once.
pub fn build(package: &str) -> Result<Vec<u8>, Error> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    if !workspace.join("Cargo.toml").is_file() {
        let checkout = env!("CARGO_MANIFEST_DIR").trim_end_matches("/crates/remote");
        return Err(Error::input(format!(
            "the image {package} is built in {checkout}, the checkout of this program, which is gone: give the images \
             with {AXLE_IMAGE}=ELF and {BEAM_IMAGE}=ELF, or --axle-image ELF and --beam-image ELF; `cargo build \
             --profile {PROFILE} --target {TARGET} --package firmware-axle --package firmware-beam` in a checkout makes \
             them"
        )));
    }
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let target = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    // A relative folder is relative to the working directory of cargo.
    let target = workspace.join(target);
    let lock = target.join("images.lock");
    // Cargo has not created the target folder yet if this program was built into another folder.
    let held = fs::create_dir_all(&target)
        .and_then(|()| File::create(&lock))
        .and_then(|file| file.lock().map(|()| file));
    let _held = held.map_err(|error| Error::Failure(format!("{}: {error}", lock.display())))?;
    let mut command = Command::new(&cargo);
    command
        .args(["build", "--locked", "--profile", PROFILE])
        .args(["--target", TARGET, "--package", package])
        .current_dir(&workspace)
        .stdin(Stdio::null());
    // On a terminal cargo shows its progress.
    if !io::stderr().is_terminal() {
        command.arg("--quiet");
    }
    let status = command
        .spawn()
        .and_then(|child| await_build(child, package))
        .map_err(|error| Error::Failure(format!("cargo: {error}")))?;
    if !status.success() {
        return Err(Error::Failure(format!(
            "{package} cannot be built for the board ({status}); the Rust target {TARGET} is needed: \
             rustup target add {TARGET}"
        )));
    }
    let built = target.join(TARGET).join(PROFILE).join(package);
    fs::read(&built).map_err(|error| Error::Failure(format!("{}: {error}", built.display())))
}

/// Waits for the end of a build, and reports a long one.
fn await_build(mut child: Child, package: &str) -> io::Result<ExitStatus> {
    let began = Instant::now();
    let mut reported = io::stderr().is_terminal();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if !reported && began.elapsed() > LONG_BUILD {
            reported = true;
            note(format!(
                "building the image {package}, which takes minutes the first time"
            ));
        }
        thread::sleep(POLL_INTERVAL);
    }
}

/// Firmware images of the axle boards and the beam board.
#[derive(Clone)]
pub struct Images {
    axle: Arc<Image>,
    beam: Arc<Image>,
}

impl Images {
    /// The images that users flash, built if out of date. A given file replaces an image, and so does a file named by
    /// an environment variable.
    pub fn open(axle: Option<&Path>, beam: Option<&Path>) -> Result<Self, Error> {
        let given = |(file, package): (&Path, &str)| {
            let name = file.display().to_string();
            let refuse = |what: &dyn Display| Error::input(format!("{name}: {what}"));
            let bytes =
                input::bytes(file, input::MAX_DATA_BYTES).map_err(|error| refuse(&error))?;
            let intact = is_intact(&bytes);
            let image = Image::parse(&name, bytes);
            let image = image.map_err(|error| Error::input(error.to_string()))?;
            check(&image, intact, package).map_err(|what| refuse(&what))?;
            Ok::<_, Error>(Arc::new(image))
        };
        let built = |package: &str| {
            let bytes = build(package)?;
            let image = Image::parse(package, bytes);
            Ok::<_, Error>(Arc::new(
                image.map_err(|error| Error::Failure(error.to_string()))?,
            ))
        };
        let of_environment = |name| std::env::var_os(name).filter(|file| !file.is_empty());
        let (axle_file, beam_file) = (of_environment(AXLE_IMAGE), of_environment(BEAM_IMAGE));
        let (axle, beam) = (
            axle.or(axle_file.as_deref().map(Path::new)),
            beam.or(beam_file.as_deref().map(Path::new)),
        );
        // Files are read first, so that a wrong file is reported before a build starts.
        let files = [(axle, "firmware-axle"), (beam, "firmware-beam")];
        let [axle, beam] =
            files.map(|(file, package)| file.map(|file| given((file, package))).transpose());
        let (axle, beam) = (axle?, beam?);
        Ok(Self {
            axle: axle.map_or_else(|| built("firmware-axle"), Ok)?,
            beam: beam.map_or_else(|| built("firmware-beam"), Ok)?,
        })
    }

    /// Name of a board's firmware image, with the checksum of the flashed bytes (CRC-32C).
    pub fn name(&self, role: Role) -> String {
        let segments = self.of(role).segments().iter();
        let bytes: Vec<u8> = segments.flat_map(|segment| segment.data.clone()).collect();
        format!("virtual, image {:08x}", crc32c(&bytes))
    }

    /// Firmware image of a board.
    pub fn of(&self, role: Role) -> &Image {
        match role {
            Role::Axle(_) => &self.axle,
            Role::Beam(_) => &self.beam,
        }
    }
}

/// Rejects the image of another board, identified by the first line of its log (name, version, hash), and a damaged
/// image of this project. An image without such a line passes.
fn check(image: &Image, intact: Option<bool>, package: &str) -> Result<(), String> {
    if intact == Some(false) {
        return Err("damaged: its contents do not match its build id".to_owned());
    }
    for segment in image.segments() {
        for place in 0..segment.data.len() {
            let text = &segment.data[place..];
            if !text.starts_with(b"firmware-axle ") && !text.starts_with(b"firmware-beam ") {
                continue;
            }
            let text = String::from_utf8_lossy(&text[..text.len().min(64)]).into_owned();
            let found = text.split_ascii_whitespace().next().unwrap_or_default();
            if found != package {
                return Err(format!("{found} image: must be a {package} image"));
            }
            if intact.is_none() {
                return Err("damaged or stripped: it has no build id".to_owned());
            }
        }
    }
    Ok(())
}

/// Start of an ELF note with a build id of eight bytes: lengths of name and id, kind, name.
const BUILD_ID: &[u8] = b"\x04\0\0\0\x08\0\0\0\x03\0\0\0GNU\0";

/// True if the build id matches the file; `None` without a build id. LLD's `--build-id=fast` is XXH3 over the XXH3
/// hashes of each MiB, with the id set to zero.
fn is_intact(file: &[u8]) -> Option<bool> {
    let length = BUILD_ID.len();
    let place = file.windows(length).position(|part| part == BUILD_ID)? + length;
    let mut file = file.to_vec();
    let id = file.get_mut(place..place + 8)?;
    let found = id.to_vec();
    id.fill(0);
    let hashes = file.chunks(1 << 20).map(XxHash3_64::oneshot);
    let hashes: Vec<u8> = hashes.flat_map(u64::to_le_bytes).collect();
    Some(found == XxHash3_64::oneshot(&hashes).to_le_bytes())
}
