use super::campaign::{self, PowerCuts};
use super::simulated::{Flash, run};
use super::*;
use core_algos::params::find;
use core_algos::safety::OperatingState;

fn disarmed() -> Disarmed {
    Disarmed::by(OperatingState::Fault).unwrap()
}

#[test]
fn nothing_is_written_unless_the_motors_are_off() {
    for state in OperatingState::ALL {
        let off = matches!(
            state,
            OperatingState::Boot | OperatingState::Idle | OperatingState::Fault
        );
        assert_eq!(Disarmed::by(state).is_some(), off);
    }
}

#[test]
fn a_blank_store_gives_the_defaults_and_a_save_writes_only_what_differs() {
    let base = Settings::default();
    let flash = Flash::<4096>::new(2, 1);
    let range = flash.range();
    let mut store = Store::new(flash, range).unwrap();
    let (settings, report) = run(store.load()).settle(&base, |_| Ok(()));
    assert_eq!((settings, report.conditions().is_empty()), (base, true));
    assert_eq!(run(store.save(&base, &base, disarmed())), Ok(0));
    let mut wanted = base;
    for (name, value) in [
        ("robot.geometry.wheel_radius_m", 0.0735),
        ("robot.beam.calibration.zero_counts[2]", 196_000.0),
    ] {
        find(name).unwrap().set(&mut wanted, value).unwrap();
    }
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(2));
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(0));
    let flash = store.into_flash();
    // Two items of 8 and 12 bytes, a manifest of 8 and 200, and the mark of the sector.
    assert_eq!((flash.steps, flash.erases), (5 + 5 + 52 + 1, 0));
    let range = flash.range();
    let mut store = Store::new(flash, range).unwrap();
    assert_eq!(run(store.load()).settle(&base, |_| Ok(())).0, wanted);
}

#[test]
fn a_store_of_an_image_with_95_identifiers_is_read_and_written_on() {
    let base = Settings::default();
    let flash = Flash::<4096>::new(2, 1);
    let range = flash.range();
    let mut store = Store::new(flash, range).unwrap();
    let with = |settings: Settings, name: &str, value| {
        let mut settings = settings;
        find(name).unwrap().set(&mut settings, value).unwrap();
        settings
    };
    let wanted = with(base, "robot.geometry.wheel_radius_m", 0.0735);
    let mut contents = Contents::EMPTY;
    for (key, item) in Contents::EMPTY.changes(&wanted, &base) {
        run(store.append(key, &item.to_bytes())).unwrap();
        contents.take(key, &item.to_bytes());
    }
    let manifest = contents.manifest().unwrap().to_bytes();
    run(store.append(MANIFEST_KEY, &manifest[..5 + 95])).unwrap();
    let (settings, report) = run(store.load()).settle(&base, |_| Ok(()));
    assert_eq!((settings, report.conditions().is_empty()), (wanted, true));
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(0));
    let wanted = with(wanted, "robot.lead.fusion.mode", 0.0);
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(1));
    let (settings, report) = run(store.load()).settle(&base, |_| Ok(()));
    assert_eq!((settings, report.conditions().is_empty()), (wanted, true));
}

/// Damage may leave one; the library takes the first byte of what it read before for its key.
#[test]
fn an_item_without_bytes_is_passed_over() {
    #[derive(Clone, Debug, PartialEq, Eq)]
    struct Nothing;
    impl Key for Nothing {
        fn serialize_into(&self, _buffer: &mut [u8]) -> Result<usize, SerializationError> {
            Ok(0)
        }
        fn deserialize_from(_buffer: &[u8]) -> Result<(Self, usize), SerializationError> {
            Ok((Self, 0))
        }
    }
    let base = Settings::default();
    let flash = Flash::<4096>::new(2, 1);
    let range = flash.range();
    let mut map = map::<Nothing, _>(flash, range.clone()).unwrap();
    let empty: &[u8] = &[];
    run(map.store_item(&mut [0; BUFFER], &Nothing, &empty)).unwrap();
    let flash = map.destroy().0;
    assert!(flash.steps > 0);
    let mut store = Store::new(flash, range).unwrap();
    assert_eq!(run(store.load()).settle(&base, |_| Ok(())).0, base);
    let mut wanted = base;
    let radius = find("robot.geometry.wheel_radius_m").unwrap();
    radius.set(&mut wanted, 0.0735).unwrap();
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(1));
    assert_eq!(run(store.load()).settle(&base, |_| Ok(())).0, wanted);
}

#[test]
fn sectors_must_be_whole_and_at_least_two() {
    for range in [0..4096, 0..6000, 100..8192, 8192..8192] {
        assert!(Store::new(Flash::<4096>::new(3, 1), range).is_none());
    }
}

#[test]
fn a_power_cut_loses_at_most_the_value_being_written() {
    let counts = campaign::power_cuts::<4096>(110, 11, 3);
    println!("{counts:?}");
    let PowerCuts {
        erases,
        cuts,
        erase_cuts,
        new,
        old,
        ..
    } = counts;
    // The campaign is about something: sectors were erased, and cuts came before and after a value.
    assert!(erases >= 2 && cuts > 1000 && erase_cuts >= 8 && new > 100 && old > 100);
    assert_eq!((counts.lost, counts.others_lost), (0, 0));
    assert_eq!((counts.failed, counts.changed_by_loading), (0, 0));
}

#[test]
fn a_power_cut_while_a_sector_is_erased_loses_no_more() {
    let counts = campaign::compactions::<4096>(3, 5);
    println!("{counts:?}");
    assert!(counts.erases >= 3 && counts.erase_cuts >= 12 && counts.cuts > 1000);
    assert_eq!((counts.lost, counts.others_lost), (0, 0));
    assert_eq!((counts.failed, counts.changed_by_loading), (0, 0));
}

#[test]
fn damage_gives_defaults_with_a_notice_and_erases_nothing() {
    let [single, many] = [(1500, 1), (1500, 60)].map(|(rounds, most)| {
        let counts = campaign::damage::<4096>(rounds, most, 4);
        println!("{counts:?}");
        assert_eq!((counts.changed_by_loading, counts.out_of_range), (0, 0));
        assert_eq!(counts.not_repaired, 0);
        counts
    });
    assert!(single.intact > 1000 && single.defaults > 10);
    assert_eq!(single.silent, 0);
    // Of many faults, some may hit a value and the manifest of the same save, and nothing else.
    assert!(many.defaults > 1000 && many.silent * 200 <= many.rounds);
}
