//! Dashboard on a pseudo-terminal: it draws the run, reacts to keys, and restores the terminal.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

#[path = "shared/program.rs"]
mod program;
mod terminal;

use cfmmr::dashboard::Dashboard;
use core_algos::link::protocol::StackUse;
use core_algos::link::{Identity, SimLink};
use core_algos::topology::Role;
use core_algos::topology::Topology;
use program::{assert_refused, command};
use rustix::termios::{LocalModes, tcgetattr};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};
use terminal::pseudo_terminal;

/// Timeout of a test step.
const TIMEOUT: Duration = Duration::from_secs(120);
const ENTER: &str = "\x1b[?1049h";
const LEAVE: &str = "\x1b[?1049l";

/// `cfmmr` on a pseudo-terminal of its own.
struct Session {
    keyboard: File,
    /// The program's side of the terminal, from which the test reads the terminal modes.
    terminal: File,
    screen: Receiver<Vec<u8>>,
    shown: String,
    child: Child,
}

impl Session {
    fn start(command: &mut Command) -> Self {
        let (master, path) = pseudo_terminal();
        let mut options = OpenOptions::new();
        let terminal = options.read(true).write(true).open(path).unwrap();
        let end = || Stdio::from(OwnedFd::from(terminal.try_clone().unwrap()));
        let child = command
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn()
            .unwrap();
        let keyboard = File::from(master);
        let mut from = keyboard.try_clone().unwrap();
        let (to, screen) = channel();
        thread::spawn(move || {
            let mut room = [0; 4096];
            while let Ok(count @ 1..) = from.read(&mut room) {
                if to.send(room[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            keyboard,
            terminal,
            screen,
            shown: String::new(),
            child,
        }
    }

    /// Waits until `has` is true for the words of a line on the screen; returns the line.
    fn expect_line(&mut self, has: impl Fn(&[&str]) -> bool) -> String {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let screen = screen(&self.shown);
            let words = |line: &String| has(&line.split_whitespace().collect::<Vec<_>>());
            if let Some(line) = screen.iter().find(|line| words(line)) {
                return line.clone();
            }
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(bytes) = self.screen.recv_timeout(left) else {
                panic!("not on the screen:\n{}", screen.join("\n"));
            };
            self.shown += &String::from_utf8_lossy(&bytes);
        }
    }

    /// Waits until the program has printed `text`.
    fn expect(&mut self, text: &str) {
        let deadline = Instant::now() + TIMEOUT;
        while !self.shown.contains(text) {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(bytes) = self.screen.recv_timeout(left) else {
                panic!("no {text:?} in {:?}", self.shown);
            };
            self.shown += &String::from_utf8_lossy(&bytes);
        }
    }

    fn press(&mut self, key: &[u8]) {
        self.keyboard.write_all(key).unwrap();
    }

    /// Waits for the end of the program and keeps its output.
    fn end(&mut self) -> ExitStatus {
        let deadline = Instant::now() + TIMEOUT;
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < deadline, "does not end: {:?}", self.shown);
            thread::sleep(Duration::from_millis(10));
        };
        while let Ok(bytes) = self.screen.recv_timeout(Duration::from_millis(300)) {
            self.shown += &String::from_utf8_lossy(&bytes);
        }
        status
    }

    /// True if the terminal echoes and delivers input line by line, as for a shell.
    fn is_in_line_mode(&self) -> bool {
        let modes = tcgetattr(&self.terminal).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
    }
}

/// Screen of a terminal after these characters; interprets only the sequences that the dashboard uses.
fn screen(shown: &str) -> Vec<String> {
    let mut lines = vec![vec![' '; 80]; 24];
    let (mut row, mut column) = (0, 0);
    let mut rest = shown.chars();
    while let Some(c) = rest.next() {
        if c != '\x1b' {
            if let Some(cell) = lines.get_mut(row).and_then(|line| line.get_mut(column)) {
                *cell = c;
            }
            column += 1;
            continue;
        }
        // ESC [ numbers letter: only cursor positions matter here.
        let mut sequence = String::new();
        for c in rest.by_ref().skip(1) {
            sequence.push(c);
            if c.is_ascii_alphabetic() {
                break;
            }
        }
        if let Some((r, c)) = sequence.strip_suffix('H').and_then(|at| at.split_once(';')) {
            (row, column) = (r.parse().unwrap_or(1) - 1, c.parse().unwrap_or(1) - 1);
        }
    }
    lines.into_iter().map(String::from_iter).collect()
}

impl Drop for Session {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn posture(folder: &tempfile::TempDir) -> Session {
    let mut session = Session::start(&mut command(folder.path(), "posture --dashboard"));
    for text in [ENTER, "RearAxle", "Links", "Estimate", "Faults"] {
        session.expect(text);
    }
    // The lead node drives when its state is `Active`.
    session.expect("Active");
    assert!(!session.is_in_line_mode(), "keys come one by one");
    session
}

#[test]
fn q_and_control_c_end_the_run_and_restore_the_terminal() {
    for key in [b"q", b"\x03"] {
        let folder = tempfile::tempdir().unwrap();
        let mut session = posture(&folder);
        session.press(key);
        let status = session.end();
        assert_eq!(status.code(), Some(130), "{status}: {:?}", session.shown);
        assert!(session.is_in_line_mode());
        let (_, after) = session.shown.rsplit_once(LEAVE).expect("left the screen");
        assert!(
            after.contains("interrupted") && after.contains("result.json"),
            "{after:?}"
        );
        let written = folder.path().join("out/posture/result.json");
        assert!(written.exists(), "the result of what was done");
    }
}

#[test]
fn signal_ends_the_run_and_restores_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = posture(&folder);
    let process = rustix::process::Pid::from_child(&session.child);
    rustix::process::kill_process(process, rustix::process::Signal::TERM).unwrap();
    assert_eq!(session.end().code(), Some(130));
    assert!(session.is_in_line_mode());
    let (_, after) = session.shown.rsplit_once(LEAVE).expect("left the screen");
    assert!(after.contains("interrupted"), "{after:?}");
}

fn drive(folder: &tempfile::TempDir, arguments: &[&str]) -> Session {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cfmmr"));
    command.arg("drive").args(arguments);
    Session::start(command.current_dir(folder.path()))
}

/// Three keys forward and one to the left set speed and curvature, the space bar stops the robot, and the result is
/// written.
#[test]
fn keys_drive_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = drive(&folder, &[]);
    session.expect_line(|words| words.contains(&"WASD:"));
    for key in [&b"w"[..], b"\x1b[A", b"W", b"a"] {
        session.press(key);
    }
    session.expect_line(|words| words.starts_with(&["0.09", "m/s", "+0.38", "1/m"]));
    session.expect_line(|words| words.windows(2).any(|pair| pair == ["speed", "0.094"]));
    session.press(b" ");
    session.expect_line(|words| words.windows(2).any(|pair| pair == ["speed", "0.000"]));
    session.press(b"q");
    assert_eq!(session.end().code(), Some(0), "{:?}", session.shown);
    assert!(session.is_in_line_mode());
    let result = std::fs::read(folder.path().join("out/drive/result.json")).unwrap();
    let result: serde_json::Value = serde_json::from_slice(&result).unwrap();
    let step = &result["steps"][0];
    let [x, y] = [0, 1].map(|k| step["end"]["estimate"][k].as_f64().unwrap());
    assert!(
        step["end"]["kind"] == "done" && x > 0.03 && y > 0.0,
        "{step}"
    );
}

