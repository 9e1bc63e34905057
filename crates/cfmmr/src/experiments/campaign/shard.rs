//! Shard: part of a campaign that one process computes.

use host_sim::base::error::Error;
use std::ffi::OsString;

/// Shard `index` of `count` shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, from 0.
    pub index: u64,
    /// Number of shards of the campaign.
    pub count: u64,
}

/// Maximum number of shards.
const MAX_SHARDS: u64 = 1_000_000;

impl Shard {
    /// The only shard of a campaign that is not divided.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    fn new(name: &str, index: u64, count: u64) -> Result<Self, Error> {
        match (1..=MAX_SHARDS).contains(&count) && index < count {
            true => Ok(Self { index, count }),
            false => Err(Error::input(format!(
                "{name}: part {index} of {count}: must be I/N with I from 0 to N − 1 and N from 1 to {MAX_SHARDS}"
            ))),
        }
    }

    /// Reads `I/N`.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let name = format!("--shard {text}");
        let read = text.split_once('/').and_then(|(index, count)| {
            Some((index.trim().parse().ok()?, count.trim().parse().ok()?))
        });
        match read {
            Some((index, count)) => Self::new(&name, index, count),
            None => Err(Error::input(format!(
                "{name}: must be I/N, for example 0/4 for the first of four"
            ))),
        }
    }

    /// Shard given by the scheduler: by the task of a Slurm array, or by the index of a Kubernetes job together with
    /// `CFMMR_SHARDS`; [`Self::WHOLE`] if no variable is set. An incomplete or contradictory environment is refused.
    /// `variable` reads the environment.
    pub fn from_environment(variable: impl Fn(&str) -> Option<OsString>) -> Result<Self, Error> {
        let read = |name: &str| {
            let text = variable(name).map(|text| text.to_string_lossy().into_owned());
            text.map(|text| number(name, &text)).transpose()
        };
        match (slurm(&read)?, kubernetes(&read)?) {
            (Some(slurm), Some(kubernetes)) if slurm != kubernetes => Err(Error::input(format!(
                "JOB_COMPLETION_INDEX={} with CFMMR_SHARDS={} contradicts Slurm's part {} of {}: unset the variables \
                 of one, or {ADVICE}",
                kubernetes.index, kubernetes.count, slurm.index, slurm.count
            ))),
            (slurm, kubernetes) => Ok(slurm.or(kubernetes).unwrap_or(Self::WHOLE)),
        }
    }

    /// True if this shard computes the block.
    pub fn has(self, block: u64) -> bool {
        block % self.count == self.index
    }
}

/// Reads an environment variable as a number; `None` if it is not set.
type Read<'a> = &'a dyn Fn(&str) -> Result<Option<u64>, Error>;

/// Remedy in errors of the environment.
const ADVICE: &str = "give --shard I/N, which has precedence";

fn number(name: &str, text: &str) -> Result<u64, Error> {
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    let number = text.parse().ok().filter(|_| digits);
    number.ok_or_else(|| {
        Error::input(format!(
            "{name}={text}: must be a whole number of at least 0; {ADVICE}"
        ))
    })
}

/// Values of the environment variables `names`. `None` if neither `names` nor `optional` are set. Fails if a variable
/// is set, but not all of `names`.
fn together<const N: usize>(
    read: Read<'_>,
    names: [&str; N],
    optional: &str,
) -> Result<Option<[u64; N]>, Error> {
    let mut values = [0; N];
    let mut set = None;
    let mut missing = None;
    for (name, slot) in names.iter().zip(&mut values) {
        match read(name)? {
            Some(value) => (*slot, set) = (value, set.or(Some((*name, value)))),
            None => missing = missing.or(Some(*name)),
        }
    }
    let set = set.or(read(optional)?.map(|value| (optional, value)));
    match (set, missing) {
        (None, _) => Ok(None),
        (Some(_), None) => Ok(Some(values)),
        (Some((name, value)), Some(missing)) => Err(Error::input(format!(
            "{missing} is missing beside {name}={value}: must be set too; or {ADVICE}"
        ))),
    }
}

