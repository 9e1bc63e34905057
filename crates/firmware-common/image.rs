//! Build script of both images: shared memory map, linker scripts of runtime and log, and a hash of the sources.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

fn main() {
    let package = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let mut folders = package.ancestors();
    let workspace = folders.find(|folder| folder.join("Cargo.lock").exists());
    let workspace = workspace.expect("a member's workspace");
    println!("cargo::rustc-env=BUILD={}", build(&package, workspace));
    if package.ends_with("cfmmr")
        && let Some(commit) = commit(workspace)
    {
        println!("cargo::rustc-env=COMMIT={commit}");
    }
    // A build for the host only prints a message (see `main`), so it needs no linker script.
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    println!("cargo::rustc-link-search={}", workspace.display());
    for argument in ["--nmagic", "--build-id=fast", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
        if package.join("examples").is_dir() {
            println!("cargo::rustc-link-arg-examples={argument}");
        }
    }
}

/// Name and version of the image and a hash of its sources in this workspace. Equal sources give equal text, with or
/// without version control.
fn build(package: &Path, workspace: &Path) -> String {
    let mut hash = 0xcbf2_9ce4_8422_2325;
    let shared = [
        "core-algos/src",
        "crates/firmware-common/src",
        "Cargo.lock",
        "memory.x",
    ];
    // The simulator is built from more packages than the images.
    let program: &[&str] = match package.ends_with("cfmmr") {
        true => &[
            "crates/output/src",
            "crates/plant/src",
            "crates/recording/src",
            "crates/remote/src",
            "crates/view/src",
            "crates/virtual-board/src",
            "host-sim/src",
            "host-sim/worlds",
        ],
        false => &[],
    };
    let paths = shared.iter().chain(program);
    for path in paths
        .map(|name| workspace.join(name))
        .chain([package.join("src")])
    {
        println!("cargo::rerun-if-changed={}", path.display());
        hash_files(&path, &mut hash);
    }
    let [name, version] =
        ["CARGO_PKG_NAME", "CARGO_PKG_VERSION"].map(|name| env::var(name).expect("set by cargo"));
    format!("{name} {version} {hash:016x}")
}

/// Commit of the workspace, if it is under version control.
fn commit(workspace: &Path) -> Option<String> {
    let log = workspace.join(".git/logs/HEAD");
    if log.exists() {
        println!("cargo::rerun-if-changed={}", log.display());
    }
    let mut git = Command::new("git");
    let output = git
        .args(["rev-parse", "HEAD"])
        .current_dir(workspace)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

/// FNV-1a over the contents of the files, in the order of their names.
fn hash_files(path: &Path, hash: &mut u64) {
    if path.is_dir() {
        let entries = fs::read_dir(path).expect("a folder of sources");
        let mut entries: Vec<_> = entries
            .map(|entry| entry.expect("an entry").path())
            .collect();
        entries.sort();
        entries.iter().for_each(|entry| hash_files(entry, hash));
    } else {
        for byte in fs::read(path).expect("a source file") {
            *hash = (*hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