#[test]
fn control_c_in_a_drive_by_keyboard_is_an_interrupt() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = drive(&folder, &[]);
    session.expect_line(|words| words.contains(&"WASD:"));
    session.press(b"w\x03");
    assert_eq!(session.end().code(), Some(130), "{:?}", session.shown);
    assert!(session.is_in_line_mode());
    let result = std::fs::read(folder.path().join("out/drive/result.json")).unwrap();
    let result: serde_json::Value = serde_json::from_slice(&result).unwrap();
    assert_eq!(result["steps"][0]["end"]["kind"], "interrupted");
}

/// The terminal closes while the keyboard drives, on the way to a goal, and during the last view.
#[test]
fn closed_terminal_ends_the_program() {
    for (arguments, shown) in [
        ("drive", "WASD:"),
        ("drive goto 9 0 0 --dashboard", "Active"),
        ("drive wait 0.1 --dashboard", "done after"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (master, path) = pseudo_terminal();
        let mut options = OpenOptions::new();
        let terminal = options.read(true).write(true).open(path).unwrap();
        let end = || Stdio::from(OwnedFd::from(terminal.try_clone().unwrap()));
        let mut command = command(folder.path(), arguments);
        let command = command.stdin(end()).stdout(end()).stderr(end());
        let mut child = command.spawn().unwrap();
        let (mut master, mut text, mut room) = (File::from(master), String::new(), [0; 4096]);
        while !screen(&text).iter().any(|line| line.contains(shown)) {
            let count = master.read(&mut room).unwrap();
            text += &String::from_utf8_lossy(&room[..count]);
        }
        drop(master);
        let deadline = Instant::now() + TIMEOUT;
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if Instant::now() > deadline {
                child.kill().unwrap();
                panic!("{arguments}: lives on");
            }
            thread::sleep(Duration::from_millis(10));
        };
        assert_eq!(status.code(), Some(130), "{arguments}");
        assert!(folder.path().join("out/drive/result.json").exists());
    }
}

