//! The simulated robot for WebAssembly.
//!
//! Functions take and return numbers. Text passes through the buffer of [`text`], numbers through that of [`numbers`],
//! hashes are in the buffer of [`hashes`]. Memory may grow during a call, so a caller gets the pointers after the call.
//! A function that returns a count returns 0 on an error; [`message`] then gives the error.
//!
//! | call | gives |
//! |---|---|
//! | [`text`]`(length)` | pointer to a buffer for text in UTF-8 |
//! | [`numbers`]`(count)` | pointer to a buffer for numbers |
//! | [`message`]`()` | length of the latest error, which moves into the text buffer; 0 at the next call |
//! | [`describe`]`(axles)` | length of a description in JSON: choices, codes, faults, dimensions, layout of the state |
//!
//! Whole runs:
//!
//! | call | gives |
//! |---|---|
//! | [`trial`]`(seed, trial)` | epochs of posture regulation in the scenario of the text buffer |
//! | [`drive`]`(bytes, seed)` | epochs of a script; the buffer holds a scenario of that many bytes, then the script |
//! | [`hashes`]`()` | pointer to a 64-bit hash for each epoch of the latest run |
//! | [`outcome`]`(seed, trial)` | numbers of the end of a posture regulation |
//! | [`drive_plant`]`(ticks)` | the plant alone, without sensors and boards, for comparisons of speed |
//!
//! A robot in progress. A call that refuses gives 0:
//!
//! | call | does |
//! |---|---|
//! | [`create`]`(seed, trial)` | new robot at the start of the scenario in the text buffer |
//! | [`change`]`()` | new settings for the robot as it stands, from the scenario in the text buffer |
//! | [`place`]`(x, y, phi)` | lifts the robot and places it elsewhere |
//! | [`advance`]`(ticks)` | gives the ticks of 1 ms that were done |
//! | [`state`]`()` | numbers of the latest state |
//! | [`regulate`]`(x, y, phi)`, [`follow`]`(points)`, [`speed`]`(v, curvature)`, [`halt`]`()`, [`clear`]`()` | tasks |
//! | [`planned`]`()` | points of the planned path |
//! | [`fault`]`(number)`, [`friction`]`(mu)`, [`gauge_drift`]`(strain)` | faults and changes without interruption |

mod describe;
mod drawn_path;
mod faults;
mod live;

use core_algos::link::framing::crc32c;
use core_algos::topology::MAX_AXLES;
use host_sim::base::error::Error;
use host_sim::base::statistics;
use host_sim::run::end::EndKind;
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::Record;
use host_sim::run::script;
use host_sim::run::simulation::{DrawnPlant, Simulation};
use host_sim::scenario::Scenario;
use live::Live;
use std::cell::RefCell;

/// Memory through which the caller passes text and numbers, and the robot in progress.
#[derive(Default)]
struct Host {
    text: Vec<u8>,
    numbers: Vec<f64>,
    hashes: Vec<u64>,
    message: String,
    robot: Option<Live>,
}

thread_local! {
    static HOST: RefCell<Host> = RefCell::default();
}

impl Host {
    /// Scenario in the text buffer.
    fn scenario(&self) -> Result<Scenario, Error> {
        Scenario::parse(None, utf8(&self.text)?, "scenario", &[])
    }

    fn robot(&mut self) -> Result<&mut Live, Error> {
        let missing = || Error::input("robot: must be created first");
        self.robot.as_mut().ok_or_else(missing)
    }
}

/// Runs a call that gives a count. An error becomes the message, and the count 0.
fn counted(call: impl FnOnce(&mut Host) -> Result<usize, Error>) -> usize {
    HOST.with_borrow_mut(|host| {
        host.message.clear();
        call(host).unwrap_or_else(|error| {
            host.message = error.to_string();
            0
        })
    })
}

/// Runs a call on the robot in progress; gives 1, or 0 with a message.
fn on_robot(call: impl FnOnce(&mut Live) -> Result<(), Error>) -> usize {
    counted(|host| call(host.robot()?).map(|()| 1))
}

/// Hash of every bit of a record: CRC-32C of the record's text, forward and backward.
fn hash(record: &Record) -> u64 {
    // `Debug` of a float is the shortest text that reads back to the same bits.
    let text = format!("{record:?}").into_bytes();
    let forward = crc32c(&text);
    let backward = crc32c(&text.into_iter().rev().collect::<Vec<_>>());
    u64::from(forward) << 32 | u64::from(backward)
}

