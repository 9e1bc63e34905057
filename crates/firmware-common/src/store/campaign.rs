//! What power cuts and damaged bytes do to the store, on a simulated flash.

use super::Store;
use super::simulated::{Flash, Random, Torn, run};
use core_algos::params::{Disarmed, Report, Settings, TABLE};
use core_algos::safety::OperatingState;

/// Sectors of the store.
const SECTORS: usize = 3;

/// Counts of a campaign of power cuts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PowerCuts {
    /// Saves without a cut.
    pub saves: u64,
    /// Sectors erased by them.
    pub erases: u64,
    /// Power cuts, each followed by a start and another save, itself cut once and repeated.
    pub cuts: u64,
    /// Of them, during an erase.
    pub erase_cuts: u64,
    /// Values being written that were there after the cut.
    pub new: u64,
    /// Values being written that were as before.
    pub old: u64,
    /// Values being written that were lost: the default, with a notice.
    pub lost: u64,
    /// Other values that were not as before.
    pub others_lost: u64,
    /// Saves after a cut that failed.
    pub failed: u64,
    /// Starts that wrote or erased.
    pub changed_by_loading: u64,
}

/// Counts of a campaign of damaged bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Flashes damaged.
    pub rounds: u64,
    /// Of them, those with every value intact.
    pub intact: u64,
    /// Values that had their default instead, with a notice.
    pub defaults: u64,
    /// Starts with a value that was not the one saved, and no notice.
    pub silent: u64,
    /// Values out of range after a start.
    pub out_of_range: u64,
    /// Starts that wrote or erased.
    pub changed_by_loading: u64,
    /// Saves afterwards that failed, or after which a value was not there.
    pub not_repaired: u64,
}

fn disarmed() -> Disarmed {
    Disarmed::by(OperatingState::Idle).expect("an idle node gives no torque")
}

fn load<const N: usize>(flash: Flash<N>) -> (Flash<N>, Settings, Report) {
    let range = flash.range();
    let mut store = Store::new(flash, range).expect("whole sectors");
    let contents = *run(store.load());
    // Values are drawn at random within their ranges: together they make no node.
    let (settings, report) = contents.settle(&Settings::default(), |_| Ok(()));
    (store.into_flash(), settings, report)
}

fn save<const N: usize>(flash: Flash<N>, settings: &Settings) -> (Flash<N>, bool) {
    let range = flash.range();
    let mut store = Store::new(flash, range).expect("whole sectors");
    let saved = run(store.save(settings, &Settings::default(), disarmed()));
    (store.into_flash(), saved.is_ok())
}

/// Gives `count` parameters other values.
fn change(settings: &mut Settings, count: usize, random: &mut Random) {
    for _ in 0..count {
        let parameter = &TABLE[random.below(TABLE.len())];
        let (low, high) = parameter.range;
        let value = low + (high - low) * random.below(1 << 20) as f32 / (1 << 20) as f32;
        let value = if parameter.whole {
            value as i32 as f32
        } else {
            value
        };
        parameter.set(settings, value).expect("within the range");
    }
}

/// Cuts the power at every `stride`-th step of each of `saves` saves, in every way a step can end.
/// Saves that erase a sector are cut at every step.
pub fn power_cuts<const N: usize>(saves: u64, stride: usize, seed: u64) -> PowerCuts {
    let mut campaign = Campaign::<N>::new(seed);
    for _ in 0..saves {
        let save = campaign.next();
        let stride = if save.erases() { 1 } else { stride };
        campaign.cut(&save, stride);
    }
    campaign.counts
}

/// Saves until `compactions` of the saves have erased a sector, and cuts those at every step, in every
/// way a step can end.
pub fn compactions<const N: usize>(compactions: u64, seed: u64) -> PowerCuts {
    let mut campaign = Campaign::<N>::new(seed);
    let mut done = 0;
    while done < compactions {
        let save = campaign.next();
        if save.erases() {
            done += 1;
            campaign.cut(&save, 1);
        }
    }
    campaign.counts
}

/// A store that is saved to again and again.
struct Campaign<const N: usize> {
    counts: PowerCuts,
    random: Random,
    settings: Settings,
    flash: Flash<N>,
}

/// A save without a cut.
struct Save<const N: usize> {
    before: (Flash<N>, Settings),
    after: (Flash<N>, Settings),
}

impl<const N: usize> Save<N> {
    fn erases(&self) -> bool {
        self.after.0.erases > self.before.0.erases
    }
}

