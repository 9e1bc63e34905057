//! Bus description (DBC), generated from the table of messages.

use core_algos::bus::field::POSITION_SPAN_M;
use core_algos::bus::layout::{BIT_RATE, OnBus, Signal, messages};
use core_algos::topology::{Node, Topology};

/// DBC description of all bus messages of a robot.
pub fn description(robot: Topology) -> String {
    let mut text = String::from("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_:");
    for node in nodes(robot) {
        text += &format!(" {node}");
    }
    text += "\n\n";
    for sent in messages(robot) {
        text += &message(robot, &sent);
    }
    text += &format!(
        "CM_ \"Positions of odometric and reference postures are sent modulo {POSITION_SPAN_M} m; \
         ln_sigma_* is the natural logarithm of a standard deviation.\";\n"
    );
    for OnBus { id, layout, .. } in messages(robot) {
        text += &format!("CM_ BO_ {id} \"{}\";\n", plain(layout.meaning));
    }
    for OnBus { id, layout, .. } in messages(robot) {
        for signal in layout.signals {
            let (name, meaning) = (signal.name, plain(signal.meaning));
            text += &format!("CM_ SG_ {id} {name} \"{meaning}\";\n");
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
        for sent in messages(robot) {
            text += &format!("BA_ \"{attribute}\" BO_ {} {};\n", sent.id, time(&sent));
        }
    }
    for OnBus { id, layout, .. } in messages(robot) {
        for signal in layout.signals.iter().filter(|s| !s.labels.is_empty()) {
            text += &format!("VAL_ {id} {}", signal.name);
            for (number, label) in signal.labels.iter().enumerate() {
                text += &format!(" {number} \"{label}\"");
            }
            text += " ;\n";
        }
    }
    text
}

/// Names of the nodes, the service tool last.
fn nodes(robot: Topology) -> impl Iterator<Item = &'static str> {
    let all = robot.nodes().chain([Node::Service]);
    all.map(move |node| robot.node_name(node))
}

type Time = fn(&OnBus) -> u16;

/// Attributes of a message, ms; 0 means "on request" for the cycle time and "no timeout" for the timeout.
const TIMES: [(&str, Time); 2] = [
    ("GenMsgCycleTime", |sent| sent.period_ms()),
    ("MsgTimeout", |sent| sent.timeout_ms()),
];

fn message(robot: Topology, sent: &OnBus) -> String {
    let (layout, sender) = (sent.layout, robot.node_name(sent.sender));
    let mut text = format!("BO_ {} {sent}: {} {sender}\n", sent.id, layout.bytes());
    let receivers: Vec<&str> = nodes(robot).filter(|&node| node != sender).collect();
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

/// Comment of the message table as plain text.
pub fn plain(comment: &str) -> String {
    let text = comment
        .trim()
        .replace('"', "'")
        .replace(['`', '[', ']'], "");
    // Targets of rustdoc links; plain text omits them.
    let paths = [
        ("(crate::safety::Condition)", ""),
        ("(super::layout::schema)", ""),
    ];
    paths
        .iter()
        .fold(text, |text, (path, with)| text.replace(path, with))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of the DBC text that begin with `keyword`.
    fn lines<'a>(text: &'a str, keyword: &'a str) -> impl Iterator<Item = &'a str> {
        text.lines().filter(move |line| line.starts_with(keyword))
    }

    #[test]
    fn each_message_and_signal_is_described_once() {
        let robot = Topology::PAIR;
        let text = description(robot);
        assert_eq!(lines(&text, "BO_ ").count(), messages(robot).count());
        let signals: usize = messages(robot).map(|sent| sent.layout.signals.len()).sum();
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
}
