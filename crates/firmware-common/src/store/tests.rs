use super::simulated::{Flash, Random, Torn, run};
use super::*;
use core_algos::params::{Parameter, StoreReport, TABLE, find};
use core_algos::safety::OperatingState;

/// Sectors smaller than the chip's, which fill up sooner.
type SmallFlash = Flash<4096>;

fn disarmed() -> Disarmed {
    Disarmed::by(OperatingState::Fault).unwrap()
}

fn store<const SECTOR: usize>(flash: Flash<SECTOR>) -> Store<Flash<SECTOR>> {
    let range = flash.range();
    Store::new(flash, range).unwrap()
}

/// Loads the parameters as at a start: settings and report. Checks that the flash is unchanged.
fn load<const SECTOR: usize>(flash: &Flash<SECTOR>) -> (Settings, StoreReport) {
    let mut store = store(flash.clone());
    // The values are drawn at random within their ranges and need not fit together, so the check accepts all.
    let started = run(store.load()).resolve(&Settings::default(), |_| Ok(()));
    assert_eq!(store.flash().bytes, flash.bytes);
    started
}

fn save<const SECTOR: usize>(flash: &Flash<SECTOR>, settings: &Settings) -> (Flash<SECTOR>, bool) {
    let mut store = store(flash.clone());
    let saved = run(store.save(settings, &Settings::default(), disarmed()));
    (store.into_flash(), saved.is_ok())
}

/// Saves the settings and checks that they are loaded without a notice.
fn assert_repaired<const SECTOR: usize>(flash: &Flash<SECTOR>, settings: &Settings) {
    let (repaired, saved) = save(flash, settings);
    let (found, report) = load(&repaired);
    assert!(saved && found == *settings && report.conditions().is_empty());
}

/// Sets `count` parameters to random values.
fn change(settings: &mut Settings, count: usize, random: &mut Random) {
    for _ in 0..count {
        set_to_random(&TABLE[random.below(TABLE.len())], settings, random);
    }
}

fn set_to_random(parameter: &Parameter, settings: &mut Settings, random: &mut Random) {
    let (low, high) = parameter.range;
    let value = low + (high - low) * random.below(1 << 20) as f32 / (1 << 20) as f32;
    let value = match parameter.whole {
        true => value as i32 as f32,
        false => value,
    };
    parameter.set(settings, value).unwrap();
}

#[test]
fn save_is_allowed_only_while_the_motors_are_off() {
    for state in OperatingState::ALL {
        let off = matches!(
            state,
            OperatingState::Boot | OperatingState::Idle | OperatingState::Fault
        );
        assert_eq!(Disarmed::by(state).is_some(), off);
    }
}

#[test]
fn blank_store_gives_defaults_and_a_save_writes_only_changed_values() {
    let base = Settings::default();
    let mut store = store(SmallFlash::new(2, 1));
    let (settings, report) = run(store.load()).resolve(&base, |_| Ok(()));
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
    // Words written: two items of 8 + 12 bytes each, a manifest of 8 + 200 bytes, and the sector's mark.
    assert_eq!((flash.steps, flash.erases), (5 + 5 + 52 + 1, 0));
    assert_eq!(load(&flash).0, wanted);
}

#[test]
fn store_written_with_95_identifiers_is_read_and_extended() {
    let base = Settings::default();
    let mut store = store(SmallFlash::new(2, 1));
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
    let (settings, report) = run(store.load()).resolve(&base, |_| Ok(()));
    assert_eq!((settings, report.conditions().is_empty()), (wanted, true));
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(0));
    let wanted = with(wanted, "robot.lead.fusion.mode", 0.0);
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(1));
    let (settings, report) = run(store.load()).resolve(&base, |_| Ok(()));
    assert_eq!((settings, report.conditions().is_empty()), (wanted, true));
}

/// Damage may leave an item of no bytes. The library would take the first byte of an earlier item as its key.
#[test]
fn item_without_bytes_is_skipped() {
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
    let flash = SmallFlash::new(2, 1);
    let range = flash.range();
    let mut map = map::<Nothing, _>(flash, range).unwrap();
    let empty: &[u8] = &[];
    run(map.store_item(&mut [0; BUFFER], &Nothing, &empty)).unwrap();
    let flash = map.destroy().0;
    assert!(flash.steps > 0);
    let mut store = store(flash);
    assert_eq!(run(store.load()).resolve(&base, |_| Ok(())).0, base);
    let mut wanted = base;
    let radius = find("robot.geometry.wheel_radius_m").unwrap();
    radius.set(&mut wanted, 0.0735).unwrap();
    assert_eq!(run(store.save(&wanted, &base, disarmed())), Ok(1));
    assert_eq!(run(store.load()).resolve(&base, |_| Ok(())).0, wanted);
}