/// Refuses a value outside of a range.
fn within(name: &str, value: u64, low: u64, high: u64, range: &str) -> Result<(), Error> {
    match (low..=high).contains(&value) {
        true => Ok(()),
        false => Err(Error::input(format!(
            "{name}={value}: must be {range}; or {ADVICE}"
        ))),
    }
}

/// Shard of a task of a Slurm array; `None` outside Slurm arrays.
fn slurm(read: Read<'_>) -> Result<Option<Shard>, Error> {
    const MAX: &str = "SLURM_ARRAY_TASK_MAX";
    let names = [
        "SLURM_ARRAY_TASK_ID",
        "SLURM_ARRAY_TASK_COUNT",
        "SLURM_ARRAY_TASK_MIN",
        "SLURM_ARRAY_TASK_STEP",
    ];
    let Some([task, count, min, step]) = together(read, names, MAX)? else {
        return Ok(None);
    };
    within(
        names[1],
        count,
        1,
        MAX_SHARDS,
        &format!("from 1 to {MAX_SHARDS}"),
    )?;
    within(names[3], step, 1, u64::MAX, "at least 1")?;
    let max = step
        .checked_mul(count - 1)
        .and_then(|span| min.checked_add(span));
    let Some(max) = max else {
        return Err(Error::input(format!(
            "{}={step}: too large with {}={count} and {}={min}; or {ADVICE}",
            names[3], names[1], names[2]
        )));
    };
    // An array such as 0,1,5 has tasks at unequal steps and is refused.
    let array = format!("{min} to {max} in steps of {step}");
    if let Some(given) = read(MAX)? {
        within(
            MAX,
            given,
            min,
            u64::MAX,
            &format!("at least {}={min}", names[2]),
        )?;
        let range = format!(
            "{max}, as {}={count} tasks from {}={min} in steps of {}={step} end there; submit an array without \
             gaps, as --array=0-{}",
            names[1],
            names[2],
            names[3],
            count - 1
        );
        within(MAX, given, max, max, &range)?;
    }
    within(names[0], task, min, max, &format!("from {array}"))?;
    if (task - min) % step != 0 {
        return Err(Error::input(format!(
            "{}={task}: must be from {array}; or {ADVICE}",
            names[0]
        )));
    }
    Shard::new(names[0], (task - min) / step, count).map(Some)
}

