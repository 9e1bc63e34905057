//! The simulated robot for WebAssembly.
//!
//! Functions take and return numbers. Text passes through the buffer of [`text`], hashes are in the buffer of
//! [`hashes`]. Memory may grow during a call, so a caller gets the pointers after the call. A function that returns a
//! count returns 0 on an error; [`message`] then gives the error.
//!
//! | call | gives |
//! |---|---|
//! | [`text`]`(length)` | pointer to a buffer for a scenario and a script in UTF-8 |
//! | [`trial`]`(seed, trial)` | epochs of posture regulation in the scenario of the buffer |
//! | [`drive`]`(bytes, seed)` | epochs of a script; the buffer holds a scenario of that many bytes, then the script |
//! | [`hashes`]`()` | pointer to a 64-bit hash for each epoch of the latest run |
//! | [`message`]`()` | length of the latest error, which moves into the text buffer; 0 at the next call |

use core_algos::link::framing::crc32c;
use host_sim::base::error::Error;
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::Record;
use host_sim::run::script;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Memory through which the caller passes text and reads hashes and errors.
#[derive(Default)]
struct Buffers {
    text: Vec<u8>,
    hashes: Vec<u64>,
    message: String,
}

static BUFFERS: Mutex<Buffers> = Mutex::new(Buffers {
    text: Vec::new(),
    hashes: Vec::new(),
    message: String::new(),
});

fn buffers() -> MutexGuard<'static, Buffers> {
    BUFFERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hash of every bit of a record: CRC-32C of the record's text, forward and backward.
fn hash(record: &Record) -> u64 {
    // `Debug` of a float is the shortest text that reads back to the same bits.
    let text = format!("{record:?}").into_bytes();
    let forward = crc32c(&text);
    let backward = crc32c(&text.into_iter().rev().collect::<Vec<_>>());
    u64::from(forward) << 32 | u64::from(backward)
}

/// Bytes of the text buffer as UTF-8 text; an error if the bytes are not valid UTF-8.
fn utf8(text: &[u8]) -> Result<&str, Error> {
    std::str::from_utf8(text).map_err(|error| Error::input(error.to_string()))
}

/// Stores the hashes or the error of a run, and gives the number of epochs.
fn store_result(run: impl FnOnce(&[u8], &mut Vec<u64>) -> Result<(), Error>) -> usize {
    let mut buffers = buffers();
    let mut hashes = Vec::new();
    let done = run(&buffers.text, &mut hashes);
    (buffers.hashes, buffers.message) = match done {
        Ok(()) => (hashes, String::new()),
        Err(error) => (Vec::new(), error.to_string()),
    };
    buffers.hashes.len()
}

/// Resizes the text buffer to `length` bytes and gives its pointer.
#[unsafe(no_mangle)]
pub extern "C" fn text(length: usize) -> *mut u8 {
    let mut buffers = buffers();
    buffers.text.resize(length, 0);
    buffers.text.as_mut_ptr()
}

/// Drives to the goal of the scenario in the text buffer; gives the number of epochs.
#[unsafe(no_mangle)]
pub extern "C" fn trial(seed: u64, trial: u64) -> usize {
    store_result(|text, hashes| {
        let scenario = Scenario::parse(None, utf8(text)?, "scenario", &[])?;
        let mut robot = Simulation::new(&scenario, seed, trial)?;
        regulate_on(&mut robot, &scenario, |record| hashes.push(hash(record)))?;
        Ok(())
    })
}

/// Executes the steps of a script from the origin; gives the number of epochs. The text buffer holds a scenario of
/// `bytes` bytes, then the script.
#[unsafe(no_mangle)]
pub extern "C" fn drive(bytes: usize, seed: u64) -> usize {
    store_result(|text, hashes| {
        let (first, lines) = text.split_at_checked(bytes).unwrap_or((text, &[]));
        let mut scenario = Scenario::parse(None, utf8(first)?, "scenario", &[])?;
        scenario.mission.start = [0.0; 3];
        let lines = script::parse(utf8(lines)?, &scenario)?;
        let mut robot = Simulation::new(&scenario, seed, 0)?;
        let observe = |record: &Record| hashes.push(hash(record));
        script::execute(&mut robot, &scenario, &lines, observe, &mut Vec::new())
    })
}

/// Pointer to the hashes of the epochs of the latest run.
#[unsafe(no_mangle)]
pub extern "C" fn hashes() -> *const u64 {
    buffers().hashes.as_ptr()
}

/// Moves the error of the latest run into the text buffer and gives its length; 0 without an error.
#[unsafe(no_mangle)]
pub extern "C" fn message() -> usize {
    let mut buffers = buffers();
    buffers.text = std::mem::take(&mut buffers.message).into_bytes();
    buffers.text.len()
}
