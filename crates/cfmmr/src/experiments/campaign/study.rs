//! File of a study, and the definition of each of its runs.

use host_sim::base::error::Error;
use host_sim::base::input;
use host_sim::base::toml_file;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect;
use host_sim::scenario::effect::Use;
use host_sim::scenario::own::Own;
use host_sim::world::effect::within as is_part;
use host_sim::world::random::{BOUND, bounded};
use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Largest number of runs of a study: run numbers stay exact in every file format.
pub const MAX_RUNS: u64 = 10_000_000;
/// Largest number of varied quantities.
pub const MAX_VARIED: usize = 16;

/// Largest number of drawn quantities for which every combination of bounds is checked.
const MAX_CORNERED: usize = 4;

/// Random stream of a study's draws, separate from the streams of sensors and starts.
const DRAWS: u128 = 1 << 100;

/// Seeded Monte Carlo study: every combination of the listed values with the same trials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Name, used in titles.
    pub name: String,
    /// Seed of all draws.
    #[serde(default = "one")]
    pub seed: u64,
    /// Trials of each combination. Trial k draws the same noise and the same values in every combination.
    pub trials: u32,
    /// Runs per file: a killed shard loses at most this many.
    #[serde(default = "fifty")]
    pub block: u32,
    /// Names of the user's parts in every run, set by the program that has these parts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub own: Vec<String>,
    /// Source of the start postures.
    #[serde(default)]
    pub starts: Starts,
    /// Varied keys.
    #[serde(default)]
    pub vary: Vec<Vary>,
    /// Scenario keys that every run changes from the defaults.
    #[serde(default)]
    pub scenario: toml::Table,
}

const fn one() -> u64 {
    1
}

const fn fifty() -> u32 {
    50
}

/// Source of the start postures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Starts {
    /// Start of the scenario's mission.
    #[default]
    Scenario,
    /// Drawn in each trial: x and y within ±2 m of the goal, any heading.
    Random,
}

/// Varied quantity; exactly one of `values`, `uniform`, `log_uniform` and `normal` is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vary {
    /// Scenario key, as in `--set`.
    pub key: String,
    /// Grid values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<toml::Value>>,
    /// Bounds of a uniform distribution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uniform: Option<[f64; 2]>,
    /// Bounds of a distribution whose logarithm is uniform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_uniform: Option<[f64; 2]>,
    /// Mean and standard deviation of a normal distribution, cut at five standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f64; 2]>,
}

/// Source of a varied quantity's values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind<'a> {
    /// Grid values.
    Values(&'a [toml::Value]),
    /// Random value, drawn in each trial.
    Drawn(Draw),
}

/// Distribution of a drawn quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Draw {
    /// Uniform between two numbers.
    Uniform([f64; 2]),
    /// Log-uniform between two positive numbers.
    LogUniform([f64; 2]),
    /// Normal: mean and standard deviation; cut at [`BOUND`] standard deviations.
    Normal([f64; 2]),
}

impl Vary {
    /// Number of grid values; 1 for a drawn quantity.
    fn count(&self) -> u64 {
        self.values.as_ref().map_or(1, |values| values.len().max(1)) as u64
    }

    /// True if every value is a number or a list of equal numbers.
    pub fn is_numeric(&self) -> bool {
        let values = self.values.as_ref();
        values.is_none_or(|values| values.iter().all(|value| number(value).is_some()))
    }