#[test]
fn sectors_must_be_whole_and_at_least_two() {
    for range in [0..4096, 0..6000, 100..8192, 8192..8192] {
        assert!(Store::new(SmallFlash::new(3, 1), range).is_none());
    }
}

/// Number of values that the tests of power cuts change. With their manifest they fill most of a tiny sector.
const VALUES: usize = 8;
/// Sectors of 512 bytes, so that every second save moves on to the next sector.
type TinyFlash = Flash<512>;

/// A save: acknowledged settings, settings being written, and the flash before and after.
struct Change {
    acknowledged: Settings,
    wanted: Settings,
    before: TinyFlash,
    after: TinyFlash,
}

impl Change {
    /// Saves of one value each, until `erasing` saves have erased a sector.
    fn sequence(erasing: u32) -> Vec<Self> {
        let mut random = Random(3);
        let mut wanted = Settings::default();
        for parameter in &TABLE[..VALUES] {
            set_to_random(parameter, &mut wanted, &mut random);
        }
        let (mut flash, saved) = save(&TinyFlash::new(3, 3), &wanted);
        assert!(saved);
        let mut changes: Vec<Self> = Vec::new();
        while changes.iter().filter(|change| change.erases()).count() < erasing as usize {
            let acknowledged = wanted;
            set_to_random(&TABLE[random.below(VALUES)], &mut wanted, &mut random);
            let (after, saved) = save(&flash, &wanted);
            assert!(saved);
            changes.push(Self {
                acknowledged,
                wanted,
                before: flash,
                after: after.clone(),
            });
            flash = after;
        }
        changes
    }

    fn erases(&self) -> bool {
        self.after.erases > self.before.erases
    }

    /// The flash after a power cut at each step of the save.
    fn cuts(&self, torn: impl Fn(u64) -> Torn) -> impl Iterator<Item = TinyFlash> {
        let steps = self.before.steps..self.after.steps;
        steps.map(move |step| save_with_cut(&self.before, &self.wanted, (step, torn(step))))
    }

    /// Checks that each loaded value is the acknowledged or the new value. Adds the changed parameters to `found`:
    /// [old value, new value].
    fn assert_found(&self, flash: &TinyFlash, found: &mut [u32; 2]) {
        let (settings, _) = load(flash);
        for parameter in &TABLE {
            let [old, new, now] = [&self.acknowledged, &self.wanted, &settings]
                .map(|settings| parameter.get(settings).to_bits());
            assert!(now == old || now == new, "{}", parameter.name);
            found[usize::from(now == new)] += u32::from(old != new);
        }
    }
}

/// The flash after a save during which the power fails; power is back on.
fn save_with_cut(flash: &TinyFlash, settings: &Settings, cut: (u64, Torn)) -> TinyFlash {
    let mut failing = flash.clone();
    (failing.cut, failing.cut_in_erase) = (Some(cut), false);
    let (mut stopped, saved) = save(&failing, settings);
    stopped.cut = None;
    // The power may fail after the last value is stored.
    assert!(!saved || load(&stopped).0 == *settings);
    stopped
}

#[test]
fn power_cut_at_any_step_of_a_save_keeps_every_acknowledged_value() {
    let (mut cuts, mut cuts_in_erase, mut found) = (0, 0, [0; 2]);
    for change in Change::sequence(3) {
        for torn in Torn::ALL {
            for stopped in change.cuts(|_| torn) {
                cuts += 1;
                cuts_in_erase += u32::from(stopped.cut_in_erase);
                change.assert_found(&stopped, &mut found);
                assert_repaired(&stopped, &change.wanted);
            }
        }
    }
    println!("{cuts} cuts, {cuts_in_erase} in an erase; found as before and new: {found:?}");
    assert!(cuts > 1000 && cuts_in_erase >= 12 && found.iter().all(|&count| count > 50));
}