/// Shard of a pod of an indexed Kubernetes job; `None` outside such jobs.
fn kubernetes(read: Read<'_>) -> Result<Option<Shard>, Error> {
    let names = ["JOB_COMPLETION_INDEX", "CFMMR_SHARDS"];
    let Some([index, count]) = together(read, names, names[1])? else {
        return Ok(None);
    };
    within(
        names[1],
        count,
        1,
        MAX_SHARDS,
        &format!("from 1 to {MAX_SHARDS}"),
    )?;
    let last = count - 1;
    within(
        names[0],
        index,
        0,
        last,
        &format!("from 0 to {last}, as {}={count}", names[1]),
    )?;
    Shard::new(names[0], index, count).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shard from an environment such as `id=7 count=5`. `id` is `SLURM_ARRAY_TASK_ID`, likewise other variables of
    /// Slurm; `index` and `shards` are the variables for Kubernetes; `_` in a value is a space.
    fn shard(text: &str) -> Result<Shard, Error> {
        Shard::from_environment(|asked| {
            let pairs = text
                .split_whitespace()
                .filter_map(|pair| pair.split_once('='));
            let value = |(name, value): (&str, &str)| {
                let name = match name {
                    "index" => "JOB_COMPLETION_INDEX".to_owned(),
                    "shards" => "CFMMR_SHARDS".to_owned(),
                    name => format!("SLURM_ARRAY_TASK_{}", name.to_uppercase()),
                };
                (name == asked).then(|| value.replace('_', " ").into())
            };
            pairs.filter_map(value).next()
        })
    }

    #[test]
    fn every_block_belongs_to_one_part() {
        for count in 1..9 {
            for block in 0..40 {
                let owners = (0..count).filter(|&index| Shard { index, count }.has(block));
                assert_eq!(owners.count(), 1);
            }
        }
    }

    #[test]
    fn environment_of_a_scheduler_gives_its_part() {
        for (text, index, count) in [
            ("", 0, 1),
            ("id=0 count=1 min=0 step=1 max=0", 0, 1),
            ("id=15 count=16 min=0 step=1 max=15", 15, 16),
            // Slurm 22.05, --array=1-7:3
            ("id=4 count=3 min=1 step=3 max=7", 1, 3),
            ("id=7 count=5 min=1 step=2", 3, 5),
            ("index=2 shards=3", 2, 3),
            ("id=2 count=3 min=0 step=1 max=2 index=2 shards=3", 2, 3),
        ] {
            assert_eq!(shard(text).unwrap(), Shard { index, count }, "{text}");
        }
    }

    #[test]
    fn every_task_of_an_array_has_its_own_part() {
        for (min, step, count) in [(0, 1, 6), (3, 1, 6), (2, 5, 6)] {
            let part = |n| {
                let (id, max) = (min + n * step, min + (count - 1) * step);
                let text = format!("id={id} count={count} min={min} step={step} max={max}");
                shard(&text).unwrap().index
            };
            assert!((0..count).map(part).eq(0..count));
        }
    }

    #[test]
    #[expect(clippy::too_many_lines, reason = "a table")]
    fn incomplete_or_contradictory_environment_is_refused_by_name_and_value() {
        let full = "id=1 count=4 min=0 step=1 max=3";
        for (change, to, named) in [
            // One variable of Slurm is missing, empty or malformed.
            (
                "id=1",
                "",
                "SLURM_ARRAY_TASK_ID is missing beside SLURM_ARRAY_TASK_COUNT=4",
            ),
            (
                "count=4",
                "",
                "SLURM_ARRAY_TASK_COUNT is missing beside SLURM_ARRAY_TASK_ID=1",
            ),
            (
                "min=0",
                "",
                "SLURM_ARRAY_TASK_MIN is missing beside SLURM_ARRAY_TASK_ID=1",
            ),
            (
                "step=1",
                "",
                "SLURM_ARRAY_TASK_STEP is missing beside SLURM_ARRAY_TASK_ID=1",
            ),
            (
                "id=1",
                "id=",
                "SLURM_ARRAY_TASK_ID=: must be a whole number",
            ),
            (
                "id=1",
                "id=-1",
                "SLURM_ARRAY_TASK_ID=-1: must be a whole number",
            ),
            (
                "id=1",
                "id=+1",
                "SLURM_ARRAY_TASK_ID=+1: must be a whole number",
            ),
            (
                "id=1",
                "id=1.0",
                "SLURM_ARRAY_TASK_ID=1.0: must be a whole number",
            ),
            (
                "id=1",
                "id=_",
                "SLURM_ARRAY_TASK_ID= : must be a whole number",
            ),
            (
                "count=4",
                "count=four",
                "SLURM_ARRAY_TASK_COUNT=four: must be a whole number",
            ),
            (
                "min=0",
                "min=",
                "SLURM_ARRAY_TASK_MIN=: must be a whole number",
            ),
            (
                "step=1",
                "step=0x1",
                "SLURM_ARRAY_TASK_STEP=0x1: must be a whole number",
            ),
            (
                "max=3",
                "max=",
                "SLURM_ARRAY_TASK_MAX=: must be a whole number",
            ),
            (
                "max=3",
                "max=18446744073709551616",
                "SLURM_ARRAY_TASK_MAX=18446744073709551616: must be a",
            ),
            // The numbers of Slurm contradict each other.
            (
                "step=1",
                "step=0",
                "SLURM_ARRAY_TASK_STEP=0: must be at least 1",
            ),
            (
                "step=1",
                "step=18446744073709551615",
                "SLURM_ARRAY_TASK_STEP=18446744073709551615: too",
            ),
            ("step=1", "step=2", "SLURM_ARRAY_TASK_MAX=3: must be 6, as"),
            (
                "count=4",
                "count=0",
                "SLURM_ARRAY_TASK_COUNT=0: must be from 1 to 1000000",
            ),
            (
                "count=4",
                "count=1000001",
                "SLURM_ARRAY_TASK_COUNT=1000001: must be from 1 to 1000000",
            ),
            (
                "min=0",
                "min=4",
                "SLURM_ARRAY_TASK_MAX=3: must be at least SLURM_ARRAY_TASK_MIN=4",
            ),
            ("max=3", "max=5", "SLURM_ARRAY_TASK_MAX=5: must be 3, as"),
            (
                full,
                "id=0 count=4 min=1 step=1 max=4",
                "SLURM_ARRAY_TASK_ID=0: must be from 1 to 4 in",
            ),
            (
                "id=1",
                "id=4",
                "SLURM_ARRAY_TASK_ID=4: must be from 0 to 3 in steps of 1",
            ),
            (
                "count=4 min=0",
                "count=3 min=2",
                "SLURM_ARRAY_TASK_MAX=3: must be 4, as",
            ),
            (
                "count=4 min=0 step=1",
                "count=2 min=0 step=3",
                "SLURM_ARRAY_TASK_ID=1: must be from 0 to 3 in",
            ),
            // The variables of both schedulers are set.
            (
                "max=3",
                "max=3 index=2 shards=4",
                "JOB_COMPLETION_INDEX=2 with CFMMR_SHARDS=4 contradicts",
            ),
            ("max=3", "max=3 index=1 shards=5", "Slurm's part 1 of 4"),
            (
                "max=3",
                "max=3 shards=4",
                "JOB_COMPLETION_INDEX is missing beside CFMMR_SHARDS=4",
            ),
            (
                "max=3",
                "max=3 index=1",
                "CFMMR_SHARDS is missing beside JOB_COMPLETION_INDEX=1",
            ),
            // The variables of Kubernetes are incomplete or wrong.
            (
                full,
                "shards=3",
                "JOB_COMPLETION_INDEX is missing beside CFMMR_SHARDS=3",
            ),
            (full, "shards=-1", "CFMMR_SHARDS=-1: must be a whole number"),
            (full, "shards=", "CFMMR_SHARDS=: must be a whole number"),
            (
                full,
                "index=0",
                "CFMMR_SHARDS is missing beside JOB_COMPLETION_INDEX=0",
            ),
            (
                full,
                "index= shards=3",
                "JOB_COMPLETION_INDEX=: must be a whole number",
            ),
            (
                full,
                "index=-1 shards=3",
                "JOB_COMPLETION_INDEX=-1: must be a whole number",
            ),
            (
                full,
                "index=3 shards=3",
                "JOB_COMPLETION_INDEX=3: must be from 0 to 2, as CFMMR_SHARDS=3",
            ),
            (
                full,
                "index=0 shards=0",
                "CFMMR_SHARDS=0: must be from 1 to 1000000",
            ),
            (
                full,
                "index=0 shards=1000001",
                "CFMMR_SHARDS=1000001: must be from 1 to 1000000",
            ),
            (
                full,
                "max=3",
                "SLURM_ARRAY_TASK_ID is missing beside SLURM_ARRAY_TASK_MAX=3",
            ),
            (
                full,
                "step=0",
                "SLURM_ARRAY_TASK_ID is missing beside SLURM_ARRAY_TASK_STEP=0",
            ),
        ] {
            let text = full.replace(change, to);
            assert_ne!(text, full);
            let error = shard(&text).expect_err(&text);
            assert!(error.to_string().contains(named), "{text}: {error}");
            assert!(error.to_string().contains("--shard I/N"), "{error}");
            assert_eq!(error.exit_code(), 2, "{text}");
        }
    }

    #[test]
    fn variable_without_unicode_is_refused() {
        use std::os::unix::ffi::OsStringExt;
        let bytes = |name: &str| (name == "CFMMR_SHARDS").then(|| OsString::from_vec(vec![0xff]));
        let error = Shard::from_environment(bytes).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("CFMMR_SHARDS=\u{fffd}: must be a whole number"),
            "{error}"
        );
    }

    #[test]
    fn malformed_shard_option_is_refused_by_name() {
        for text in ["", "3", "4/4", "0/0", "-1/4", "1/x", "0/1000001"] {
            let error = Shard::parse(text).unwrap_err();
            assert!(error.to_string().contains("--shard"), "{text}");
            assert_eq!(error.exit_code(), 2, "{text}");
        }
        assert_eq!(Shard::parse("3/4").unwrap(), Shard { index: 3, count: 4 });
    }
}
