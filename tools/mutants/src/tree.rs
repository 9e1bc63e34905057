//! Copy of the repository whose core-algos contains every change behind a switch.

use crate::rules::Form;
use crate::{Mutant, module};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Code of the switch that selects a change at run time. Code that the compiler evaluates is never changed.
const SWITCH: &str = r#"
#[cfg(test)]
pub(crate) mod mutant {
    use std::sync::LazyLock;

    static NUMBER: LazyLock<u32> = LazyLock::new(|| {
        let number = std::env::var("CFMMR_MUTANT").ok();
        number.and_then(|number| number.parse().ok()).unwrap_or(0)
    });

    const fn never(_: u32) -> bool { false }
    fn is(number: u32) -> bool { *NUMBER == number }

    #[inline(always)]
    #[rustc_allow_const_fn_unstable(const_eval_select, core_intrinsics)]
    pub const fn on(number: u32) -> bool {
        core::intrinsics::const_eval_select((number,), never, is)
    }

    pub fn longer<T: Longer>(time: T) -> T { time.longer() }
    pub trait Longer { fn longer(self) -> Self; }
    macro_rules! longer {
        ($($t:ty: $four:expr,)+) => {$(impl Longer for $t { fn longer(self) -> Self { $four(self) } })+};
    }
    longer! {
        u8: |t: u8| t.saturating_mul(4), u16: |t: u16| t.saturating_mul(4), u32: |t: u32| t.saturating_mul(4),
        u64: |t: u64| t.saturating_mul(4), usize: |t: usize| t.saturating_mul(4), i32: |t: i32| t.saturating_mul(4),
        f32: |t: f32| t * 4.0,
    }
}
"#;

/// Folders of core-algos and of the crates of the workspace that it and its tests use.
const MEMBERS: [&str; 4] = [
    "core-algos",
    "crates/declare",
    "crates/plant",
    "crates/square-root",
];

/// Copy of core-algos in which the changes are made.
pub struct Tree {
    folder: PathBuf,
}

/// Byte range of a change in a changed file.
struct Part {
    number: usize,
    from: usize,
    to: usize,
}

impl Tree {
    /// Copies the tracked files of core-algos and of its dependencies in the workspace.
    pub fn copy(root: &Path) -> Result<Self> {
        let folder = root.join("target/meaning");
        let listed = Command::new("git")
            .args([
                "ls-files",
                "-z",
                "Cargo.toml",
                "Cargo.lock",
                "rust-toolchain.toml",
            ])
            .args(MEMBERS)
            .current_dir(root)
            .output()
            .context("git ls-files")?;
        let names = String::from_utf8(listed.stdout)?;
        for name in names.split('\0').filter(|name| !name.is_empty()) {
            write(&folder.join(name), &fs::read(root.join(name))?)?;
        }
        let workspace = fs::read_to_string(root.join("Cargo.toml"))?;
        let lines = workspace.lines().map(|line| match line {
            _ if line.starts_with("members =") => format!("members = {MEMBERS:?}"),
            _ if line.starts_with("default-members =") => String::new(),
            _ => line.to_owned(),
        });
        let workspace: Vec<String> = lines.collect();
        write(&folder.join("Cargo.toml"), workspace.join("\n").as_bytes())?;
        Ok(Self { folder })
    }

    /// Builds the tests of core-algos. Each file gets the first `per_file` of its changes that compile. Returns these
    /// changes and the test program.
    pub fn build(
        &self,
        root: &Path,
        mutants: Vec<Mutant>,
        per_file: usize,
    ) -> Result<(Vec<Mutant>, PathBuf)> {
        let mut files: BTreeMap<String, Vec<Mutant>> = BTreeMap::new();
        for mutant in mutants {
            files.entry(mutant.file.clone()).or_default().push(mutant);
        }
        self.switch()?;
        for round in 1.. {
            let mut parts = BTreeMap::new();
            for (file, mutants) in &files {
                let text = fs::read_to_string(root.join(file))?;
                let chosen = &mutants[..per_file.min(mutants.len())];
                let (text, found) = with_switches(&text, chosen);
                write(&self.folder.join(file), text.as_bytes())?;
                parts.insert(file.clone(), found);
            }
            let (program, errors) = self.compile()?;
            if let Some(program) = program {
                let chosen = files
                    .into_values()
                    .flat_map(|mutants| mutants.into_iter().take(per_file));
                return Ok((chosen.collect(), program));
            }
            let failing_changes = failing_changes(&parts, &errors);
            if failing_changes.is_empty() || round > 40 {
                let text: Vec<_> = errors.iter().map(|error| error.text.as_str()).collect();
                bail!("the changed crate does not build:\n{}", text.join("\n"));
            }
            for mutants in files.values_mut() {
                mutants.retain(|mutant| !failing_changes.contains(&mutant.number));
            }
        }
        unreachable!()
    }

    /// Adds to the crate the code that selects a change at run time.
    fn switch(&self) -> Result<()> {
        let path = self.folder.join("core-algos/src/lib.rs");
        let text = fs::read_to_string(&path)?
            .replace("#![forbid(unsafe_code)]", "#![allow(warnings)]\n#![allow(internal_features)]\n#![cfg_attr(test, feature(core_intrinsics, const_eval_select, rustc_attrs, allow_internal_unstable))]");
        write(&path, format!("{text}{SWITCH}").as_bytes())
    }