/// Keys pause the simulation, step one epoch and increase the speed; the last view stays.
#[test]
fn simulation_is_paused_stepped_and_sped_up_by_keys() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = drive(&folder, &["goto", "1", "0", "0", "--dashboard"]);
    session.expect("Active");
    session.press(b"p");
    session.expect_line(|words| words.contains(&"PAUSED:"));
    session.press(b".");
    session.press(b"p");
    session.press(b"++");
    session.expect_line(|words| words.windows(2).any(|pair| pair == ["speed", "4"]));
    session.expect_line(|words| words.starts_with(&["reached", "after"]));
    session.press(b"q");
    assert_eq!(session.end().code(), Some(0), "{:?}", session.shown);
}

/// Path of a serial port with a front board; answer number `damaged` is damaged.
fn front_board(damaged: usize) -> String {
    let (master, path) = pseudo_terminal();
    let identity = Identity {
        role: Role::LEAD,
        build: "test",
    };
    let mut port = File::from(master);
    thread::spawn(move || {
        let mut sim_link = SimLink::new(identity, StackUse::unknown);
        let (mut room, mut answers) = ([0; 4096], 0);
        loop {
            match port.read(&mut room) {
                Ok(count) => {
                    let mut answer = Vec::new();
                    sim_link.receive(&room[..count], &mut |bytes| answer.extend_from_slice(bytes));
                    answers += usize::from(!answer.is_empty());
                    if answers == damaged {
                        // The byte that ends a frame is neither 1 nor 2.
                        answer[1] = if answer[1] == 1 { 2 } else { 1 };
                        answers += 1;
                    }
                    port.write_all(&answer).unwrap();
                }
                // Reading fails while the program has not opened its end of the terminal.
                Err(_) => thread::sleep(Duration::from_millis(5)),
            }
        }
    });
    path
}

#[test]
fn board_at_a_serial_port_is_shown_with_its_frames_and_losses() {
    let folder = tempfile::tempdir().unwrap();
    let port = front_board(300);
    let arguments = format!("hil --dashboard --on serial:front={port}");
    let mut session = Session::start(&mut command(folder.path(), &arguments));
    // The words may follow others: the screen shows nodes to the left of links, in the same lines.
    let outside = ["rear", "without", "a", "port"];
    session.expect_line(|words| words.windows(4).any(|words| words == outside));
    let counts = |words: &[&str]| -> Option<[u32; 3]> {
        let place = words.iter().position(|word| *word == "front")?;
        let counts: Vec<_> = words
            .get(place + 1..)?
            .iter()
            .map(|word| word.parse())
            .collect();
        let counts: Result<Vec<u32>, _> = counts.into_iter().collect();
        counts.ok()?.try_into().ok()
    };
    // The damaged answer counts as damaged and as lost, and the host has repeated its request.
    session.expect_line(|words| {
        counts(words)
            .is_some_and(|[frames, lost, damaged]| frames >= 300 && lost >= 1 && damaged == 1)
    });
    session.expect_line(|words| words.contains(&"Active"));
    session.press(b"q");
    assert_eq!(session.end().code(), Some(130), "{:?}", session.shown);
    assert!(session.is_in_line_mode());
}

#[test]
fn virtual_boards_are_shown_with_their_heartbeats() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "posture --on virtual --dashboard --kill beam@0.2";
    let mut session = Session::start(&mut command(folder.path(), arguments));
    session.expect_line(|words| words.contains(&"RearAxle") && words.contains(&"Idle"));
    session.expect_line(|words| words.ends_with(&["beam", "off"]));
    session.expect_line(|words| words.contains(&"RearAxle") && words.contains(&"Active"));
    let frames = session.expect_line(|words| words.contains(&"bus"));
    let frames = frames
        .split_whitespace()
        .rev()
        .nth(1)
        .unwrap()
        .parse::<u32>();
    assert!(frames.unwrap() > 0);
    session.press(b"q");
    assert_eq!(session.end().code(), Some(130), "{:?}", session.shown);
    assert!(session.is_in_line_mode());
}

/// `a_panic_leaves_the_terminal_as_it_was` starts this test on a terminal of its own.
#[test]
#[ignore = "a part of a_panic_leaves_the_terminal_as_it_was, which runs it on a terminal"]
fn panics_with_the_dashboard_open() {
    let _dashboard = Dashboard::open(
        "test",
        Topology::PAIR,
        [0.0; 3],
        Default::default(),
        Default::default(),
    )
    .unwrap();
    thread::sleep(Duration::from_millis(200));
    panic!("told after the dashboard");
}

#[test]
fn a_panic_leaves_the_terminal_as_it_was() {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args([
        "--exact",
        "panics_with_the_dashboard_open",
        "--ignored",
        "--nocapture",
    ]);
    let mut session = Session::start(&mut command);
    session.expect(ENTER);
    session.expect("Links");
    assert!(!session.end().success());
    assert!(session.is_in_line_mode());
    let (_, after) = session.shown.split_once(LEAVE).expect("left the screen");
    assert!(after.contains("told after the dashboard"), "{after:?}");
}

#[test]
fn dashboard_without_a_terminal_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for command in ["posture", "follow"] {
        assert_refused(
            folder.path(),
            command,
            "--dashboard | --dashboard | terminal",
        );
    }
}
