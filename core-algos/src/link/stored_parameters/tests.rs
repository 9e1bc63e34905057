use super::*;
use crate::bus;
use crate::link::order::Order;
use crate::link::protocol::{self, Packed, Request};
use crate::link::tests::{Host, axle, echo, order, placement, start};
use crate::math::Posture;
use crate::node::lead::Task;
use crate::node::robot::RobotConfig;
use crate::params::Source;
use crate::topology::Role;

/// Index of a parameter in the table.
fn index(name: &str) -> u8 {
    TABLE.iter().position(|p| p.name == name).unwrap() as u8
}

fn set(index: u8, value: f32) -> Request<'static> {
    Request::SetParameter { index, value }
}

fn kept(value: f32, source: Source, saved: bool) -> Reply<'static> {
    Reply::Parameter {
        value,
        source,
        saved,
    }
}

#[test]
fn set_value_lasts_until_reset_and_saved_value_survives_it() {
    let radius = index("robot.geometry.wheel_radius_m");
    let get = Request::Parameter { index: radius };
    let set = |value| set(radius, value);
    let mut host = Host::new(Role::axle(1));
    host.refused(&get, Refusal::NoSession);
    host.refused(&Request::SaveParameters, Refusal::NoSession);
    host.hello();
    let summary = Reply::Parameters {
        table: fingerprint(),
        count: COUNT as u8,
        unusable: false,
    };
    host.expect(&Request::Parameters, summary);
    host.expect(&get, kept(0.073, Source::Default, true));
    host.expect(&set(0.0735), Reply::Done);
    host.expect(&get, kept(0.0735, Source::Default, false));
    // The value survives a new session, but not a reset.
    host.hello();
    host.expect(&get, kept(0.0735, Source::Default, false));
    host.reset(Role::axle(1));
    host.hello();
    host.expect(&get, kept(0.073, Source::Default, true));
    host.expect(&set(0.0735), Reply::Done);
    host.expect(&Request::SaveParameters, Reply::Saved { values: 1 });
    host.expect(&get, kept(0.0735, Source::Stored, true));
    host.expect(&Request::SaveParameters, Reply::Saved { values: 0 });
    // A repeated request is answered again and not carried out again.
    let frame = protocol::encode(host.number, &Request::SaveParameters).unwrap();
    let answer = host.send(frame.repeated());
    let reply = Reply::Saved { values: 0 };
    assert_eq!(protocol::decode(&answer), Some((host.number, reply)));
    assert_eq!(host.saves, 2);
    host.reset(Role::axle(1));
    host.hello();
    host.expect(&get, kept(0.0735, Source::Stored, true));
    // The nodes use the configuration from the host, not the kept parameters.
    let started = Host::started(Role::axle(1), &RobotConfig::default(), None);
    let hash = host.configure(&RobotConfig::default());
    host.expect(&start(hash, 0, None), Reply::Done);
    assert_eq!(host.board.board(), started.board.board());
    host.broken = true;
    host.expect(&set(0.074), Reply::Done);
    host.refused(&Request::SaveParameters, Refusal::NotSaved);
    host.expect(&get, kept(0.074, Source::Stored, false));
}

#[test]
fn value_out_of_range_or_without_valid_node_is_refused_by_name() {
    let mut host = Host::new(Role::beam(0));
    host.hello();
    let count = COUNT as u8;
    for request in [Request::Parameter { index: count }, set(255, 1.0)] {
        host.refused(&request, Refusal::Index { count });
    }
    for (i, parameter) in TABLE.iter().enumerate() {
        let value = parameter.get(&Settings::of(BoardKind::Beam));
        let (_, high) = parameter.range;
        for bad in [f32::NAN, f32::NEG_INFINITY, 1.01 * high + 1.0] {
            let index = i as u8;
            let text = &parameter.validate(bad).unwrap_err().to_string();
            assert!(text.contains(parameter.name));
            let refusal = Refusal::Parameter { text };
            host.refused(&set(index, bad), refusal);
            let get = Request::Parameter { index };
            host.expect(&get, kept(value, Source::Default, true));
        }
    }
    // 0.2 m is in range, but the first gauge would lie beyond the second, so no node can be built.
    let gauge = index("robot.beam.strip.gauges_m[0]");
    host.expect(&set(gauge, 0.2), Reply::Done);
    let payload = host.request(&Request::SaveParameters);
    let Some((_, Reply::Refused(Refusal::Parameter { text }))) = protocol::decode(&payload) else {
        panic!("saved");
    };
    assert!(text.contains("gauges_m"), "{text}");
    assert_eq!(host.saves, 0);
}

