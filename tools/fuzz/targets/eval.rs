//! Lines of `cfmmr eval`: each line gives an output of finite numbers or an error.
#![no_main]

use cfmmr_fuzz::eval::{self, Kernel};
use cfmmr_fuzz::numbers::{Bytes, fill};
use libfuzzer_sys::fuzz_target;
use serde_json::Value;

const P3: &str = "[[#,0,0],[0,#,0],[0,0,#]]";
const FULL3: &str = "[[#,@,@],[@,#,@],[@,@,#]]";

/// First and further input lines of an algorithm; `#` stands for a number.
fn templates(algorithm: usize) -> [String; 2] {
    let diagonal: Vec<String> = (0..7)
        .map(|i| {
            format!(
                "[{}]",
                (0..7)
                    .map(|j| if i == j { "#" } else { "0" })
                    .collect::<Vec<_>>()
                    .join(",")
            )
        })
        .collect();
    let p7 = format!("[{}]", diagonal.join(","));
    let one = |line: &str| [line.to_owned(), line.to_owned()];
    match algorithm {
        0 => one(r##"{"length":#,"half_thickness":#,"rigid_root":#,"gauges":[0.02,0.1,0.18,0.26,#],"strain":[#,#,#,#,#]}"##),
        1 => one(&format!(r##"{{"a":[#,#,#],"A":{P3},"b":[#,#,#],"B":{}}}"##, FULL3.replace('@', "1e-3"))),
        2 => [
            format!(r##"{{"dt":#,"track":#,"Q":{p7},"R":[#,#,#,#],"R_pose":{P3},"x0":[#,#,#,#,#,#,#],"P0":{p7}}}"##),
            r##"{"left":#,"right":#,"gyro":#,"accel":#,"pose":[#,#,#]}"##.to_owned(),
        ],
        3 => [
            r##"{"track":#,"axle1":[#,#,#],"axle2":[#,#,#],"sigma":{"wheel":#,"r_y":#,"r_phi":#}}"##.to_owned(),
            r##"{"d":[#,#,#,#],"r":[#,#,#]}"##.to_owned(),
        ],
        4 => one(r##"{"posture":[#,#,#],"reference":[#,#,#],"v_r":#,"kappa_r":#,"r":#,"epsilon":#,"k1":#,"k2":#}"##),
        5 => one(r##"{"v":#,"kappa":#,"kappa_dot":#,"length":#,"form":"exact"}"##),
        6 => one(&format!(r##"{{"encode":{{"BeamUncertainty":{{"sequence":3,"covariance":{}}}}}}}"##, FULL3.replace('@', "#"))),
        _ => one(r##"{"length":#,"ei":#,"ea":#,"pose":[#,#,#],"seed_curvature":[#,#,#,#,#]}"##),
    }
}

fn kernel(algorithm: usize) -> Box<dyn Kernel> {
    match algorithm {
        0 => Box::new(eval::rps::Rps),
        1 => Box::new(eval::ci::Ci),
        2 => Box::new(eval::ekf::Ekf::default()),
        3 => Box::new(eval::ipec::Ipec::default()),
        4 => Box::new(eval::kinematic::Kinematic),
        5 => Box::new(eval::cascade::Cascade),
        6 => Box::new(eval::bus::Bus),
        _ => Box::new(eval::frame::Frame),
    }
}

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    let kind = bytes.byte();
    let algorithm = usize::from(kind) % 8;
    let input = if kind & 0x80 == 0 {
        bytes.0.to_vec()
    } else {
        let [first, further] = templates(algorithm);
        let mut text = fill(&first, &mut bytes);
        for _ in 0..8 {
            if bytes.is_empty() {
                break;
            }
            text += "\n";
            text += &fill(&further, &mut bytes);
        }
        text.into_bytes()
    };
    let mut output = Vec::new();
    let good =
        eval::run(kernel(algorithm).as_mut(), &*input, &mut output).expect("memory takes all");
    let lines = input.split(|&byte| byte == b'\n').count();
    assert!(
        output.len() <= 4000 * lines + 8 * input.len(),
        "{} bytes",
        output.len()
    );
    let (mut answers, mut errors) = (0, 0);
    for line in String::from_utf8(output).expect("text").lines() {
        let answer: Value = serde_json::from_str(line).expect("JSON");
        answers += 1;
        match answer.get("error") {
            Some(Value::String(error)) => {
                errors += 1;
                assert!(error.len() > 5, "{line}");
            }
            _ => {
                assert!(
                    answer.is_object() && finite(&answer),
                    "{}\n{line}",
                    String::from_utf8_lossy(&input)
                );
            }
        }
    }
    assert!(answers <= lines && good == (errors == 0));
});

/// True if all numbers are finite: JSON replaces other numbers by null.
fn finite(value: &Value) -> bool {
    match value {
        Value::Object(entries) => entries
            .iter()
            // An unknown bus delay is null.
            .all(|(key, value)| key == "last_delay_us" || finite(value)),
        Value::Array(values) => values.iter().all(finite),
        Value::Null => false,
        _ => true,
    }
}
