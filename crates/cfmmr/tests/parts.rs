//! Build without the feature `full`: options of missing parts name the command to type.
#![cfg(not(feature = "full"))]

use std::process::{Command, Output};

fn cfmmr(arguments: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_cfmmr"));
    command.current_dir(folder.path()).args(arguments);
    command.output().unwrap()
}

#[test]
fn option_of_a_missing_part_names_the_command() {
    for (arguments, part) in [
        (&["follow", "--log", "a b.mcap"][..], "--log"),
        (&["follow", "--live"], "--live"),
        (&["follow", "--dashboard"], "--dashboard"),
        (&["replay", "run.mcap"], "replay run.mcap"),
    ] {
        let run = cfmmr(arguments);
        let error = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(2), "{arguments:?}: {error}");
        let quoted = shlex::try_join(arguments.iter().copied()).unwrap();
        let wanted = format!("cfmmr: {part}: not in this build; type: cargo cfmmr {quoted}\n");
        assert_eq!(error, wanted);
        assert!(run.stdout.is_empty());
    }
}

#[test]
fn experiment_and_pages_work_without_the_missing_parts() {
    let run = cfmmr(&["posture", "--trials", "1", "--rows", "pair"]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let page = cfmmr(&["codes"]);
    assert!(page.stdout.starts_with(b"# "), "{page:?}");
}