#[test]
fn parameters_are_neither_set_nor_saved_while_motors_may_be_on() {
    let set = set(0, 0.08);
    let mut host = Host::started(Role::LEAD, &RobotConfig::default(), Some(placement()));
    host.expect(&set, Reply::Done);
    let mut waiting = Vec::<bus::CanFrame>::new();
    let mut drives = false;
    for tick in 0..400u32 {
        if tick == 100 {
            let goal = Posture::ORIGIN;
            host.expect(&order(Order::Task(Task::regulate(goal))), Reply::Done);
        }
        let mut packed = Packed::new();
        for frame in &waiting {
            packed.push(frame);
        }
        let payload = host.request(&axle(tick, packed.bytes()));
        let Some((_, Reply::Axle { active, bus, .. })) = protocol::decode(&payload) else {
            panic!("tick {tick}");
        };
        drives = active;
        waiting = echo(protocol::unpack(bus));
    }
    assert!(drives, "the motors are on");
    host.refused(&set, Refusal::Armed);
    host.refused(&Request::SaveParameters, Refusal::Armed);
    assert_eq!(host.saves, 0);
    // A hello discards the nodes.
    host.hello();
    host.expect(&Request::SaveParameters, Reply::Saved { values: 1 });
    // A beam board behind a link has no motor state.
    let mut host = Host::started(Role::beam(0), &RobotConfig::default(), None);
    host.refused(&set, Refusal::Armed);
    host.hello();
    host.expect(&set, Reply::Done);
}

/// Contents of a store that holds these values.
fn contents(role: Role, values: &[(u8, f32)]) -> Contents {
    let base = Settings::of(BoardKind::of(role));
    let mut settings = base;
    for &(index, value) in values {
        parameter(index).unwrap().set(&mut settings, value).unwrap();
    }
    let mut contents = Contents::EMPTY;
    for (key, item) in contents.changes(&settings, &base).collect::<Vec<_>>() {
        contents.take(key, &item.to_bytes());
    }
    if let Some(manifest) = contents.manifest() {
        contents.take(0, &manifest.to_bytes());
    }
    contents
}

#[test]
fn source_and_saved_are_reported_for_each_value() {
    let off = Disarmed::of(None).unwrap();
    let (radius, gap) = (
        index("robot.geometry.wheel_radius_m"),
        index("button.goal.phi"),
    );
    let default = |index: u8| {
        parameter(index)
            .unwrap()
            .get(&Settings::of(BoardKind::PlacedAxle))
    };
    let (_, high) = parameter(gap).unwrap().range;
    let other = if default(gap) < high {
        high
    } else {
        parameter(gap).unwrap().range.0
    };
    let mut stored = StoredParameters::new(BoardKind::PlacedAxle);
    stored.load(&contents(Role::axle(1), &[(gap, other)]));
    let is = |stored: &StoredParameters, index, value, source, saved| {
        assert_eq!(stored.get(index), Ok(kept(value, source, saved)), "{index}");
    };
    is(&stored, radius, default(radius), Source::Default, true);
    is(&stored, gap, other, Source::Stored, true);
    assert_eq!(stored.set(radius, 0.074, off), Ok(()));
    is(&stored, radius, 0.074, Source::Default, false);
    is(&stored, gap, other, Source::Stored, true);
    // The store read back holds another radius and has lost the heading.
    stored.saved(&contents(Role::axle(1), &[(radius, 0.0735)]));
    is(&stored, radius, 0.074, Source::Stored, false);
    is(&stored, gap, other, Source::Default, false);
    let save = stored.save(off);
    assert_eq!(
        (save.settings, save.base),
        (*stored.settings(), Settings::of(BoardKind::PlacedAxle))
    );
    stored.load(&contents(Role::axle(1), &[(radius, 0.0735)]));
    is(&stored, radius, 0.0735, Source::Stored, true);
    is(&stored, gap, default(gap), Source::Default, true);
}

