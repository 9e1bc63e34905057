//! Varied keys that change no result.

use super::columns::Columns;
use super::study::{Kind, Study};
use crate::base::error::Error;
use crate::run::regulate::regulate;

/// Trials of a combination that are run again with another value of a drawn quantity.
const PROBES: u32 = 8;

/// First varied key that changes the result of no run.
pub fn idle_key<'a>(study: &'a Study, runs: &Columns) -> Result<Option<&'a str>, Error> {
    for (i, vary) in study.vary.iter().enumerate() {
        let changes = match vary.kind()? {
            Kind::Values(list) => list.len() < 2 || listed(study, i, list.len(), runs),
            Kind::Drawn(_) => drawn(study, i)?,
        };
        if !changes {
            return Ok(Some(&vary.key));
        }
    }
    Ok(None)
}

/// True if two runs that differ in this quantity alone have different results.
fn listed(study: &Study, varied: usize, count: usize, runs: &Columns) -> bool {
    let step = (study.stride(varied) * u64::from(study.trials)) as usize;
    let results = runs.0.iter().skip_while(|(name, _)| name != "e_m");
    let mut results = results.map(|(_, values)| values);
    let second = |&row: &usize| !(row / step).is_multiple_of(count);
    results.any(|values| {
        let mut rows = (0..runs.rows()).filter(second);
        rows.any(|row| !values.same(row, row - step))
    })
}

/// True if a trial of any combination has another result with the value of the next trial.
fn drawn(study: &Study, varied: usize) -> Result<bool, Error> {
    let cells = study.runs() / u64::from(study.trials);
    let trials = |cell| (0..study.trials.min(PROBES)).map(move |trial| (cell, trial));
    for (cell, trial) in (0..cells).flat_map(trials) {
        let mut values = study.values(cell, trial)?;
        let mut results = Vec::new();
        for next in 0..2 {
            values[varied] = study.values(cell, trial + next)?.swap_remove(varied);
            let scenario = study.scenario(trial, &values)?;
            let outcome = regulate(&scenario, study.seed, trial.into(), |_| {})?;
            results.push(format!("{outcome:?}"));
        }
        if results[0] != results[1] {
            return Ok(true);
        }
    }
    Ok(false)
}