    /// Kind of the variation; an error names the key.
    pub fn kind(&self) -> Result<Kind<'_>, Error> {
        let wrong = |what: String| Err(Error::input(format!("vary {}: {what}", self.key)));
        let ordered = |name: &str, [low, high]: [f64; 2], least: f64, draw: Draw| {
            let above = if least == 0.0 { " and above 0" } else { "" };
            match low.is_finite() && high.is_finite() && low > least && low < high {
                true => Ok(Kind::Drawn(draw)),
                false => wrong(format!(
                    "{name} = [{low}, {high}]: must be two finite numbers, the first smaller{above}"
                )),
            }
        };
        match (&self.values, self.uniform, self.log_uniform, self.normal) {
            (Some(values), None, None, None) if !values.is_empty() => Ok(Kind::Values(values)),
            (Some(_), None, None, None) => {
                wrong("values = []: must have at least one value".into())
            }
            (None, Some(range), None, None) => {
                ordered("uniform", range, f64::NEG_INFINITY, Draw::Uniform(range))
            }
            (None, None, Some(range), None) => {
                ordered("log_uniform", range, 0.0, Draw::LogUniform(range))
            }
            (None, None, None, Some([mean, sigma])) => {
                match mean.is_finite() && sigma.is_finite() && sigma > 0.0 {
                    true => Ok(Kind::Drawn(Draw::Normal([mean, sigma]))),
                    false => wrong(format!(
                        "normal = [{mean}, {sigma}]: must be a finite mean and a standard deviation \
                         above 0"
                    )),
                }
            }
            _ => wrong("must have exactly one of values, uniform, log_uniform, normal".into()),
        }
    }
}

/// Number that a value states. For a list of equal numbers, for example one per wheel, it is this number; `None` for
/// any other value.
pub fn number(value: &toml::Value) -> Option<f64> {
    match value {
        toml::Value::Float(value) => Some(*value),
        toml::Value::Integer(value) => Some(*value as f64),
        toml::Value::Array(list) => {
            let first = number(list.first()?)?;
            list.iter()
                .all(|value| number(value) == Some(first))
                .then_some(first)
        }
        _ => None,
    }
}

/// Scenario of one run, and the run's varied values.
#[derive(Clone, Debug, PartialEq)]
pub struct StudyRun {
    /// Index of the combination of listed values.
    pub cell: u64,
    /// Index of the trial.
    pub trial: u32,
    /// Value of each varied quantity, in the order of the file.
    pub values: Vec<toml::Value>,
    /// Mission, robot and world, with the values of this run.
    pub scenario: Scenario,
}

