//! Prints the hash of every epoch of each case of `cases.json`, computed on this machine. `compare.mjs` compares the
//! hashes with those from WebAssembly.
//!
//! With `loop N` or `plant N` it runs the work of `speed.mjs` instead: N trials, or N ticks of the plant.

use serde_json::Value;

fn put(parts: &[&str]) {
    let all = parts.concat();
    let from = web::text(all.len());
    // SAFETY: the buffer has this length until the next call of `text`.
    unsafe { std::slice::from_raw_parts_mut(from, all.len()) }.copy_from_slice(all.as_bytes());
}

/// Error text of the latest run; empty without an error.
fn error() -> String {
    let length = web::message();
    let from = web::text(length);
    // SAFETY: the buffer has this length until the next call of `text`.
    let text = unsafe { std::slice::from_raw_parts(from, length) };
    String::from_utf8_lossy(text).into_owned()
}

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [what, count] = arguments.as_slice() {
        let count: u64 = count.parse().map_err(|error| format!("{count}: {error}"))?;
        put(&[]);
        let done = match what.as_str() {
            "loop" => (0..count).all(|trial| web::outcome(1, trial) > 0),
            _ => web::drive_plant(count as usize) > 0,
        };
        return if done || count == 0 {
            Ok(())
        } else {
            Err(error())
        };
    }
    let cases: Vec<Value> =
        serde_json::from_str(include_str!("../cases.json")).expect("cases in JSON");
    for case in cases {
        let text = |key: &str| case[key].as_str().unwrap_or_default();
        let scenario = text("scenario");
        for trial in 0..case["trials"].as_u64().unwrap_or(1) {
            put(&[scenario, text("script")]);
            let epochs = match case["script"].is_null() {
                true => web::trial(1, trial),
                false => web::drive(scenario.len(), 1),
            };
            if epochs == 0 {
                return Err(format!("{}: {}", text("name"), error()));
            }
            // SAFETY: the buffer has a hash for each epoch until the next run.
            let hashes = unsafe { std::slice::from_raw_parts(web::hashes(), epochs) };
            let hashes: Vec<String> = hashes.iter().map(|hash| format!("{hash:016x}")).collect();
            println!("{}, trial {trial}: {}", text("name"), hashes.join(" "));
        }
    }
    Ok(())
}
