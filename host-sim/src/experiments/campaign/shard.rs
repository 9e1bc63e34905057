//! Which part of a campaign a process does.

use crate::base::error::Error;

/// Part `index` of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 0.
    pub index: u64,
    /// Number of parts.
    pub count: u64,
}

/// Most parts that can be asked for.
const MOST: u64 = 1_000_000;

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    fn new(name: &str, index: u64, count: u64) -> Result<Self, Error> {
        match (1..=MOST).contains(&count) && index < count {
            true => Ok(Self { index, count }),
            false => Err(Error::input(format!(
                "{name}: part {index} of {count}: must be I/N with I from 0 to N − 1 and N from 1 to {MOST}"
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

    /// The part that a scheduler gave this process: a Slurm array's task, or the pod of an indexed
    /// Kubernetes job whose manifest says in `CFMMR_SHARDS` how many there are. `variable` reads the
    /// environment.
    pub fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Result<Self, Error> {
        let number = |name: &str, text: String| {
            text.trim().parse::<u64>().map_err(|_| {
                Error::input(format!("{name}={text}: must be a whole number, 0 or more"))
            })
        };
        let read = |name: &str| variable(name).map(|text| number(name, text)).transpose();
        let needed = |name: &str, beside: &str, advice: &str| {
            let missing = || format!("{name} is missing beside {beside}: {advice}");
            read(name)?.ok_or_else(|| Error::input(missing()))
        };
        if let Some(task) = read("SLURM_ARRAY_TASK_ID")? {
            let least = read("SLURM_ARRAY_TASK_MIN")?.unwrap_or(0);
            let step = read("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
            let advice = "give --shard I/N";
            let count = needed("SLURM_ARRAY_TASK_COUNT", "SLURM_ARRAY_TASK_ID", advice)?;
            let Some(above) = task.checked_sub(least) else {
                return Err(Error::input(format!(
                    "SLURM_ARRAY_TASK_ID={task}: must be at least SLURM_ARRAY_TASK_MIN={least}"
                )));
            };
            return Self::new("SLURM_ARRAY_TASK_ID", above / step, count);
        }
        if let Some(index) = read("JOB_COMPLETION_INDEX")? {
            let advice = "set it to the job's completions, or give --shard I/N";
            let count = needed("CFMMR_SHARDS", "JOB_COMPLETION_INDEX", advice)?;
            return Self::new("JOB_COMPLETION_INDEX", index, count);
        }
        Ok(Self::WHOLE)
    }

    /// True if this part computes the block.
    pub fn has(self, block: u64) -> bool {
        block % self.count == self.index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pairs: &[(&str, &str)]) -> Result<Shard, Error> {
        Shard::from_environment(|name| {
            let found = pairs.iter().find(|(other, _)| *other == name);
            found.map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn parts_are_disjoint_and_leave_nothing_out() {
        for count in 1..9 {
            for block in 0..40 {
                let owners = (0..count).filter(|&index| Shard { index, count }.has(block));
                assert_eq!(owners.count(), 1);
            }
        }
    }

    #[test]
    fn schedulers_are_understood() {
        assert_eq!(of(&[]).unwrap(), Shard::WHOLE);
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
            ("SLURM_ARRAY_TASK_COUNT", "5"),
        ];
        assert_eq!(of(&slurm).unwrap(), Shard { index: 3, count: 5 });
        let pod = [("JOB_COMPLETION_INDEX", "2"), ("CFMMR_SHARDS", "3")];
        assert_eq!(of(&pod).unwrap(), Shard { index: 2, count: 3 });
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        for text in ["", "3", "4/4", "0/0", "-1/4", "1/x", "0/1000001"] {
            let error = Shard::parse(text).unwrap_err();
            assert!(error.to_string().contains("--shard"), "{text}");
            assert_eq!(error.exit_code(), 2, "{text}");
        }
        assert_eq!(Shard::parse("3/4").unwrap(), Shard { index: 3, count: 4 });
        let missing = of(&[("JOB_COMPLETION_INDEX", "2")]).unwrap_err();
        assert!(missing.to_string().contains("CFMMR_SHARDS"));
        let [id, count] = [
            ("SLURM_ARRAY_TASK_ID", "0"),
            ("SLURM_ARRAY_TASK_COUNT", "5"),
        ];
        let low = of(&[id, ("SLURM_ARRAY_TASK_MIN", "1"), count]).unwrap_err();
        assert!(low.to_string().contains("SLURM_ARRAY_TASK_MIN"));
        assert!(of(&[("SLURM_ARRAY_TASK_ID", "x")]).is_err());
    }
}