impl Study {
    /// Reads a study; an error names the file and the key.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let name = path.display();
        let text = input::text(path).map_err(|error| {
            Error::input(format!(
                "{name}: {error}: must be a study in TOML (docs/campaigns.md)"
            ))
        })?;
        Self::parse(&text, &name.to_string())
    }

    /// Parses the text of a study; errors begin with `name`.
    pub fn parse(text: &str, name: &str) -> Result<Self, Error> {
        let refuse = |error: String| Error::input(format!("{name}: {error}"));
        let study: Self =
            toml::from_str(text).map_err(|error| toml_file::refusal(name, text, &error))?;
        study.check().map_err(|error| refuse(error.to_string()))?;
        Ok(study)
    }

    /// Enters the parts of the user; fails if the file names other parts.
    pub fn set_own(&mut self, own: &Own) -> Result<(), Error> {
        let names = own.names();
        if !self.own.is_empty() && self.own != names {
            return Err(Error::input(format!(
                "own = [{}]: must be [{}], the user's parts of this program",
                self.own.join(", "),
                names.join(", ")
            )));
        }
        self.own = names.into_iter().map(str::to_owned).collect();
        Ok(())
    }

    /// Checks every value and combination.
    pub fn check(&self) -> Result<(), Error> {
        let within = |field: &str, value: u64, most: u64| match (1..=most).contains(&value) {
            true => Ok(()),
            false => Err(Error::input(format!(
                "{field} = {value}: must be between 1 and {most}"
            ))),
        };
        within("trials", self.trials.into(), MAX_RUNS)?;
        within("block", self.block.into(), 100_000)?;
        if self.vary.len() > MAX_VARIED {
            let count = self.vary.len();
            let text = format!("vary: {count} quantities: must be at most {MAX_VARIED}");
            return Err(Error::input(text));
        }
        for (i, vary) in self.vary.iter().enumerate() {
            vary.kind()?;
            for other in &self.vary[..i] {
                let (key, other) = (&vary.key, &other.key);
                if key == other {
                    return Err(Error::input(format!("vary {key}: is listed twice")));
                }
                if is_part(key, other) || is_part(other, key) {
                    let text = format!(
                        "vary {key}: contains or is part of vary {other}: must be separate keys"
                    );
                    return Err(Error::input(text));
                }
            }
        }
        let cells = self.cells().unwrap_or(u64::MAX);
        let runs = cells.saturating_mul(self.trials.into());
        within("runs (combinations times trials)", runs, MAX_RUNS)?;
        self.check_cells(cells)
    }

    /// Checks that every combination is a valid scenario, and that each varied key has an effect in at least one.
    fn check_cells(&self, cells: u64) -> Result<(), Error> {
        let mut idle: Vec<Option<String>> = vec![Some(String::new()); self.vary.len()];
        for cell in 0..cells {
            self.check_bounds(cell)?;
            for (idle, here) in idle.iter_mut().zip(self.idle(cell)?) {
                *idle = idle.take().and(here);
            }
        }
        match idle.into_iter().flatten().next() {
            Some(text) => Err(Error::input(format!("vary {text}"))),
            None => Ok(()),
        }
    }

    /// Checks that a combination is a valid scenario at the bounds of its draws: at every corner for at most
    /// `MAX_CORNERED` drawn quantities, else at each bound with the other quantities as in the first trial.
    fn check_bounds(&self, cell: u64) -> Result<(), Error> {
        let first = self.values(cell, 0)?;
        let mut bounds = Vec::new();
        for (i, vary) in self.vary.iter().enumerate() {
            if let Kind::Drawn(draw) = vary.kind()? {
                bounds.push((i, draw.bounds()));
            }
        }
        let corners: Vec<Vec<(usize, f64)>> = match bounds.len() {
            0 => return Ok(()),
            count @ 1..=MAX_CORNERED => (0..1usize << count)
                .map(|corner| {
                    let numbered = bounds.iter().enumerate();
                    let side =
                        |(k, (i, bound)): (usize, &(usize, [f64; 2]))| (*i, bound[corner >> k & 1]);
                    numbered.map(side).collect()
                })
                .collect(),
            _ => {
                let each = bounds.iter();
                each.flat_map(|(i, bound)| bound.map(|value| vec![(*i, value)]))
                    .collect()
            }
        };
        for corner in corners {
            let mut values = first.clone();
            for (i, value) in &corner {
                values[*i] = toml::Value::Float(*value);
            }
            self.scenario(0, &values).map_err(|error| {
                let error = error.to_string();
                let keys = corner.iter().map(|(i, value)| (&self.vary[*i].key, value));
                // If the error is about a drawn key, it already states key and value.
                if keys
                    .clone()
                    .any(|(key, _)| error.starts_with(&format!("{key} = ")))
                {
                    return Error::input(format!("vary: draws reach {error}"));
                }
                let set = keys.map(|(key, value)| format!("{key} = {value}"));
                let set = set.collect::<Vec<_>>().join(", ");
                Error::input(format!("vary: draws reach {set}: {error}"))
            })?;
        }
        Ok(())
    }

    /// Key and reason of each varied key without effect in a combination; `None` for a key with an effect.
    pub(super) fn idle(&self, cell: u64) -> Result<Vec<Option<String>>, Error> {
        let taken: effect::Taken = match self.starts {
            Starts::Scenario => &[],
            Starts::Random => &[("mission.start", "with starts = \"random\"")],
        };
        let run = self.run(cell * u64::from(self.trials))?;
        let runs = [(&run.scenario, Use::Regulate)];
        let keys = self.vary.iter().map(|vary| &vary.key);
        Ok(keys.map(|key| effect::text(key, taken, &runs)).collect())
    }

    /// Number of combinations; `None` if it exceeds 64 bits.
    fn cells(&self) -> Option<u64> {
        let mut counts = self.vary.iter().map(Vary::count);
        counts.try_fold(1, u64::checked_mul)
    }

    /// Number of runs.
    pub fn runs(&self) -> u64 {
        self.cells().unwrap_or(0) * u64::from(self.trials)
    }

    /// Number of blocks; each block has a file.
    pub fn blocks(&self) -> u64 {
        self.runs().div_ceil(self.block.into())
    }

    /// Numbers of the runs in a block.
    pub fn block_runs(&self, block: u64) -> std::ops::Range<u64> {
        let size = u64::from(self.block);
        let start = (block * size).min(self.runs());
        start..(start + size).min(self.runs())
    }

    /// Canonical text: equal studies give equal texts.
    pub fn canonical(&self) -> Result<String, Error> {
        toml::to_string(self).map_err(|error| Error::Failure(error.to_string()))
    }

    /// Indices of combination and trial of run `index`.
    pub fn cell_and_trial(&self, index: u64) -> (u64, u32) {
        let trials = u64::from(self.trials);
        (index / trials, (index % trials) as u32)
    }

    /// Run `index`: a function of the study and the index alone.
    pub fn run(&self, index: u64) -> Result<StudyRun, Error> {
        let (cell, trial) = self.cell_and_trial(index);
        let values = self.values(cell, trial)?;
        Ok(StudyRun {
            cell,
            trial,
            scenario: self.scenario(trial, &values)?,
            values,
        })
    }

    /// Number of successive combinations with the same value of a listed quantity.
    fn stride(&self, varied: usize) -> u64 {
        self.vary.iter().skip(varied + 1).map(Vary::count).product()
    }

    /// Value of each varied quantity in trial `trial` of combination `cell`.
    pub fn values(&self, cell: u64, trial: u32) -> Result<Vec<toml::Value>, Error> {
        // Seeded by trial only: common random numbers across combinations.
        let mut random = Pcg64::new(self.seed.into(), DRAWS | u128::from(trial) << 1);
        let values = self.vary.iter().enumerate().map(|(i, vary)| {
            let value_index = cell / self.stride(i) % vary.count();
            Ok(match vary.kind()? {
                Kind::Values(list) => list[value_index as usize].clone(),
                Kind::Drawn(draw) => toml::Value::Float(draw.sample(&mut random)),
            })
        });
        values.collect()
    }

    /// Scenario of a trial with these values of the varied quantities.
    fn scenario(&self, trial: u32, values: &[toml::Value]) -> Result<Scenario, Error> {
        let changes = self.vary.iter().zip(values);
        let changes = changes.map(|(vary, value)| format!("{}={value}", vary.key));
        let changes: Vec<String> = changes.collect();
        let base = toml::to_string(&self.scenario);
        let base = base.map_err(|error| Error::Failure(error.to_string()))?;
        let mut scenario = Scenario::parse(None, &base, "scenario", &changes)?;
        if self.starts == Starts::Random {
            let [x, y, phi] = random_start(self.seed, trial.into());
            let goal = scenario.mission.goal;
            scenario.mission.start = [goal[0] + x, goal[1] + y, phi];
        }
        scenario.check()?;
        Ok(scenario)
    }
}

