//! `cfmmr serial`: prints `docs/serial.md`, the description of the serial protocol. The tests here
//! compare its tables and numbers with the protocol.

use host_sim::base::error::Error;
use output::terminal;

const PAGE: &str = include_str!("../../../../docs/serial.md");

/// Prints the page.
pub fn run() -> Result<(), Error> {
    terminal::print_page(PAGE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::link::framing::{MAX_FRAME, MAX_PAYLOAD};
    use core_algos::link::protocol::{
        CONFIG_CHUNK, MAX_BUS_FRAMES, MAX_SENT_FRAMES, POINTS, PROTOCOL, Reply, Request, decode,
        encode,
    };
    use core_algos::link::record::Entry;
    use serde::{Deserialize, Serialize};
    use serde_json::Value;

    /// Name and fields of every variant of `T`, found by decoding each variant number followed by zero bytes.
    fn variants<'a, T: Deserialize<'a> + Serialize>(
        head: &[u8],
        unwrap: fn(Value) -> Value,
    ) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        'numbers: for number in 0..=255 {
            for zeros in 0..200 {
                let mut bytes = head.to_vec();
                bytes.push(number);
                bytes.resize(bytes.len() + zeros, 0);
                if let Some((_, message)) = decode::<T>(bytes.leak()) {
                    found.push(named(&unwrap(serde_json::to_value(&message).unwrap())));
                    continue 'numbers;
                }
            }
            break;
        }
        found
    }

    /// Name and fields of a variant, from its JSON form.
    fn named(value: &Value) -> (String, Vec<String>) {
        match value {
            Value::String(name) => (name.clone(), Vec::new()),
            Value::Object(map) => {
                let (name, content) = map.iter().next().unwrap();
                let fields = match content {
                    Value::Object(fields) => fields.keys().cloned().collect(),
                    _ => Vec::new(),
                };
                (name.clone(), fields)
            }
            other => panic!("{other}"),
        }
    }

    /// Number, name and content of each row of a section's table.
    fn rows(section: &str) -> Vec<[&'static str; 3]> {
        let (_, text) = PAGE.split_once(&format!("\n## {section}\n")).unwrap();
        let rows = text.lines().skip_while(|line| !line.starts_with("| 0 |"));
        let rows = rows.take_while(|line| line.starts_with('|'));
        rows.map(|row| match row.split('|').collect::<Vec<_>>()[..] {
            ["", number, name, content, _, ""] => [number, name, content].map(str::trim),
            _ => panic!("{row}"),
        })
        .collect()
    }

    fn assert_complete(section: &str, variants: &[(String, Vec<String>)]) {
        let rows = rows(section);
        assert_eq!(rows.len(), variants.len(), "{section}");
        for (i, ([number, name, content], (variant, fields))) in
            rows.iter().zip(variants).enumerate()
        {
            assert_eq!(*number, i.to_string(), "{section}");
            assert_eq!(*name, format!("`{variant}`"));
            // A cell that begins with a word describes a content without field names, so it is not compared.
            if content.is_empty() || content.starts_with('`') {
                let documented_fields = content
                    .split("<br>")
                    .filter_map(|field| field.split('`').nth(1));
                let mut documented: Vec<&str> = documented_fields.collect();
                let mut fields: Vec<&str> = fields.iter().map(String::as_str).collect();
                documented.sort_unstable();
                fields.sort_unstable();
                assert_eq!(documented, fields, "{name}");
            }
        }
    }

    #[test]
    fn every_variant_and_field_of_the_protocol_is_in_the_table() {
        assert_complete("Requests", &variants::<Request>(&[7], |value| value));
        // The head has frame number 7, request number 5 (Order), owner 0 and sequence 0; the order's number follows.
        let order = |value: Value| value["Order"]["order"].clone();
        assert_complete("Orders", &variants::<Request>(&[7, 5, 0, 0], order));
        let replies = variants::<Reply>(&[7], |value| value);
        assert_complete("Replies", &replies);
        assert_complete("Entries", &variants::<Entry>(&[7], |value| value));
        let refused = replies.iter().position(|(name, _)| name == "Refused");
        let head = [7, refused.unwrap() as u8];
        let inner = |value: Value| value["Refused"].clone();
        assert_complete("Reasons of a refusal", &variants::<Reply>(&head, inner));
    }

    #[test]
    fn page_has_the_numbers_of_the_protocol() {
        let (protocol, nonce) = (PROTOCOL, 300);
        let hello = encode(1, &Request::Hello { protocol, nonce }).unwrap();
        let hello: Vec<String> = hello.bytes().iter().map(|b| format!("{b:02x}")).collect();
        for text in [
            format!("Version {PROTOCOL} of"),
            format!("A payload, at most {MAX_PAYLOAD} bytes"),
            format!("A frame, at most {MAX_FRAME} bytes"),
            format!("at most {MAX_BUS_FRAMES} in a request and {MAX_SENT_FRAMES} in a reply"),
            format!("at most {CONFIG_CHUNK} bytes, points of a path {POINTS} at a time"),
            format!("number 1 and nonce 300 is `{}`", hello.join(" ")),
        ] {
            assert!(PAGE.contains(&text), "{text}");
        }
    }
}