    /// Builds the tests; returns the test program, or the errors of the compiler.
    fn compile(&self) -> Result<(Option<PathBuf>, Vec<Error>)> {
        // `cargo check` finds the errors faster.
        let (_, errors) = self.cargo(&["check", "--profile", "test"])?;
        match errors.is_empty() {
            true => self.cargo(&["test", "--no-run"]),
            false => Ok((None, errors)),
        }
    }

    fn cargo(&self, command: &[&str]) -> Result<(Option<PathBuf>, Vec<Error>)> {
        let output = Command::new("cargo")
            .args(command)
            .args([
                "--offline",
                "--package",
                "core-algos",
                "--features",
                "link",
                "--lib",
            ])
            .args(["--message-format", "json"])
            .current_dir(&self.folder)
            .env("RUSTC_BOOTSTRAP", "1")
            .env("CARGO_TARGET_DIR", self.folder.join("target"))
            .output()
            .context("cargo")?;
        let messages: Vec<Value> = String::from_utf8_lossy(&output.stdout)
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect();
        let program = messages.iter().find_map(|message| {
            let ours = message["target"]["name"] == "core_algos";
            message["executable"].as_str().filter(|_| ours)
        });
        let errors: Vec<Error> = messages.iter().filter_map(Error::of).collect();
        if errors.is_empty() && !output.status.success() {
            bail!("{}", String::from_utf8_lossy(&output.stderr));
        }
        let program = program.filter(|_| errors.is_empty()).map(PathBuf::from);
        Ok((program, errors))
    }
}

/// Error of the compiler, with its places.
struct Error {
    text: String,
    /// File and byte offset of each place in the error.
    places: Vec<(String, usize)>,
}

impl Error {
    fn of(message: &Value) -> Option<Self> {
        let message = &message["message"];
        if message["level"] != "error" {
            return None;
        }
        let place = |span: &Value| {
            let file = span["file_name"].as_str()?.to_owned();
            Some((file, span["byte_start"].as_u64()? as usize))
        };
        let mut places: Vec<_> = message["spans"]
            .as_array()?
            .iter()
            .filter_map(place)
            .collect();
        for child in message["children"].as_array().into_iter().flatten() {
            places.extend(
                child["spans"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .filter_map(place),
            );
        }
        Some(Self {
            text: message["rendered"].as_str().unwrap_or_default().to_owned(),
            places,
        })
    }
}

/// Numbers of the changes that cause the errors: at each error, the innermost change.
fn failing_changes(parts: &BTreeMap<String, Vec<Part>>, errors: &[Error]) -> BTreeSet<usize> {
    let at = |(file, byte): &(String, usize)| {
        let within = |part: &&Part| (part.from..part.to).contains(byte);
        let parts = parts.get(file)?.iter().filter(within);
        parts
            .min_by_key(|part| part.to - part.from)
            .map(|part| part.number)
    };
    errors
        .iter()
        .filter_map(|error| error.places.iter().find_map(at))
        .collect()
}

/// Text of a file with each change behind a switch, and the byte range of each change.
fn with_switches(text: &str, mutants: &[Mutant]) -> (String, Vec<Part>) {
    let mut order: Vec<&Mutant> = mutants.iter().collect();
    // A change that contains other changes comes first, because `insert` expects this order.
    order.sort_by_key(|mutant| (mutant.site.bytes.start, usize::MAX - mutant.site.bytes.end));
    let mut parts = Vec::new();
    let mut to = String::new();
    let end = text.len();
    insert(text, 0..end, &order, &mut to, &mut parts);
    (to, parts)
}

/// Appends a range of the original text with the changes in the range.
fn insert(
    text: &str,
    range: std::ops::Range<usize>,
    mutants: &[&Mutant],
    to: &mut String,
    parts: &mut Vec<Part>,
) {
    let mut at = range.start;
    let mut rest = mutants;
    while let Some((first, later)) = rest.split_first() {
        let bytes = first.site.bytes.clone();
        let inside = later
            .iter()
            .take_while(|mutant| mutant.site.bytes.start < bytes.end)
            .count();
        let (inner, later) = later.split_at(inside);
        to.push_str(&text[at..bytes.start]);
        let from = to.len();
        let number = first.number;
        match &first.site.form {
            Form::Replaced(change) => {
                to.push_str(&format!(
                    "(if crate::mutant::on({number}) {{ {change} }} else {{ "
                ));
            }
            Form::Removed => to.push_str(&format!("if !crate::mutant::on({number}) {{ ")),
        }
        insert(text, bytes.clone(), inner, to, parts);
        to.push_str(match first.site.form {
            Form::Replaced(_) => " })",
            Form::Removed => " }",
        });
        parts.push(Part {
            number,
            from,
            to: to.len(),
        });
        at = bytes.end;
        rest = later;
    }
    to.push_str(&text[at..range.end]);
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|found| found == bytes) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

/// Modules of the changed files.
pub fn modules(mutants: &[Mutant]) -> BTreeSet<&str> {
    mutants.iter().map(|mutant| module(&mutant.file)).collect()
}