/// Bytes as UTF-8 text; an error if the bytes are not valid UTF-8.
fn utf8(text: &[u8]) -> Result<&str, Error> {
    std::str::from_utf8(text).map_err(|error| Error::input(error.to_string()))
}

/// Stores the hashes of a run, and gives the number of epochs.
fn hashed(run: impl FnOnce(&Host, &mut Vec<u64>) -> Result<(), Error>) -> usize {
    counted(|host| {
        let mut hashes = Vec::new();
        let done = run(host, &mut hashes);
        host.hashes = if done.is_ok() { hashes } else { Vec::new() };
        done.map(|()| host.hashes.len())
    })
}

/// Resizes the text buffer to `length` bytes and gives its pointer.
#[unsafe(no_mangle)]
pub extern "C" fn text(length: usize) -> *mut u8 {
    HOST.with_borrow_mut(|host| {
        host.text.resize(length, 0);
        host.text.as_mut_ptr()
    })
}

/// Resizes the buffer of numbers to `count` and gives its pointer.
#[unsafe(no_mangle)]
pub extern "C" fn numbers(count: usize) -> *mut f64 {
    HOST.with_borrow_mut(|host| {
        host.numbers.resize(count, 0.0);
        host.numbers.as_mut_ptr()
    })
}

/// Moves the error of the latest call into the text buffer and gives its length; 0 without an error.
#[unsafe(no_mangle)]
pub extern "C" fn message() -> usize {
    HOST.with_borrow_mut(|host| {
        host.text = std::mem::take(&mut host.message).into_bytes();
        host.text.len()
    })
}

/// Moves a description of a robot with a number of axles, in JSON, into the text buffer and gives its length.
#[unsafe(no_mangle)]
pub extern "C" fn describe(axles: usize) -> usize {
    counted(|host| {
        host.text = describe::json(axles)?.to_string().into_bytes();
        Ok(host.text.len())
    })
}

/// Drives to the goal of the scenario in the text buffer; gives the number of epochs.
#[unsafe(no_mangle)]
pub extern "C" fn trial(seed: u64, trial: u64) -> usize {
    hashed(|host, hashes| {
        let scenario = host.scenario()?;
        let mut robot = Simulation::new(&scenario, seed, trial)?;
        regulate_on(&mut robot, &scenario, |record| hashes.push(hash(record)))?;
        Ok(())
    })
}