/// A board alone at the host gets its place: values are set one by one, so only the save checks them together.
#[test]
fn place_is_saved_if_the_robot_has_it_and_gives_the_role_after_a_reset() {
    let (axles, place) = (index("robot.geometry.axles"), index("board.place"));
    let mut host = Host::new(Role::axle(1));
    host.hello();
    for wrong in [0.0, 3.0] {
        host.expect(&set(place, wrong), Reply::Done);
        let payload = host.request(&Request::SaveParameters);
        let Some((_, Reply::Refused(Refusal::Parameter { text }))) = protocol::decode(&payload)
        else {
            panic!("saved {wrong}");
        };
        assert!(text.contains("board.place"), "{text}");
    }
    host.expect(&set(axles, 5.0), Reply::Done);
    host.expect(&Request::SaveParameters, Reply::Saved { values: 2 });
    let settings = host.board.stored().settings();
    assert_eq!(settings.role(BoardKind::PlacedAxle), Ok(Role::axle(3)));
    assert_eq!(settings.robot.topology().axle_count(), 5);
    // The store of a board with this role is read alike.
    host.reset(Role::axle(3));
    host.hello();
    host.expect(
        &Request::Parameter { index: place },
        kept(3.0, Source::Stored, true),
    );
    host.expect(&Request::SaveParameters, Reply::Saved { values: 0 });
}

#[test]
fn saved_is_compared_bit_for_bit() {
    let off = Disarmed::of(None).unwrap();
    let zero = TABLE.iter().position(|parameter| {
        let value = parameter.get(&Settings::of(BoardKind::Beam));
        value.to_bits() == 0 && parameter.validate(-0.0).is_ok()
    });
    let zero = zero.unwrap() as u8;
    let mut stored = StoredParameters::new(BoardKind::Beam);
    for (value, saved) in [(0.0, true), (-0.0, false), (0.0, true)] {
        assert_eq!(stored.set(zero, value, off), Ok(()));
        assert_eq!(stored.get(zero), Ok(kept(value, Source::Default, saved)));
    }
}

#[test]
fn store_without_valid_node_is_unusable() {
    let gauge = index("robot.beam.strip.gauges_m[0]");
    for (role, unusable) in [
        (Role::beam(0), true),
        (Role::axle(1), false),
        (Role::LEAD, false),
    ] {
        // The first gauge lies beyond the second, so no beam node can be built.
        let behind = contents(role, &[(gauge, 0.2)]);
        let mut stored = StoredParameters::new(BoardKind::of(role));
        stored.load(&behind);
        let summary = Reply::Parameters {
            table: fingerprint(),
            count: COUNT as u8,
            unusable,
        };
        assert_eq!(stored.summary(), summary, "{role:?}");
        let usable = *stored.settings() != Settings::of(BoardKind::of(role));
        assert_eq!(usable, !unusable, "{role:?}");
        let off = Disarmed::of(None).unwrap();
        assert_eq!(stored.check(), Ok(()));
        assert_eq!(stored.set(gauge, 0.2, off), Ok(()));
        assert_eq!(stored.check().is_err(), unusable, "{role:?}");
    }
}
