//! List of equivalent mutants: changes that no test can detect, each with its reason.

use crate::{Mutant, Rule, one_line};
use anyhow::{Context, Result};
use serde::Deserialize;
use std::path::Path;

/// List of equivalent mutants.
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

    /// Reason why a listed mutant is equivalent; `None` if the mutant is not listed.
    pub fn reason(&self, mutant: &Mutant) -> Option<&str> {
        let is = |entry: &&Entry| {
            let after = entry.after.as_ref();
            mutant.file == entry.file
                && mutant.rule == entry.rule
                && mutant.before == one_line(&entry.before)
                && after.is_none_or(|after| mutant.after == one_line(after))
        };
        let entry = self.mutant.iter().find(is)?;
        Some(&entry.reason)
    }
}