/// Executes the steps of a script from the origin; gives the number of epochs. The text buffer holds a scenario of
/// `bytes` bytes, then the script.
#[unsafe(no_mangle)]
pub extern "C" fn drive(bytes: usize, seed: u64) -> usize {
    hashed(|host, hashes| {
        let all = host.text.as_slice();
        let (first, lines) = all.split_at_checked(bytes).unwrap_or((all, &[]));
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
    HOST.with_borrow(|host| host.hashes.as_ptr())
}

/// Drives to the goal of the scenario in the text buffer. Numbers: end, true posture (3), estimated posture (3),
/// distance from the goal (m), 95 % error (m), duration (s), normalised estimation error squared.
#[unsafe(no_mangle)]
pub extern "C" fn outcome(seed: u64, trial: u64) -> usize {
    counted(|host| {
        let scenario = host.scenario()?;
        let mut robot = Simulation::new(&scenario, seed, trial)?;
        let mut last = Record::default();
        let outcome = regulate_on(&mut robot, &scenario, |record| last = record.clone())?;
        let estimate = last.lead.fused.robot;
        let at = estimate.posture;
        let [x, y, _] = outcome.midpoint;
        let goal = scenario.mission.goal;
        let end = EndKind::ALL
            .iter()
            .position(|&kind| kind == outcome.end.kind);
        host.numbers.clear();
        host.numbers.push(end.map_or(f64::NAN, |end| end as f64));
        host.numbers.extend(outcome.midpoint);
        host.numbers.extend([at.x, at.y, at.phi].map(f64::from));
        host.numbers.push(libm::hypot(x - goal[0], y - goal[1]));
        host.numbers.push(estimate.half_axes_95()[0].into());
        host.numbers.push(outcome.end.duration_s);
        host.numbers
            .push(statistics::nees(&estimate, outcome.midpoint));
        Ok(host.numbers.len())
    })
}

/// Drives the plant of the scenario in the text buffer by changing torques for a number of ticks; gives that number.
#[unsafe(no_mangle)]
pub extern "C" fn drive_plant(ticks: usize) -> usize {
    counted(|host| {
        let scenario = host.scenario()?;
        let drawn = scenario.world.draw(scenario.robot.topology(), 1, 0);
        let mut plant = DrawnPlant::new(&scenario, &drawn)?.plant;
        let axles = plant.axles().len();
        for tick in 0..ticks {
            let torque = 0.5 * libm::sin(1e-3 * tick as f64);
            let mut torques = [[torque; 2]; MAX_AXLES];
            torques[0][1] = 0.8 * torque;
            plant.step(&torques[..axles]);
        }
        Ok(ticks)
    })
}

/// Creates a robot at rest at the start of the scenario in the text buffer.
#[unsafe(no_mangle)]
pub extern "C" fn create(seed: u64, trial: u64) -> usize {
    counted(|host| {
        host.robot = Some(Live::new(host.scenario()?, seed, trial)?);
        Ok(1)
    })
}

/// Gives the robot the settings of the scenario in the text buffer.
#[unsafe(no_mangle)]
pub extern "C" fn change() -> usize {
    counted(|host| {
        let scenario = host.scenario()?;
        host.robot()?.change(scenario).map(|()| 1)
    })
}

/// Places the robot at a posture (m, m, rad).
#[unsafe(no_mangle)]
pub extern "C" fn place(x: f64, y: f64, phi: f64) -> usize {
    on_robot(|robot| robot.place([x, y, phi]))
}

/// Advances the robot by ticks of 1 ms; gives the number done. With fewer than asked there is a message.
#[unsafe(no_mangle)]
pub extern "C" fn advance(ticks: usize) -> usize {
    let mut done = 0;
    on_robot(|robot| {
        while done < ticks {
            robot.step()?;
            done += 1;
        }
        Ok(())
    });
    done
}

/// Puts the robot's state into the buffer of numbers; gives their count.
#[unsafe(no_mangle)]
pub extern "C" fn state() -> usize {
    counted(|host| {
        let mut numbers = std::mem::take(&mut host.numbers);
        numbers.clear();
        host.robot()?.visit(&mut |_, values| numbers.extend(values));
        host.numbers = numbers;
        Ok(host.numbers.len())
    })
}

/// Drives to a goal posture (m, m, rad).
#[unsafe(no_mangle)]
pub extern "C" fn regulate(x: f64, y: f64, phi: f64) -> usize {
    on_robot(|robot| robot.regulate([x, y, phi]))
}

/// Follows the path through `points` points in the buffer of numbers, x and y of each (m), once the robot rests.
#[unsafe(no_mangle)]
pub extern "C" fn follow(points: usize) -> usize {
    counted(|host| {
        let (drawn, _) = host.numbers.as_chunks::<2>();
        let drawn = drawn.get(..points).unwrap_or(drawn).to_vec();
        host.robot()?.follow(&drawn).map(|()| 1)
    })
}

/// Puts the planned path into the buffer of numbers, x and y of each point (m); gives the number of points. 0 with a
/// message if the robot could not begin its path. The path changes with the number `plans` of the state.
#[unsafe(no_mangle)]
pub extern "C" fn planned() -> usize {
    counted(|host| {
        let planned = host.robot()?.planned()?.as_flattened().to_vec();
        host.numbers = planned;
        Ok(host.numbers.len() / 2)
    })
}

/// Drives by hand with a speed (m/s) and a curvature (1/m).
#[unsafe(no_mangle)]
pub extern "C" fn speed(speed_m_s: f64, curvature: f64) -> usize {
    on_robot(|robot| robot.speed(speed_m_s, curvature))
}

/// Brakes and holds.
#[unsafe(no_mangle)]
pub extern "C" fn halt() -> usize {
    on_robot(|robot| {
        robot.halt();
        Ok(())
    })
}

/// Clears the faults of the boards whose causes are gone.
#[unsafe(no_mangle)]
pub extern "C" fn clear() -> usize {
    on_robot(|robot| {
        robot.clear();
        Ok(())
    })
}

/// Injects a fault by its number in the description.
#[unsafe(no_mangle)]
pub extern "C" fn fault(number: usize) -> usize {
    on_robot(|robot| robot.fault(number))
}

/// Sets the friction coefficient of the floor.
#[unsafe(no_mangle)]
pub extern "C" fn friction(mu: f64) -> usize {
    on_robot(|robot| robot.friction(mu))
}

/// Adds a strain to the zeros of all gauges.
#[unsafe(no_mangle)]
pub extern "C" fn gauge_drift(strain: f64) -> usize {
    on_robot(|robot| robot.drift_gauges(strain))
}
