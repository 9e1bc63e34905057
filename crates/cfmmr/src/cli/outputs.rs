//! Checks the output files of a command line before the command runs.

use clap::ArgMatches;
use host_sim::base::error::Error;
use output::files;
use output::files::OutputDir;
use std::fs;
use std::path::{Component, Path, PathBuf};
use view::page;

/// Options that name a file, or a folder, to write.
const OUTPUTS: [&str; 4] = ["log", "csv", "json", "out"];

/// Arguments that name a file to read.
const INPUTS: [&str; 6] = [
    "scenario",
    "script",
    "with",
    "file",
    "axle_image",
    "beam_image",
];

/// Files that runs write into the folder of `--out`.
const RESULTS: &[&str] = &[
    "result.json",
    page::FILE,
    "log.csv",
    "ends.csv",
    "errors.csv",
    "trials.csv",
    "consistency.csv",
    "profile.json",
    "board-front.log",
    "board-rear.log",
    "board-beam.log",
    "board-axle-2.log",
    "board-axle-3.log",
    "board-axle-4.log",
    "board-beam-1.log",
    "board-beam-2.log",
    "board-beam-3.log",
    "board-beam-4.log",
    "drive.svg",
    "paths.svg",
    "paths.png",
    "errors.svg",
    "errors.png",
    "follow.svg",
    "follow.png",
    "track.svg",
    "track.png",
    "consistency.svg",
    "consistency.png",
    "figure-7.svg",
    "figure-7.png",
    "figure-8.svg",
    "figure-8.png",
];

/// Commands whose `--out` names a file instead of a folder.
const WITH_OUTPUT_FILE: [&str; 4] = ["dbc", "params", "calibrate", "replay"];

/// File or folder that an argument names.
struct Named {
    option: String,
    path: PathBuf,
    is_output: bool,
}

/// Refuses an output that is also another argument's file or a result in the folder of `--out`, and an output that
/// cannot be written.
pub fn check(matches: &ArgMatches) -> Result<(), Error> {
    let (mut command, mut matches) = ("posture", matches);
    while let Some((name, below)) = matches.subcommand() {
        if command == "posture" || !WITH_OUTPUT_FILE.contains(&command) {
            command = name;
        }
        matches = below;
    }
    let named = named(command, matches);
    check_each(command, &named)?;
    check_pairs(&named)?;
    match WITH_OUTPUT_FILE.contains(&command) || matches.try_get_raw("out").is_err() {
        true => Ok(()),
        false => check_folder(command, &named),
    }
}

/// File and folder arguments of a parsed command line.
fn named(command: &str, matches: &ArgMatches) -> Vec<Named> {
    let mut named = Vec::new();
    let mut add = |id: &str, is_output: bool| {
        let given = matches.try_get_raw(id).ok().flatten();
        for path in given.into_iter().flatten().filter(|path| *path != "-") {
            let option = match id {
                "file" => "FILE".to_owned(),
                id => format!("--{}", id.replace('_', "-")),
            };
            named.push(Named {
                option,
                path: PathBuf::from(path),
                is_output,
            });
        }
    };
    for id in OUTPUTS {
        add(id, !(command == "replay" && id == "log"));
    }
    INPUTS.into_iter().for_each(|id| add(id, false));
    named
}

/// Checks that each output can be written.
fn check_each(command: &str, named: &[Named]) -> Result<(), Error> {
    for it in named.iter().filter(|it| it.is_output) {
        if starts_with_tilde(&it.path) {
            return Err(Error::input(format!(
                "{} {}: ~ stands for a home folder only before /; for a folder of this name type ./{1}",
                it.option,
                it.path.display()
            )));
        }
        let is_special = fs::metadata(&it.path).is_ok_and(|data| !data.is_file());
        if it.option == "--log" && is_special {
            return Err(Error::input(format!(
                "--log {}: must be a regular file: a log is read from its end",
                it.path.display()
            )));
        }
        let is_csv = it
            .path
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("csv"));
        let tried = match it.option.as_str() {
            // `JsonArgs::open` checks the JSON file.
            "--json" => Ok(()),
            "--out" if !WITH_OUTPUT_FILE.contains(&command) => {
                OutputDir::create(&it.path).map(drop)
            }
            "--csv" if !is_csv => OutputDir::create(&it.path).map(drop),
            _ => files::try_file(&it.path),
        };
        tried.map_err(|error| Error::input(format!("{}: {error}", it.option)))?;
    }
    Ok(())
}

/// Refuses two arguments that name one file if one of the arguments is an output.
fn check_pairs(named: &[Named]) -> Result<(), Error> {
    for (i, one) in named.iter().enumerate() {
        for other in &named[..i] {
            if (one.is_output || other.is_output) && is_same(&one.path, &other.path) {
                return Err(Error::input(format!(
                    "{} {} and {} {} name the same file: must be two different files",
                    other.option,
                    other.path.display(),
                    one.option,
                    one.path.display()
                )));
            }
        }
    }
    Ok(())
}

