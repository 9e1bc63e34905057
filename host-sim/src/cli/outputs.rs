//! Check of the outputs that a command line names, before anything runs.

use crate::base::error::Error;
use crate::view::page;
use clap::ArgMatches;
use std::fs;
use std::path::{Path, PathBuf};

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
];

/// Commands whose `--out` names a file.
const WITH_OUTPUT_FILE: [&str; 4] = ["dbc", "params", "calibrate", "replay"];

/// A named file or folder.
struct Named {
    option: String,
    path: PathBuf,
    is_output: bool,
}

/// Refuses two arguments that name one file if one of them is written, a file of `--out` named again, and a
/// place in `--out` at which no file can be written.
pub fn check(matches: &ArgMatches) -> Result<(), Error> {
    let (mut command, mut matches) = ("posture", matches);
    while let Some((name, below)) = matches.subcommand() {
        if command == "posture" || !WITH_OUTPUT_FILE.contains(&command) {
            command = name;
        }
        matches = below;
    }
    let mut named = Vec::new();
    let mut add = |id: &str, is_output: bool| {
        let given = matches.try_get_raw(id).ok().flatten();
        for path in given.into_iter().flatten().filter(|path| *path != "-") {
            let option = match id {
                "file" => "FILE".to_owned(),
                id => format!("--{}", id.replace('_', "-")),
            };
            let path = PathBuf::from(path);
            named.push(Named {
                option,
                path,
                is_output,
            });
        }
    };
    for id in OUTPUTS {
        add(id, !(command == "replay" && id == "log"));
    }
    INPUTS.into_iter().for_each(|id| add(id, false));
    let tilde = named
        .iter()
        .find(|it| it.is_output && starts_with_tilde(&it.path));
    if let Some(it) = tilde {
        return Err(Error::input(format!(
            "{} {}: ~ stands for a home folder only before /; for a folder of this name type ./{1}",
            it.option,
            it.path.display()
        )));
    }
    for (i, one) in named.iter().enumerate() {
        for other in &named[..i] {
            if (one.is_output || other.is_output) && is_same(&one.path, &other.path) {
                return Err(Error::input(format!(
                    "{} {} and {} {}: the same file: must differ",
                    other.option,
                    other.path.display(),
                    one.option,
                    one.path.display()
                )));
            }
        }
    }
    if WITH_OUTPUT_FILE.contains(&command) || matches.try_get_raw("out").is_err() {
        return Ok(());
    }
    let given = named.iter().find(|it| it.option == "--out");
    let folder = given.map_or_else(|| Path::new("out").join(command), |it| it.path.clone());
    let in_folder = |path: &Path| path.parent().is_some_and(|parent| is_same(parent, &folder));
    let is_result = |path: &Path| {
        RESULTS
            .iter()
            .any(|name| path.file_name() == Some(name.as_ref()))
    };
    let taken = named
        .iter()
        .find(|it| in_folder(&it.path) && is_result(&it.path));
    if let Some(it) = taken {
        return Err(Error::input(format!(
            "{} {}: the run writes this file of --out itself: must be another name",
            it.option,
            it.path.display()
        )));
    }
    for name in RESULTS {
        let path = folder.join(name);
        if fs::metadata(&path).is_ok_and(|data| !data.is_file()) {
            return Err(Error::input(format!(
                "--out: {}: must be a regular file, for the run replaces it",
                path.display()
            )));
        }
    }
    Ok(())
}

fn starts_with_tilde(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().first() == Some(&b'~')
}

/// True if two paths name one file, which need not exist.
fn is_same(one: &Path, other: &Path) -> bool {
    resolved(one) == resolved(other)
}

/// The path without links and dots, as far as its folders exist.
fn resolved(path: &Path) -> PathBuf {
    if let Ok(real) = path.canonicalize() {
        return real;
    }
    let Ok(whole) = std::path::absolute(path) else {
        return path.to_owned();
    };
    match (whole.parent(), whole.file_name()) {
        (Some(parent), Some(name)) => resolved(parent).join(name),
        _ => whole,
    }
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
    fn something_else_at_the_place_of_a_result_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("log.csv")).unwrap();
        let text = refusal("follow --out DIR", folder.path()).unwrap();
        assert!(text.contains("log.csv: must be a regular file"), "{text}");
        let text = refusal("follow --out ~user", folder.path()).unwrap();
        assert!(text.contains("./~user"), "{text}");
    }
}
