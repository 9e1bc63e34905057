//! List of equivalent mutants: changes that no test can detect, each with its reason.

use crate::{Mutant, Rule, one_line};
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::Path;

/// Content of `equivalent.toml`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Equivalent {
    #[serde(default)]
    mutant: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    file: String,
    rule: Rule,
    before: String,
    /// Text of the file after the change; `None` matches any text.
    after: Option<String>,
    reason: String,
}

impl Equivalent {
    /// Reads `tools/mutants/equivalent.toml`.
    pub fn read(root: &Path) -> Result<Self> {
        let path = root.join("tools/mutants/equivalent.toml");
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        toml::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Error for an entry of these mutants' files that names none of them: its line of code has changed.
    pub fn check(&self, mutants: &[Mutant]) -> Result<()> {
        let files: BTreeSet<_> = mutants.iter().map(|mutant| &mutant.file).collect();
        let own = self
            .mutant
            .iter()
            .filter(|entry| files.contains(&entry.file));
        for entry in own {
            if !mutants.iter().any(|mutant| entry.is(mutant)) {
                let Entry { file, before, .. } = entry;
                bail!(
                    "equivalent.toml: {file} has no change of `{before}`: remove the entry or correct its text"
                );
            }
        }
        Ok(())
    }

    /// Reason why a listed mutant is equivalent; `None` if the mutant is not listed.
    pub fn reason(&self, mutant: &Mutant) -> Option<&str> {
        let entry = self.mutant.iter().find(|entry| entry.is(mutant))?;
        Some(&entry.reason)
    }
}

impl Entry {
    fn is(&self, mutant: &Mutant) -> bool {
        let after = self.after.as_ref();
        mutant.file == self.file
            && mutant.rule == self.rule
            && mutant.before == one_line(&self.before)
            && after.is_none_or(|after| mutant.after == one_line(after))
    }
}