/// A start writes nothing, so the next save begins with the repair. The kinds of torn writes alternate.
#[test]
fn second_power_cut_at_any_step_of_the_repair_keeps_every_acknowledged_value() {
    let (mut cuts, mut cuts_in_erase, mut found) = (0, 0, [0; 2]);
    let changes = Change::sequence(1);
    let change = changes.last().unwrap();
    let torn = |step: u64| Torn::ALL[step as usize % 4];
    for stopped in change.cuts(torn) {
        let repair = Change {
            acknowledged: change.acknowledged,
            wanted: change.wanted,
            after: save(&stopped, &change.wanted).0,
            before: stopped,
        };
        for again in repair.cuts(|step| torn(step + step / 4)) {
            cuts += 1;
            cuts_in_erase += u32::from(again.cut_in_erase);
            repair.assert_found(&again, &mut found);
            assert_repaired(&again, &repair.wanted);
        }
    }
    println!("{cuts} cuts, {cuts_in_erase} in an erase; found as before and new: {found:?}");
    assert!(cuts > 5000 && cuts_in_erase > 50);
}

#[test]
fn damage_gives_defaults_with_a_notice_and_erases_nothing() {
    const ROUNDS: u32 = 1500;
    let [single, many] = [1, 60].map(|max_bytes| damage(ROUNDS, max_bytes));
    println!("{single:?} {many:?}");
    // The manifest reveals every loss due to a single fault.
    assert!(single.intact > 1000 && single.defaults > 10 && single.undetected == 0);
    // Many faults may hit both a value and the manifest of its save, and such a loss is undetected.
    assert!(many.defaults > 1000 && many.undetected * 200 <= ROUNDS);
}

/// Counts of starts with damaged bytes.
#[derive(Debug, Default)]
struct Damage {
    /// Number of starts with every value intact.
    intact: u32,
    /// Number of values replaced by their defaults, with a notice.
    defaults: usize,
    /// Number of starts with a wrong value and without a notice.
    undetected: u32,
}

/// Damages up to `max_bytes` bytes of a store in use, `rounds` times. Checks that every value stays in its range and
/// can be saved again.
fn damage(rounds: u32, max_bytes: usize) -> Damage {
    let mut counts = Damage::default();
    let (mut random, mut settings) = (Random(4), Settings::default());
    let mut flash = SmallFlash::new(3, 4);
    for round in 0..rounds {
        // Every fiftieth round saves new settings, so that the damage meets different contents of the sectors.
        if round % 50 == 0 {
            change(&mut settings, 5, &mut random);
            flash = save(&flash, &settings).0;
        }
        let mut damaged = flash.clone();
        for _ in 0..1 + random.below(max_bytes) {
            let place = random.below(damaged.bytes.len());
            // Three of four damaged bytes lie towards the front of a sector, where the items are.
            let place = match random.below(4) {
                0 => place,
                _ => place / 4096 * 4096 + place % 4096 / (1 + random.below(8)),
            };
            damaged.bytes[place] = match random.below(4) {
                0 => 0,
                1 => 0xff,
                2 => damaged.bytes[place] ^ 1 << random.below(8),
                _ => random.draw() as u8,
            };
        }
        let (found, report) = load(&damaged);
        counts.intact += u32::from(found == settings);
        counts.defaults += report.defaults();
        counts.undetected += u32::from(found != settings && report.conditions().is_empty());
        for parameter in &TABLE {
            assert!(parameter.validate(parameter.get(&found)).is_ok());
        }
        assert_repaired(&damaged, &settings);
    }
    counts
}

/// No save leaves sectors that are neither blank nor hold an item; a failed erase or another tool may.
#[test]
fn a_store_that_is_not_blank_and_has_no_item_is_reported() {
    let blank = SmallFlash::new(3, 1);
    assert!(load(&blank).1.conditions().is_empty());
    for fill in [0x00, 0x55] {
        let mut flash = blank.clone();
        flash.bytes.fill(fill);
        let (settings, report) = load(&flash);
        assert_eq!(settings, Settings::default());
        assert!(
            report.unverified && !report.conditions().is_empty(),
            "{fill:#x}"
        );
        assert_repaired(&flash, &Settings::default());
        let mut changed = Settings::default();
        change(&mut changed, 1, &mut Random(3));
        assert_repaired(&flash, &changed);
    }
}
