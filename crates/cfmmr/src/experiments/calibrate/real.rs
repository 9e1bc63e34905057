//! Calibration of a real robot's strain gauges by its beam board. The request passes through the front board's port and
//! the bus.

use crate::experiments::result::{Json, Provenance};
use crate::experiments::run::links::Links;
use core_algos::bus::field::{Calibrate, CalibrationResult};
use core_algos::bus::{self, CanFrame, Message};
use core_algos::topology::{FrameId, Role};
use host_sim::base::error::Error;
use host_sim::run::script::calibration_error;
use remote::board_link::BoardLink;
use remote::board_log::BoardLog;
use remote::link::Link;
use serde::Serialize;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

/// Timeout of the beam board's answer. The board averages for 3 s.
const TIMEOUT: Duration = Duration::from_secs(15);
const READ_TIMEOUT: Duration = Duration::from_millis(10);

/// Result of a calibration by the beam board.
#[derive(Debug, Serialize)]
struct BoardCalibrationReport {
    calibrate: Calibrate,
    result: CalibrationResult,
    /// Gauge that caused the failure, counted from 1 at the root; `None` if no gauge caused a failure.
    gauge: Option<u8>,
}

/// Calibrates gains on a former of this curvature (1/m), or zeros on a straight strip. Asks the user first if `confirm`
/// is true.
pub fn run(links: &Links, former: Option<f64>, confirm: bool, json: &Json) -> Result<(), Error> {
    let (calibrate, hold) = match former {
        None => (Calibrate::Zero(0.0), "straight, against an edge".to_owned()),
        Some(curvature) => (
            Calibrate::Gain(curvature as f32),
            format!("on the former of {curvature} per metre"),
        ),
    };
    if let Some(flat) = former.filter(|curvature| curvature.abs() < 0.1) {
        return Err(Error::input(format!(
            "--former {flat}: must be at least 0.1 per metre in magnitude: a flatter former does not determine \
             the gains"
        )));
    }
    // The sequence number distinguishes this answer from answers to earlier runs of the command.
    let sequence = (std::process::id() % 256) as u8;
    let message = Message::BeamCalibration {
        frame: FrameId(0),
        sequence,
        calibrate,
    };
    let frame =
        bus::encode(&message).map_err(|error| Error::input(format!("--former: {error}")))?;
    let log = BoardLog::new(links.robot.name(Role::LEAD));
    let Some(port) = links.open(Role::LEAD, &log)? else {
        return Err(Error::input(
            "--on serial: must be serial:front=PORT: the request passes through the front board",
        ));
    };
    if confirm {
        wait_for_confirmation(&hold)?;
    }
    let link = BoardLink::new(links.robot, Role::LEAD, 0);
    let (result, gauge) = request(port, link, sequence, &frame)?;
    let named = matches!(
        result,
        CalibrationResult::BadSample | CalibrationResult::Noisy | CalibrationResult::Drifting
    );
    let report = BoardCalibrationReport {
        calibrate,
        result,
        gauge: named.then_some(gauge.saturating_add(1)),
    };
    json.write(&Provenance::default(), &report)?;
    match calibration_error(result, gauge) {
        Some(error) => Err(error),
        None => json.print("calibrated and saved\n"),
    }
}

/// Waits until the user confirms that the strip is held.
fn wait_for_confirmation(hold: &str) -> Result<(), Error> {
    if !io::stdin().is_terminal() {
        return Err(Error::input(
            "standard input is not a terminal, so the held strip cannot be confirmed: use --yes",
        ));
    }
    // Standard output may carry the JSON result.
    let _ = write!(io::stderr(), "hold the strip {hold}, then press Enter ");
    match io::stdin().read_line(&mut String::new())? {
        0 => Err(Error::input("not confirmed: nothing was calibrated")),
        _ => Ok(()),
    }
}

/// Sends the request and waits for the answer of the beam board: result and index of the gauge.
fn request(
    mut port: Box<dyn Link>,
    mut link: BoardLink,
    sequence: u8,
    frame: &CanFrame,
) -> Result<(CalibrationResult, u8), Error> {
    link.watch();
    link.send(frame);
    let began = Instant::now();
    let mut room = [0; 512];
    while began.elapsed() < TIMEOUT {
        if let Some(bytes) = link.to_send(began.elapsed().as_micros() as u64)? {
            port.send(bytes)?;
        }
        let count = port.receive(&mut room, READ_TIMEOUT)?;
        link.take(&room[..count])?;
        for frame in link.take_frames() {
            if let Ok(Message::BeamCalibrated {
                frame: FrameId(0),
                sequence: answered,
                result,
                gauge,
            }) = bus::decode(&frame)
                && answered == sequence
            {
                return Ok((result, gauge));
            }
        }
    }
    Err(Error::Failure(format!(
        "beam board: no answer in {TIMEOUT:?}: check that the beam board is on the bus"
    )))
}
