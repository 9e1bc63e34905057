//! Mutation testing of core-algos by changes of meaning: the tests must detect each mutant.
//!
//! The mutants of all files are built at once, each behind a switch selected by an environment variable. Mutants that
//! do not compile are replaced by others. Then the tests of the file's module run once per mutant.

mod equivalent;
mod rules;
mod run;
mod tree;

use anyhow::{Context, Result, bail};
use clap::Parser;
use equivalent::Equivalent;
use rules::{Rule, Site};
use run::{Outcome, Tests};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use tree::Tree;

/// Change core-algos in small ways, one at a time, and count the changes that the tests detect.
#[derive(Parser)]
struct Arguments {
    /// Files or folders of core-algos/src.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// Number of changes per file.
    #[arg(long, default_value_t = 10)]
    per_file: usize,
    /// Seed of the selection.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Make only changes of these rules.
    #[arg(long, value_delimiter = ',', value_parser = rule)]
    rules: Vec<Rule>,
    /// Exit 1 if less than this share is detected, %.
    #[arg(long, default_value_t = 0.0)]
    least: f64,
    /// Number of changes tested in parallel.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Print one line of JSON per change.
    #[arg(long)]
    json: bool,
    /// Print the possible changes without testing.
    #[arg(long)]
    list: bool,
}

fn rule(name: &str) -> Result<Rule, String> {
    serde_json::from_value(name.into()).map_err(|error| error.to_string())
}

/// Change with its number in the test program.
#[derive(Clone, Debug, serde::Serialize)]
struct Mutant {
    /// Number that selects the change in the test program; 0 selects none.
    number: usize,
    file: String,
    line: usize,
    rule: Rule,
    before: String,
    after: String,
    #[serde(skip)]
    site: Site,
}

/// Source files of core-algos/src below `paths`, without tests, by their paths in the repository.
fn files(root: &Path, paths: &[PathBuf]) -> Result<Vec<String>> {
    let mut found = BTreeSet::new();
    let mut waiting: Vec<PathBuf> = paths.iter().map(|path| root.join(path)).collect();
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            for entry in path.read_dir()? {
                waiting.push(entry?.path());
            }
            continue;
        }
        let name = path
            .strip_prefix(root)
            .unwrap_or(&path)
            .display()
            .to_string();
        if !path.is_file() || !name.starts_with("core-algos/src/") {
            bail!("{name}: no file or folder of core-algos/src");
        }
        let tests = ["tests.rs", "testing.rs", "properties.rs"];
        let of_tests = name.contains("/tests/") || tests.iter().any(|end| name.ends_with(end));
        if name.ends_with(".rs") && !of_tests {
            found.insert(name);
        }
    }
    Ok(found.into_iter().collect())
}

/// Order in which the changes of a file are tried: rules in turn, changes of a rule in random order.
fn shuffled_by_rule(sites: Vec<Site>, seed: u64, file: &str) -> Vec<Site> {
    let mut random = file
        .bytes()
        .fold(seed, |hash, byte| next(hash ^ u64::from(byte)));
    let mut by_rule: BTreeMap<Rule, Vec<Site>> = BTreeMap::new();
    for site in sites {
        by_rule.entry(site.rule).or_default().push(site);
    }
    for sites in by_rule.values_mut() {
        for i in (1..sites.len()).rev() {
            random = next(random);
            sites.swap(i, (random % (i as u64 + 1)) as usize);
        }
    }
    let longest = by_rule.values().map(Vec::len).max().unwrap_or(0);
    (0..longest)
        .flat_map(|k| by_rule.values().filter_map(move |sites| sites.get(k)))
        .cloned()
        .collect()
}