impl<const N: usize> Campaign<N> {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut settings = Settings::default();
        change(&mut settings, 30, &mut random);
        Self {
            counts: PowerCuts::default(),
            flash: save(Flash::new(SECTORS, seed), &settings).0,
            random,
            settings,
        }
    }

    /// The next save, of one to three changed values.
    fn next(&mut self) -> Save<N> {
        let before = (self.flash.clone(), self.settings);
        let many = 1 + self.random.below(3);
        change(&mut self.settings, many, &mut self.random);
        let (after, saved) = save(self.flash.clone(), &self.settings);
        self.counts.saves += 1;
        self.counts.failed += u64::from(!saved);
        self.counts.erases += after.erases - self.flash.erases;
        self.flash = after.clone();
        Save {
            before,
            after: (after, self.settings),
        }
    }

    /// Does a save anew with the power cut at every `stride`-th of its steps.
    fn cut(&mut self, done: &Save<N>, stride: usize) {
        let (flash, before) = &done.before;
        let (after, wanted) = &done.after;
        let (counts, random) = (&mut self.counts, &mut self.random);
        for step in (flash.steps..after.steps).step_by(stride) {
            for torn in Torn::ALL {
                let mut failing = flash.clone();
                failing.cut = Some((step, torn));
                failing.cut_in_erase = false;
                let (mut stopped, _) = save(failing, wanted);
                counts.cuts += 1;
                counts.erase_cuts += u64::from(stopped.cut_in_erase);
                stopped.cut = None;
                let restarted = judge(stopped, before, wanted, counts);
                // Once more, and the power fails again somewhere in the repair.
                let mut again = restarted.clone();
                again.cut = Some((
                    again.steps + random.below(40) as u64,
                    Torn::ALL[random.below(4)],
                ));
                let (mut again, _) = save(again, wanted);
                again.cut = None;
                let again = judge(again, before, wanted, counts);
                for repaired in [restarted, again] {
                    let (repaired, saved) = save(repaired, wanted);
                    let (_, found, report) = load(repaired);
                    let good = saved && found == *wanted && report.conditions().is_empty();
                    counts.failed += u64::from(!good);
                }
            }
        }
    }
}

/// Starts after a cut and compares what is found with what was there before and what was to be.
fn judge<const N: usize>(
    flash: Flash<N>,
    before: &Settings,
    wanted: &Settings,
    counts: &mut PowerCuts,
) -> Flash<N> {
    let held = flash.bytes.clone();
    let (flash, found, report) = load(flash);
    counts.changed_by_loading += u64::from(flash.bytes != held);
    for (parameter, source) in TABLE.iter().zip(report.sources) {
        let [old, new, now] = [before, wanted, &found].map(|s| parameter.get(s).to_bits());
        if old == new {
            counts.others_lost += u64::from(now != old);
        } else if now == new {
            counts.new += 1;
        } else if now == old {
            counts.old += 1;
        } else if source.is_notice() {
            counts.lost += 1;
        } else {
            counts.others_lost += 1;
        }
    }
    flash
}

/// Damages up to `most` bytes of a store in use, `rounds` times; 1 is a single fault, of which the
/// manifest tells every loss.
pub fn damage<const N: usize>(rounds: u64, most: usize, seed: u64) -> Damage {
    let mut counts = Damage::default();
    let mut random = Random(seed);
    let mut settings = Settings::default();
    let mut flash = Flash::<N>::new(SECTORS, seed);
    for round in 0..rounds {
        // Another state of the sectors now and then.
        if round % 50 == 0 {
            change(&mut settings, 5, &mut random);
            flash = save(flash, &settings).0;
        }
        let mut damaged = flash.clone();
        for _ in 0..1 + random.below(most) {
            let place = random.below(damaged.bytes.len());
            // Mostly where something is written, which is toward the front of a sector.
            let place = match random.below(4) {
                0 => place,
                _ => place / N * N + place % N / (1 + random.below(8)),
            };
            damaged.bytes[place] = match random.below(4) {
                0 => 0,
                1 => 0xff,
                2 => damaged.bytes[place] ^ 1 << random.below(8),
                _ => random.draw() as u8,
            };
        }
        let held = damaged.bytes.clone();
        let (damaged, found, report) = load(damaged);
        counts.rounds += 1;
        counts.changed_by_loading += u64::from(damaged.bytes != held);
        counts.intact += u64::from(found == settings);
        counts.defaults += report.defaults() as u64;
        counts.silent += u64::from(found != settings && report.conditions().is_empty());
        for parameter in &TABLE {
            let valid = parameter.validate(parameter.get(&found)).is_ok();
            counts.out_of_range += u64::from(!valid);
        }
        let (repaired, saved) = save(damaged, &settings);
        let (_, again, report) = load(repaired);
        let good = saved && again == settings && report.conditions().is_empty();
        counts.not_repaired += u64::from(!good);
    }
    counts
}
