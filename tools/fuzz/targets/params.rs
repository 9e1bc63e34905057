//! Parameter store on a flash with random content, or with a damaged sound content.
#![no_main]

use cfmmr_fuzz::numbers::Bytes;
use core_algos::params::{Disarmed, Settings, TABLE};
use core_algos::safety::OperatingState;
use firmware_common::store::Store;
use firmware_common::store::simulated::{Flash, run};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

type Sectors = Flash<2048>;

/// Flash after several saves, and the settings of the latest save.
static SAVED: LazyLock<(Sectors, Settings)> = LazyLock::new(|| {
    let mut flash = Sectors::new(3, 1);
    let mut settings = Settings::default();
    for (i, parameter) in TABLE.iter().enumerate().take(40) {
        let (low, high) = parameter.range;
        let value = low + (high - low) * i as f32 / 64.0;
        let value = if parameter.whole {
            value as i32 as f32
        } else {
            value
        };
        parameter.set(&mut settings, value).unwrap();
        if i % 8 == 0 {
            flash = save(flash, &settings);
        }
    }
    (save(flash, &settings), settings)
});

fn save(flash: Sectors, settings: &Settings) -> Sectors {
    let range = flash.range();
    let mut store = Store::new(flash, range).unwrap();
    let off = Disarmed::by(OperatingState::Idle).unwrap();
    run(store.save(settings, &Settings::default(), off)).expect("a flash in memory can be written");
    store.into_flash()
}

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    let kind = bytes.byte();
    let (mut flash, saved) = SAVED.clone();
    if kind & 1 == 0 {
        // Sound content with random bytes at random places.
        while !bytes.is_empty() {
            let place = usize::from(u16::from_le_bytes(bytes.array())) % flash.bytes.len();
            flash.bytes[place] = bytes.byte();
        }
    } else {
        flash.bytes.fill(0xff);
        let start = usize::from(bytes.byte()) * 16 % flash.bytes.len();
        for (slot, &byte) in flash.bytes[start..].iter_mut().zip(bytes.0) {
            *slot = byte;
        }
    }
    let held = flash.bytes.clone();
    let range = flash.range();
    let mut store = Store::new(flash, range).unwrap();
    let base = Settings::default();
    let (settings, report) = run(store.load()).resolve(&base, |_| Ok(()));
    let flash = store.into_flash();
    assert!(flash.bytes == held, "loading writes nothing");
    for (parameter, source) in TABLE.iter().zip(report.sources) {
        let value = parameter.get(&settings);
        assert!(
            parameter.validate(value).is_ok(),
            "{} = {value}",
            parameter.name
        );
        assert!(
            !source.is_notice() || value == parameter.default(),
            "{}",
            parameter.name
        );
    }
    // Saving succeeds for any content.
    if kind & 2 != 0 {
        let flash = save(flash, &saved);
        let range = flash.range();
        let mut store = Store::new(flash, range).unwrap();
        let (settings, report) = run(store.load()).resolve(&base, |_| Ok(()));
        assert!(settings == saved && report.conditions().is_empty());
    }
});