/// Random start `index`: uniform in ±2 m and in heading; a function of `seed` and `index` alone.
pub fn random_start(seed: u64, index: u64) -> [f64; 3] {
    let mut random = Pcg64::new(u128::from(seed), u128::from(index) << 1);
    [
        random.random_range(-2.0..2.0),
        random.random_range(-2.0..2.0),
        random.random_range(-std::f64::consts::PI..std::f64::consts::PI),
    ]
}

impl Draw {
    /// Smallest and largest value of the distribution.
    fn bounds(self) -> [f64; 2] {
        match self {
            Self::Uniform(range) | Self::LogUniform(range) => range,
            Self::Normal([mean, sigma]) => [mean - BOUND * sigma, mean + BOUND * sigma],
        }
    }

    fn sample(self, random: &mut Pcg64) -> f64 {
        let value = match self {
            Self::Uniform([low, high]) => low + (high - low) * random.random::<f64>(),
            Self::LogUniform([low, high]) => {
                let share = random.random::<f64>();
                libm::exp(libm::log(low) + (libm::log(high) - libm::log(low)) * share)
            }
            Self::Normal([mean, sigma]) => mean + bounded(random, sigma),
        };
        let [low, high] = self.bounds();
        // Rounding could take the value beyond the bounds.
        value.clamp(low, high)
    }
}