/// Refuses arguments that name a result in the folder of `--out`, and results that cannot be replaced.
fn check_folder(command: &str, named: &[Named]) -> Result<(), Error> {
    let given = named.iter().find(|it| it.option == "--out");
    let folder = given.map_or_else(|| Path::new("out").join(command), |it| it.path.clone());
    let folder = resolved(&folder);
    let taken = named.iter().find(|it| {
        let path = resolved(&it.path);
        let is_result = RESULTS.iter().any(|name| path == folder.join(name));
        let is_log = path.parent() == Some(&folder) && is_log_table(&path);
        it.option != "--out" && (is_result || is_log)
    });
    if let Some(it) = taken {
        return Err(Error::input(format!(
            "{} {}: the run writes this file in --out as a result: must have another name",
            it.option,
            it.path.display()
        )));
    }
    for name in RESULTS {
        let path = folder.join(name);
        if fs::metadata(&path).is_ok_and(|data| !data.is_file()) {
            return Err(Error::input(format!(
                "--out: {}: must be a regular file: the run replaces this file",
                path.display()
            )));
        }
    }
    Ok(())
}

/// True for the log of one row of a result table: `log-ROW.csv`.
fn is_log_table(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with("log-") && name.ends_with(".csv")
}

fn starts_with_tilde(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().first() == Some(&b'~')
}

/// True if two paths name one file, which need not exist.
fn is_same(one: &Path, other: &Path) -> bool {
    resolved(one) == resolved(other)
}

/// Absolute path without links and dots; parts that do not exist stay as given.
fn resolved(path: &Path) -> PathBuf {
    /// Largest number of links in one path, as in the Linux kernel.
    const MAX_LINKS: usize = 40;
    fn walk(path: &Path, links: usize) -> PathBuf {
        let mut real = PathBuf::new();
        for part in path.components() {
            match part {
                Component::Normal(name) => real.push(name),
                Component::ParentDir => drop(real.pop()),
                Component::CurDir => {}
                root => real.push(root),
            }
            if let Ok(target) = fs::read_link(&real)
                && links < MAX_LINKS
            {
                real.pop();
                real = walk(&real.join(target), links + 1);
            }
        }
        real
    }
    walk(
        &std::path::absolute(path).unwrap_or_else(|_| path.to_owned()),
        0,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(line: &str, folder: &Path) -> Option<String> {
        let line = line.replace("DIR", &folder.display().to_string());
        let words = std::iter::once("cfmmr").chain(line.split(' '));
        let matches = super::super::command().try_get_matches_from(words).unwrap();
        check(&matches).err().map(|error| {
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        })
    }

    #[test]
    fn arguments_that_name_one_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        fs::create_dir(at.join("sub")).unwrap();
        std::os::unix::fs::symlink(at.join("sub"), at.join("link")).unwrap();
        std::os::unix::fs::symlink("nowhere", at.join("to")).unwrap();
        std::os::unix::fs::symlink("loop", at.join("loop")).unwrap();
        for (line, named) in [
            ("follow --log DIR/f --json DIR/f", Some("--log")),
            (
                "follow --log DIR/f --json DIR/sub/../f",
                Some("the same file"),
            ),
            (
                "follow --log DIR/sub/f --json DIR/link/f",
                Some("the same file"),
            ),
            ("follow --csv DIR/x.csv --json DIR/x.csv", Some("--csv")),
            (
                "follow --out DIR/sub --csv DIR/sub --json DIR/sub",
                Some("--json"),
            ),
            (
                "follow --scenario DIR/s.toml --json DIR/s.toml",
                Some("--scenario"),
            ),
            ("replay DIR/r.mcap --json DIR/r.mcap", Some("--log")),
            ("params export --out DIR/f --json DIR/f", Some("--out")),
            (
                "follow --out DIR/sub --json DIR/sub/result.json",
                Some("writes this file"),
            ),
            (
                "--out DIR/sub --csv DIR/link/log.csv",
                Some("writes this file"),
            ),
            (
                "follow --log DIR/f --json DIR/g --csv DIR/h --out DIR/i",
                None,
            ),
            ("follow --out DIR/sub --log DIR/sub/run.mcap", None),
            ("follow --json - --csv DIR/-", None),
        ] {
            match (refusal(line, at), named) {
                (None, None) => {}
                (Some(text), Some(named)) => assert!(text.contains(named), "{line}: {text}"),
                (found, _) => panic!("{line}: {found:?}"),
            }
        }
    }

    #[test]
    fn unusable_outputs_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("log.csv")).unwrap();
        let text = refusal("follow --out DIR", folder.path()).unwrap();
        assert!(text.contains("log.csv: must be a regular file"), "{text}");
        // A file name without folder is in the current folder, here that of --out.
        let text = refusal("follow --out . --json log.csv", folder.path()).unwrap();
        assert!(text.contains("writes this file"), "{text}");
        let text = refusal("follow --out ~user", folder.path()).unwrap();
        assert!(text.contains("./~user"), "{text}");
    }
}