/// Random number of SplitMix64 that follows `state`.
fn next(state: u64) -> u64 {
    let z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Possible changes of each file, in the order in which they are tried.
fn sites_by_file(root: &Path, arguments: &Arguments) -> Result<BTreeMap<String, Vec<Site>>> {
    let all = files(root, &[PathBuf::from("core-algos/src")])?;
    let mut times = BTreeSet::new();
    for file in &all {
        times.extend(rules::time_constants(&std::fs::read_to_string(
            root.join(file),
        )?)?);
    }
    let mut sites_by_file = BTreeMap::new();
    for file in files(root, &arguments.paths)? {
        let text = std::fs::read_to_string(root.join(&file))?;
        let mut sites = rules::sites(&text, &times).with_context(|| file.clone())?;
        if !arguments.rules.is_empty() {
            sites.retain(|site| arguments.rules.contains(&site.rule));
        }
        sites_by_file.insert(file.clone(), shuffled_by_rule(sites, arguments.seed, &file));
    }
    Ok(sites_by_file)
}

/// Text of a change with all white space as single spaces.
fn one_line(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ")
}

fn mutants(root: &Path, arguments: &Arguments) -> Result<Vec<Mutant>> {
    let mut mutants = Vec::new();
    for (file, sites) in sites_by_file(root, arguments)? {
        let text = std::fs::read_to_string(root.join(&file))?;
        for site in sites {
            mutants.push(Mutant {
                number: mutants.len() + 1,
                file: file.clone(),
                line: site.line,
                rule: site.rule,
                before: one_line(&text[site.bytes.clone()]),
                after: match &site.form {
                    rules::Form::Replaced(text) => one_line(text),
                    rules::Form::Removed => String::new(),
                },
                site,
            });
        }
    }
    Ok(mutants)
}

/// Top module of a file, whose tests are run.
fn module(file: &str) -> &str {
    let inside = file.trim_start_matches("core-algos/src/");
    let end = inside.find('/').unwrap_or(inside.len());
    inside[..end].trim_end_matches(".rs")
}

fn main() -> Result<ExitCode> {
    let arguments = Arguments::parse();
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()?;
    let all = mutants(&root, &arguments)?;
    let equivalent = Equivalent::read(&root)?;
    if arguments.rules.is_empty() {
        equivalent.check(&all)?;
    }
    if arguments.list {
        for Mutant {
            file,
            line,
            rule,
            before,
            after,
            ..
        } in &all
        {
            println!("{file}:{line} {rule:?}: {before} -> {after}");
        }
        return Ok(ExitCode::SUCCESS);
    }
    let tree = Tree::copy(&root)?;
    let (chosen, program) = tree.build(&root, all, arguments.per_file)?;
    let tests = Tests::new(&program, &root.join("core-algos"), &chosen)?;
    let outcomes = tests.run(&chosen, arguments.jobs.max(1));
    Ok(report(&arguments, &equivalent, &outcomes))
}

/// Numbers of changes in a folder or file, by outcome of the tests.
#[derive(Clone, Copy, Default)]
struct Count {
    noticed: usize,
    survived: usize,
    equivalent: usize,
}

impl Count {
    fn share(&self) -> f64 {
        100.0 * self.noticed as f64 / (self.noticed + self.survived).max(1) as f64
    }
}

fn report(
    arguments: &Arguments,
    equivalent: &Equivalent,
    outcomes: &[(Mutant, Outcome)],
) -> ExitCode {
    let mut counts: BTreeMap<String, Count> = BTreeMap::new();
    let mut total = Count::default();
    for (mutant, outcome) in outcomes {
        let reason = equivalent.reason(mutant);
        if arguments.json {
            let line = serde_json::json!({
                "mutant": mutant, "noticed_by": outcome.noticed_by(), "equivalent": reason,
            });
            println!("{line}");
        }
        let folder = mutant
            .file
            .rsplit_once('/')
            .map_or("", |(folder, _)| folder);
        for count in [counts.entry(folder.to_owned()).or_default(), &mut total] {
            match (outcome.noticed_by(), reason) {
                (Some(_), _) => count.noticed += 1,
                (None, Some(_)) => count.equivalent += 1,
                (None, None) => count.survived += 1,
            }
        }
        if let (None, None, false) = (outcome.noticed_by(), reason, arguments.json) {
            let Mutant {
                file,
                line,
                rule,
                before,
                after,
                ..
            } = mutant;
            println!("survived {file}:{line} {rule:?}\n    - {before}\n    + {after}");
        }
    }
    if !arguments.json {
        println!("| folder | noticed | share | equivalent |\n|---|---|---|---|");
        for (folder, count) in &counts {
            let of = count.noticed + count.survived;
            println!(
                "| `{folder}` | {} of {of} | {:.0} % | {} |",
                count.noticed,
                count.share(),
                count.equivalent
            );
        }
    }
    match total.share() >= arguments.least {
        true => ExitCode::SUCCESS,
        false => {
            eprintln!(
                "mutants: {:.1} % of the changes were noticed, {} % are wanted: write a test for each survivor, or list it \
                 in tools/mutants/equivalent.toml with the reason why no test can see it",
                total.share(),
                arguments.least
            );
            ExitCode::FAILURE
        }
    }
}
