//! `eval bus`: messages to frames and back, by the boards' codec.
//!
//! Input: `{"encode":MESSAGE}` or `{"decode":{"id":512,"data":"0a00…"}}` (two hexadecimal digits a
//! byte). Output: `{"id","data"}` or `{"message":MESSAGE}`.
//!
//! `MESSAGE` is one of, with postures as `[x,y,phi]`, covariances as 3×3, axles `"front"|"rear"`,
//! boards with `"beam"` too, modes `"idle"|"active"|"hold"|"clear"`,
//! nodes `"lead"|"front-axle"|"rear-axle"|"beam"`, states `"boot"|"idle"|"armed"|"active"|
//! "safe-stop"|"fault"`:
//! `{"TimeSync":{"epoch","last_delay_us"}}`,
//! `{"LeadStatus":{"sequence","mode","steering_rad","velocity_m_s"}}`,
//! `{"NodeStatus":{"node","sequence","state","reason","notices"}}`,
//! `{"ReferencePosture":{"axle","sequence","posture"}}`,
//! `{"ReferenceMotion":{"axle","sequence","velocity_m_s","yaw_rate_rad_s","acceleration_m_s2",
//! "yaw_acceleration_rad_s2"}}`,
//! `{"AxlePosture":{"axle","sequence","posture"}}`,
//! `{"AxleMotion":{"axle","sequence","velocity_m_s","yaw_rate_rad_s","refused","gyro_samples","gyro_zeroed",
//! "uptime"}}`,
//! `{"AxleUncertainty":{"axle","sequence","covariance"}}`,
//! `{"BeamPosture":{"sequence","posture","gauges"}}`,
//! `{"BeamUncertainty":{"sequence","covariance"}}`,
//! `{"BeamWrench":{"sequence","wrench":{"force_x","force_y","moment_root","moment_end"}}}`,
//! `{"BoardHealth":{"board","sequence","missed_ticks","tick_jitter_us","tick_worst_us",
//! "supply_v","temperature_c"}}`,
//! `{"BeamCalibration":{"sequence","calibrate":{"zero":1/m}|{"gain":1/m}}}`,
//! `{"BeamCalibrated":{"sequence","result","gauge"}}`,
//! `{"BoardIdentity":{"board","sequence","chip","build","schema"}}`.

use super::{Kernel, parse};
use core_algos::bus::{self, CanFrame, Message};
use serde::Deserialize;
use serde_json::{Value, json};

/// Kernel of `eval bus`: runs [`core_algos::bus::codec`] on each line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bus;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "lowercase")]
enum BusCase {
    Encode(Message),
    Decode(Bytes),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bytes {
    id: u16,
    data: String,
}

fn frame(bytes: &Bytes) -> Result<CanFrame, String> {
    let text = &bytes.data;
    let hexadecimal = text.bytes().all(|digit| digit.is_ascii_hexdigit());
    if !hexadecimal || !text.len().is_multiple_of(2) || text.len() > 16 {
        return Err(format!(
            "decode.data = {text:?}: must be 0 to 8 bytes of two hexadecimal digits each"
        ));
    }
    let mut data = [0; 8];
    for (byte, digits) in data.iter_mut().zip(text.as_bytes().chunks(2)) {
        let digits = String::from_utf8_lossy(digits);
        *byte = u8::from_str_radix(&digits, 16).map_err(|error| error.to_string())?;
    }
    Ok(CanFrame {
        id: bytes.id,
        length: (text.len() / 2) as u8,
        data,
    })
}

impl Kernel for Bus {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        match parse(text)? {
            BusCase::Encode(message) => {
                let frame = bus::encode(&message).map_err(|error| error.to_string())?;
                let bytes = frame.data.iter().take(usize::from(frame.length));
                let data: String = bytes.map(|byte| format!("{byte:02x}")).collect();
                Ok(json!({ "id": frame.id, "data": data }))
            }
            BusCase::Decode(bytes) => {
                let message = bus::decode(&frame(&bytes)?).map_err(|error| error.to_string())?;
                Ok(json!({ "message": message }))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_is_encoded_and_decoded() {
        let line = r#"{"encode":{"LeadStatus":
            {"sequence":3,"mode":"hold","steering_rad":-0.0001,"velocity_m_s":0.25}}}"#;
        let encoded = Bus.line(line).unwrap();
        // −1 and 2500 = 0x09c4 units, little-endian.
        assert_eq!(encoded, json!({ "id": 0x70, "data": "0302ffffc409" }));
        let decoded = Bus.line(&json!({ "decode": encoded }).to_string()).unwrap();
        assert_eq!(decoded["message"]["LeadStatus"]["mode"], "hold");
        let velocity = decoded["message"]["LeadStatus"]["velocity_m_s"].as_f64();
        assert!((velocity.unwrap() - 0.25).abs() < 1e-7);
    }

    #[test]
    fn errors_of_bad_lines_name_the_fault() {
        for (line, word) in [
            (r#"{"decode":{"id":112,"data":"03"}}"#, "must have 6"),
            (r#"{"decode":{"id":291,"data":"03"}}"#, "0x123"),
            (r#"{"decode":{"id":112,"data":"0"}}"#, "decode.data"),
            (r#"{"decode":{"id":112,"data":"+1"}}"#, "+1"),
            (
                r#"{"decode":{"id":112,"data":"030900000000"}}"#,
                "undefined",
            ),
            (
                r#"{"encode":{"BeamPosture":{"sequence":0,"posture":[9,0,0],"gauges":5}}}"#,
                "BeamPosture.x = 9",
            ),
            (r#"{"encode":{"BeamPosture":{"posture":[0]}}}"#, "posture"),
            (r#"{"encode":{"Wish":{}}}"#, "Wish"),
        ] {
            let error = Bus.line(line).unwrap_err();
            assert!(error.contains(word), "{line}: {error}");
        }
    }
}
