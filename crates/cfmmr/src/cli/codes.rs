//! `cfmmr codes`: the table of conditions and of operating states, as Markdown.

use core_algos::node::led;
use core_algos::safety::condition::TABLE;
use core_algos::safety::{Cause, Class, OperatingState, StateRequest, transition};
use host_sim::base::error::Error;
use output::terminal;
use std::fmt::Write;

/// The text of `docs/codes.md`.
pub fn markdown() -> String {
    let mut text = String::from(
        "# Codes and operating states\n\n\
         Printed by `cfmmr codes`. A node reports a condition as one of these codes. The class of the\n\
         code decides the reaction:\n\n\
         - **notice**: report only;\n\
         - **degraded**: drive on for a limited time and distance;\n\
         - **stop**: decelerate all axles together along their path, release the bent frame, then switch the motors off\n\
           (about 1 s);\n\
         - **cut**: switch the motors of this axle off at once; the other axle stops as above. The bridges short the\n\
           motors, which brakes the axle; after a driver fault or overcurrent the drivers sleep and it coasts.\n\n\
         An open contact of the emergency stop also switches the enable pins of its axle board off within 60 µs, without the\n\
         program. An axle with closed contact takes the 1 s of a stop.\n\n\
         A stop or cut is latched until cleared. *holds for* is the time that a condition must last.\n\n\
         *bit* is the bit of the condition in the notices of a heartbeat.\n\n\
         | code | bit | class | name | holds for | meaning | remedy |\n|---|---|---|---|---|---|---|\n",
    );
    for entry in &TABLE {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| 0x{:02x} | {} | {} | {} | {} ms | {} | {} |",
            entry.code,
            entry.condition as u8,
            Class::of(entry.code).name(),
            entry.name,
            entry.hold / 1_000,
            entry.meaning,
            entry.remedy,
        );
    }
    text += "\n## Operating states\n\n\
             Next state for each state (row) and cause (column); · means no change. A state in brackets\n\
             applies if no stop or cut is latched, the state after the bar otherwise.\n\n";
    let causes = causes();
    let names: Vec<&str> = causes.iter().map(|(name, _)| *name).collect();
    let _ = writeln!(text, "| | {} |", names.join(" | "));
    let _ = writeln!(text, "|---|{}", "---|".repeat(names.len()));
    for state in OperatingState::ALL {
        let cells = causes.iter().map(|&(_, cause)| {
            let [free, hard] = [false, true].map(|hard| transition(state, cause, hard));
            let name = |next: OperatingState| if next == state { "·" } else { next.name() };
            if free == hard {
                name(free).to_owned()
            } else {
                format!("[{}] / {}", name(free), name(hard))
            }
        });
        let cells: Vec<String> = cells.collect();
        let _ = writeln!(text, "| **{}** | {} |", state.name(), cells.join(" | "));
    }
    text += "\n## LED\n\nThe LED of a board (PC12) shows the state of the board's node; on the front board, of the axle node.\n\n\
             - *Idle*: ready. *Boot* lasts for 1 s; longer while a stop holds, whose code the LED does not show: the other axle\n  \
             board is missing (0x82), supply low (0x8a), bus off (0x84). A cut or the emergency stop shows *Fault*.\n\
             - Between two digits the LED is dark for 1 s, after the second for 2 s. 0x8a: eight blinks, a pause, ten blinks.\n\
             - The same by computer: `cfmmr drive wait 1 --json - --on serial:front=PORT` lists state and code of each node\n  \
             (`nodes`).\n\
             - To clear a fault whose cause is over: button of the front board, key C of `cfmmr drive`, or\n  \
             `cfmmr drive clear --on serial:front=PORT`.\n\n\
             | state | LED |\n|---|---|\n";
    for state in OperatingState::ALL {
        let _ = writeln!(text, "| {} | {} |", state.name(), led::Pattern(state));
    }
    text += "| – | 20 flashes a second: the crystal is missing or not of 8 MHz; the board retries every 2 s |\n";
    text
}

/// One cause of each kind, with the heading of its column in the table of transitions.
fn causes() -> Vec<(&'static str, Cause)> {
    use core_algos::safety::Condition;
    let conditions = [
        ("notice, degraded", Condition::BeamLost),
        ("emergency stop", Condition::EmergencyStop),
        ("other stop", Condition::NeighbourLost),
        ("cut", Condition::NotANumber),
    ];
    let requests = [
        ("ready", StateRequest::Ready),
        ("arm", StateRequest::Arm),
        ("start", StateRequest::Start),
        ("finish", StateRequest::Finish),
        ("disarm", StateRequest::Disarm),
        ("halted", StateRequest::Halted),
        ("clear", StateRequest::Clear),
    ];
    let conditions = conditions.map(|(name, condition)| (name, Cause::Condition(condition)));
    let requests = requests.map(|(name, request)| (name, Cause::Request(request)));
    conditions.into_iter().chain(requests).collect()
}

/// Prints `docs/codes.md`.
pub fn run() -> Result<(), Error> {
    terminal::print_page(&markdown())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::safety::Condition;

    /// A column of the table is computed from one condition; all conditions of the same kind must have its transitions.
    #[test]
    fn every_condition_has_the_transitions_of_its_column() {
        let causes = causes();
        let column = |name: &str| causes.iter().find(|(n, _)| *n == name).unwrap().1;
        for condition in Condition::ALL {
            let of_kind = match (condition.class(), condition) {
                (Class::Notice | Class::Degraded, _) => column("notice, degraded"),
                (_, Condition::EmergencyStop) => column("emergency stop"),
                (Class::Stop, _) => column("other stop"),
                (Class::Cut, _) => column("cut"),
            };
            for state in OperatingState::ALL {
                for hard in [false, true] {
                    assert_eq!(
                        transition(state, Cause::Condition(condition), hard),
                        transition(state, of_kind, hard)
                    );
                }
            }
        }
    }
}
