//! Reports to a watching host.

use super::*;
use crate::link::record::{self, Entry, MAX_ENTRY};
use crate::node::Outbox;
use crate::node::lead::LeadNode;

#[test]
fn watching_host_receives_bus_frames_and_outputs() {
    let identity = Identity {
        build: "test",
        role: Role::LEAD,
    };
    let mut board = RunLink::new(identity, &CONFIG, StackUse::unknown, crash);
    let mut sent = Vec::new();
    let lead = RobotConfig::default().completed().build_lead();
    let mut lead = LeadNode::new(lead.unwrap());
    let telemetry = Telemetry::of(4_000, lead.step(4_000, &mut Outbox::new()), &mut lead);
    assert!(board.wants_telemetry());
    let watch = protocol::encode(9, &Request::Watch).unwrap();
    let mut send = |bytes: &[u8]| sent.extend_from_slice(bytes);
    let demand = board.receive(watch.bytes(), &mut Station::default(), &mut send);
    assert_eq!(demand, Some(Demand::Watch));
    board.send_telemetry(&telemetry);
    assert!(!board.wants_telemetry());
    let (epoch, last_delay_us) = (77, None);
    let sync = Message::TimeSync {
        epoch,
        last_delay_us,
    };
    let frame = bus::encode(&sync).unwrap();
    let mut room = [0; MAX_ENTRY];
    let entry = Entry::of(&frame).encode(&mut room).unwrap();
    let count = board.room() / entry.len();
    let few = entry.repeat(count);
    let longest = [0; REPORT_ENTRIES];
    // The longest events leave no room for a part of the output; an empty report is not sent.
    for entries in [&few, &longest[..], &few, &[], &few] {
        board.report(3, entries, &mut send);
    }
    assert!(board.wants_telemetry());
    let (mut frames, mut parts, mut replies) = (0, Vec::new(), 0);
    for payload in payloads(&sent) {
        replies += 1;
        match protocol::decode::<Reply>(&payload).unwrap() {
            (9, Reply::Done) => {}
            (
                0,
                Reply::Report {
                    sequence,
                    lost: 3,
                    entries,
                    offset,
                    telemetry,
                },
            ) => {
                assert_eq!(u32::from(sequence) + 2, replies);
                assert_eq!(usize::from(offset), parts.len());
                assert_eq!(telemetry.is_empty(), entries == longest || replies == 5);
                parts.extend_from_slice(telemetry);
                let found = record::entries(entries).filter_map(|entry| entry?.frame());
                frames += found.filter(|it| *it == frame).count();
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((replies, frames), (5, 3 * count));
    let (length, bytes) = parts.split_first_chunk().unwrap();
    assert_eq!(usize::from(u16::from_le_bytes(*length)), bytes.len());
    assert_eq!(postcard::from_bytes(bytes), Ok(telemetry));
}

#[test]
fn report_holds_a_part_of_the_output_if_its_entries_leave_room() {
    let mut board = Driving::new(Role::LEAD).run_link;
    for (length, parts) in [(91, true), (92, false), (232, false)] {
        board.send_telemetry(&Telemetry::default());
        let left = board.telemetry.left();
        let part = left.min(140);
        assert_eq!(board.room(), 231 - part);
        let entries = vec![0; length + 140 - part];
        let mut sent = Vec::new();
        board.report(0, &entries[..entries.len().min(232)], &mut |bytes| {
            sent.extend_from_slice(bytes);
        });
        assert_eq!(payloads(&sent).len(), 1, "{length}");
        assert_eq!(left - board.telemetry.left(), if parts { part } else { 0 });
    }
    // Without events a report is sent only while output is left.
    for _ in 0..4 {
        let expected = usize::from(!board.wants_telemetry());
        let mut sent = Vec::new();
        board.report(0, &[], &mut |bytes| sent.extend_from_slice(bytes));
        assert_eq!(payloads(&sent).len(), expected);
    }
    assert!(board.wants_telemetry());
    assert_eq!(board.room(), 232);
}
