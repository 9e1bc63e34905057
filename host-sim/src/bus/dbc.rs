//! The bus description (DBC) and the load of the bus, from the one table of messages.

use crate::base::table::Table;
use core_algos::bus::field::POSITION_SPAN_M;
use core_algos::bus::layout::{self, BIT_RATE, Layout, MESSAGES, Signal};
use core_algos::topology::Node;
use std::fmt::Write;

/// The bus description of all messages, as text.
pub fn description() -> String {
    let mut text = String::from("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_:");
    for node in Node::ALL {
        text += &format!(" {}", node.name());
    }
    text += "\n\n";
    for layout in &MESSAGES {
        text += &message(layout);
    }
    text += &format!(
        "CM_ \"Positions of odometric and reference postures are sent modulo {POSITION_SPAN_M} m; \
         ln_sigma_* is the natural logarithm of a standard deviation.\";\n"
    );
    for Layout { id, meaning, .. } in &MESSAGES {
        text += &format!("CM_ BO_ {id} \"{}\";\n", plain(meaning));
    }
    for layout in &MESSAGES {
        for signal in layout.signals {
            let (name, meaning) = (signal.name, plain(signal.meaning));
            text += &format!("CM_ SG_ {} {name} \"{meaning}\";\n", layout.id);
        }
    }
    text += "BA_DEF_ \"Baudrate\" INT 1 1000000;\n";
    for (attribute, _) in TIMES {
        text += &format!("BA_DEF_ BO_ \"{attribute}\" INT 0 65535;\n");
    }
    text += "BA_DEF_DEF_ \"Baudrate\" 1000000;\n";
    for (attribute, _) in TIMES {
        text += &format!("BA_DEF_DEF_ \"{attribute}\" 0;\n");
    }
    text += &format!("BA_ \"Baudrate\" {BIT_RATE};\n");
    for (attribute, time) in TIMES {
        for layout in &MESSAGES {
            text += &format!("BA_ \"{attribute}\" BO_ {} {};\n", layout.id, time(layout));
        }
    }
    for layout in &MESSAGES {
        for signal in layout.signals.iter().filter(|s| !s.labels.is_empty()) {
            text += &format!("VAL_ {} {}", layout.id, signal.name);
            for (number, label) in signal.labels.iter().enumerate() {
                text += &format!(" {number} \"{label}\"");
            }
            text += " ;\n";
        }
    }
    text
}

type Time = fn(&Layout) -> u16;

/// Attributes of a message, ms; 0 means "on request" and "does not age".
const TIMES: [(&str, Time); 2] = [
    ("GenMsgCycleTime", |layout| layout.period_ms),
    ("MsgTimeout", |layout| layout.timeout_ms),
];

fn message(layout: &Layout) -> String {
    let mut text = format!(
        "BO_ {} {}: {} {}\n",
        layout.id,
        layout.name,
        layout.bytes(),
        layout.sender.name()
    );
    let receivers: Vec<&str> = Node::ALL
        .into_iter()
        .filter(|&node| node != layout.sender)
        .map(Node::name)
        .collect();
    let mut start = 0;
    for signal in layout.signals {
        text += &self::signal(signal, start, &receivers.join(","));
        start += u32::from(signal.bits);
    }
    text.push('\n');
    text
}

fn signal(signal: &Signal, start: u32, receivers: &str) -> String {
    let sign = if signal.signed { '-' } else { '+' };
    let (low, high) = signal.range();
    format!(
        " SG_ {} : {start}|{}@1{sign} ({},{}) [{low}|{high}] \"{}\" {receivers}\n",
        signal.name, signal.bits, signal.scale, signal.offset, signal.unit,
    )
}

/// A comment of the table as plain text.
fn plain(comment: &str) -> String {
    let text = comment
        .trim()
        .replace('"', "'")
        .replace(['`', '[', ']'], "");
    // Paths of links are for rustdoc.
    let paths = [
        ("(crate::safety::Condition)", ""),
        ("(super::layout::schema)", ""),
    ];
    paths
        .iter()
        .fold(text, |text, (path, with)| text.replace(path, with))
}

/// The messages as a table in Markdown.
pub fn page() -> String {
    let mut text = String::from(
        "| id | message | from | every (ms) | counts for (ms) | meaning |\n|---|---|---|---|---|---|\n",
    );
    let time = |ms: u16| {
        if ms == 0 {
            String::new()
        } else {
            ms.to_string()
        }
    };
    for layout in &MESSAGES {
        text += &format!(
            "| {:#05x} | `{}` | {} | {} | {} | {} |\n",
            layout.id,
            layout.name,
            layout.sender.name(),
            time(layout.period_ms),
            time(layout.timeout_ms),
            plain(layout.meaning),
        );
    }
    text
}

/// The load of the bus, message by message, as text.
pub fn load() -> String {
    let mut table = Table::new(["id", "message", "sender", "bytes", "bits", "period", "load"]);
    let rate = BIT_RATE as f32;
    for layout in &MESSAGES {
        let (period, share) = if layout.period_ms == 0 {
            (String::from("on request"), String::new())
        } else {
            (
                format!("{} ms", layout.period_ms),
                format!("{:.2} %", 100.0 * layout.bits_per_second() / rate),
            )
        };
        table.row([
            format!("{:#05x}", layout.id),
            layout.name.into(),
            layout.sender.name().into(),
            layout.bytes().to_string(),
            layout::frame_bits(layout.bytes()).to_string(),
            period,
            share,
        ]);
    }
    let mut text = table.to_string();
    let _ = writeln!(
        text,
        "\nWorst-case load with stuff bits at {} kbit/s: {:.1} %",
        BIT_RATE / 1000,
        100.0 * layout::load(rate)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of this text that begin with `keyword`.
    fn lines<'a>(text: &'a str, keyword: &'a str) -> impl Iterator<Item = &'a str> {
        text.lines().filter(move |line| line.starts_with(keyword))
    }

    #[test]
    fn each_message_and_signal_stands_once() {
        let text = description();
        assert_eq!(lines(&text, "BO_ ").count(), MESSAGES.len());
        let signals: usize = MESSAGES.iter().map(|layout| layout.signals.len()).sum();
        assert_eq!(lines(&text, " SG_ ").count(), signals);
        assert!(text.contains(
            "BO_ 544 BeamWrench: 8 Beam\n \
             SG_ sequence : 0|8@1+ (1,0) [0|255] \"\" Lead,FrontAxle,RearAxle,Service\n \
             SG_ force_x : 8|14@1- (0.05,0) [-409.6|409.55002] \"N\" \
             Lead,FrontAxle,RearAxle,Service\n"
        ));
        assert!(text.contains("BA_ \"GenMsgCycleTime\" BO_ 768 100;\n"));
        assert!(text.contains("VAL_ 112 mode 0 \"idle\" 1 \"active\" 2 \"hold\" 3 \"clear\" ;\n"));
    }

    #[test]
    fn load_sums_the_table() {
        let text = load();
        let shares = text.lines().filter_map(|line| {
            let share = line.strip_suffix(" %")?.split_whitespace().last()?;
            (!line.starts_with("Worst")).then(|| share.parse::<f64>().ok())?
        });
        let sum: f64 = shares.sum();
        let total = text.trim_end().strip_suffix(" %").unwrap();
        let total: f64 = total.rsplit(' ').next().unwrap().parse().unwrap();
        assert!((sum - total).abs() < 0.15, "{sum} {total}");
    }
}
