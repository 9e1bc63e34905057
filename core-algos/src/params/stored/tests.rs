use super::*;
use crate::topology::Topology;
use proptest::prelude::*;

fn check(settings: &Settings) -> Result<(), ConfigError> {
    Topology::PAIR
        .boards()
        .try_for_each(|role| settings.check(role))
}

/// Writes the items of a save; returns the number of parameters written.
fn save(contents: &mut Contents, settings: &Settings, base: &Settings) -> usize {
    let changes: Vec<(u8, Item)> = contents.changes(settings, base).collect();
    for (key, item) in &changes {
        contents.take(*key, &item.to_bytes());
    }
    if let Some(manifest) = contents.manifest() {
        contents.take(MANIFEST_KEY, &manifest.to_bytes());
    }
    changes.len()
}

fn with(name: &str, value: f32) -> Settings {
    let mut settings = Settings::default();
    find(name).unwrap().set(&mut settings, value).unwrap();
    settings
}

const RADIUS: &str = "robot.geometry.wheel_radius_m";

#[test]
fn saved_values_are_loaded_and_only_changes_are_written() {
    let base = Settings::default();
    let mut contents = Contents::EMPTY;
    let (_, report) = contents.resolve(&base, check);
    assert!(report.conditions().is_empty() && report.stored() == 0);
    assert_eq!(save(&mut contents, &base, &base), 0);
    assert_eq!(contents, Contents::EMPTY);
    let settings = with(RADIUS, 0.08);
    assert_eq!(save(&mut contents, &settings, &base), 1);
    assert_eq!(save(&mut contents, &settings, &base), 0);
    assert_eq!(contents.manifest(), None, "it is in the store already");
    let (loaded, report) = contents.resolve(&base, check);
    assert_eq!((loaded, report.stored()), (settings, 1));
    assert_eq!(report.conditions(), Conditions::NONE);
    // A value equal to the default is saved like any other.
    assert_eq!(save(&mut contents, &base, &base), 1);
    assert_eq!(contents.resolve(&base, check).0, base);
}

#[test]
fn lost_old_or_unusable_item_gives_default_and_notice() {
    let base = Settings::default();
    let mut contents = Contents::EMPTY;
    save(&mut contents, &with(RADIUS, 0.08), &base);
    let older = contents;
    save(&mut contents, &with(RADIUS, 0.09), &base);
    let notice = Conditions::only(Condition::ParameterDefault);
    let place = TABLE.iter().position(|p| p.name == RADIUS).unwrap();
    let check_source = |contents: &Contents, source: Source| {
        let (settings, report) = contents.resolve(&base, check);
        assert_eq!((settings, report.conditions()), (base, notice));
        assert_eq!(report.sources[place], source);
        assert_eq!(report.first().map(|p| p.name), Some(RADIUS));
    };
    let mut gone = contents;
    gone.items[place] = None;
    check_source(&gone, Source::Damaged);
    let mut stale = contents;
    stale.items[place] = older.items[place];
    check_source(&stale, Source::Damaged);
    let mut other = contents;
    other.items[place].as_mut().unwrap().version = 2;
    check_source(&other, Source::OtherVersion);
    let mut beyond = contents;
    beyond.items[place].as_mut().unwrap().value = f32::NAN;
    check_source(&beyond, Source::OutOfRange);
    // Power failure between item and manifest: the value is used, but other items may be missing.
    let mut newer = contents;
    newer.manifest = older.manifest;
    let mut unlisted = contents;
    unlisted.manifest = None;
    for contents in [newer, unlisted] {
        let (settings, report) = contents.resolve(&base, check);
        assert_eq!(report.conditions(), notice);
        assert_eq!(settings, with(RADIUS, 0.09));
    }
    // A save repairs each of these stores.
    for mut damaged in [gone, stale, other, beyond, newer, unlisted] {
        let settings = damaged.resolve(&base, check).0;
        save(&mut damaged, &settings, &base);
        let (again, report) = damaged.resolve(&base, check);
        assert_eq!((again, report.conditions()), (settings, Conditions::NONE));
    }
}

#[test]
fn values_that_contradict_each_other_are_not_used() {
    let base = Settings::default();
    let mut contents = Contents::EMPTY;
    // The value is in range, but the stop deceleration is below the acceleration.
    let name = "robot.lead.governor.stop_deceleration_m_s2";
    save(&mut contents, &with(name, 0.1), &base);
    let (settings, report) = contents.resolve(&base, check);
    assert_eq!(settings, base);
    assert_eq!(report.unusable.unwrap().field, "stop_deceleration_m_s2");
    assert!(!report.conditions().is_empty());
}

#[test]
fn item_has_9_bytes_and_low_byte_of_generation_is_never_0() {
    assert_eq!(ITEM_BYTES, 1 + 4 + 4);
    assert_eq!(following(254), 255);
    assert_eq!(following(255), 257);
    assert_eq!(following(u32::MAX), 1);
}

properties! {
    #[test]
    fn item_survives_encoding_and_any_bytes_give_valid_settings(
        version: u8, generation: u32, bits: u32, junk in prop::collection::vec(any::<u8>(), 0..120), key: u8,
    ) {
        let item = Item { version, generation, value: f32::from_bits(bits) };
        let back = Item::from_bytes(&item.to_bytes()).unwrap();
        prop_assert_eq!(back.to_bytes(), item.to_bytes());
        let mut contents = Contents::EMPTY;
        contents.take(key % 100, &junk);
        contents.take(key % 100, &item.to_bytes());
        let base = Settings::default();
        let (settings, _) = contents.resolve(&base, |_| Ok(()));
        for parameter in &TABLE {
            prop_assert!(parameter.validate(parameter.get(&settings)).is_ok());
        }
    }

    /// Copies may be found in any order.
    #[test]
    fn newest_copy_is_used(order in Just(vec![1u32, 2, 3, 4, 5]).prop_shuffle()) {
        let mut contents = Contents::EMPTY;
        for generation in order {
            let value = 0.01 * generation as f32;
            contents.take(1, &Item { version: 1, generation, value }.to_bytes());
        }
        let (settings, _) = contents.resolve(&Settings::default(), |_| Ok(()));
        prop_assert_eq!(settings.robot.geometry.wheel_radius_m, 0.01 * 5.0f32);
    }
}
