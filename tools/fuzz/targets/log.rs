//! Logs: a file of any content, or a sound log with changed messages, is read or refused as an input error.
#![no_main]

use cfmmr_fuzz::{entry, read};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let whole = match data.split_first() {
        Some((0, rest)) => rest.to_vec(),
        Some((kind, rest)) => in_a_file(rest, entry::FORMATS[usize::from(kind % 2)]),
        None => Vec::new(),
    };
    match read::read(&whole, "log") {
        Ok(recording) => {
            assert!(recording.ticks() > 0);
            for events in &recording.boards {
                assert!(
                    events
                        .windows(2)
                        .all(|pair| pair[0].tick() <= pair[1].tick())
                );
            }
        }
        Err(error) => {
            assert_eq!(error.exit_code(), 2, "{error}");
            assert!(error.to_string().starts_with("log: "), "{error}");
        }
    }
});

/// Log of a version of the format. Its messages are the lines of the input: topic, space, content.
fn in_a_file(lines: &[u8], format: &str) -> Vec<u8> {
    let room = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(room).expect("memory can be written to");
    let about = [("format".to_owned(), format.to_owned())];
    let metadata = mcap::records::Metadata {
        name: entry::ABOUT.to_owned(),
        metadata: about.into_iter().collect(),
    };
    writer.write_metadata(&metadata).expect("memory");
    for (sequence, line) in lines.split(|byte| *byte == b'\n').enumerate() {
        let Some(blank) = line.iter().position(|byte| *byte == b' ') else {
            continue;
        };
        let topic = String::from_utf8_lossy(&line[..blank]);
        let Ok(channel_id) = writer.add_channel(0, &topic, "json", &Default::default()) else {
            continue;
        };
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: sequence as u64,
            publish_time: sequence as u64,
        };
        let content = &line[blank + 1..];
        writer
            .write_to_known_channel(&header, content)
            .expect("memory");
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}
