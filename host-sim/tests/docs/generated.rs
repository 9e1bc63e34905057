//! Pages that the program writes.

use crate::pages::root;
use crate::program::cfmmr;
use std::fs;

#[test]
fn pages_that_a_command_prints_are_those_of_this_version() {
    for command in ["codes", "parameters", "serial", "topics"] {
        let path = format!("docs/{command}.md");
        let committed = fs::read_to_string(root().join(&path)).unwrap();
        let printed = cfmmr(&root(), &[command], "");
        assert!(printed.status.success(), "{command}: {}", printed.status);
        let printed = String::from_utf8(printed.stdout).unwrap();
        assert!(committed == printed, "run `cfmmr {command} > {path}`");
    }
}
