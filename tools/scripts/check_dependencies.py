#!/usr/bin/env python3
"""Checks licences, sources and versions of the dependencies against deny.toml.

    tools/scripts/check_dependencies.py

Reads the tables that `cargo deny` reads. Exit code 1 with a line for each crate that is not allowed.
"""
import json
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"


def packages(folder):
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--all-features"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"check_dependencies: {' '.join(command)} in {folder}: {done.stderr.strip()}")
    return [one for one in json.loads(done.stdout)["packages"] if one["source"]]


def is_allowed(licence, allowed):
    """True if an SPDX expression is satisfied by the allowed licences; `/` is an old form of OR."""
    alternatives = re.split(r"\bOR\b|/", re.sub(r"\(([^()]*)\)", lambda group: nested(group[1], allowed), licence))
    return any(all(term.strip() in allowed for term in one.split(" AND ")) for one in alternatives)


def nested(group, allowed):
    """An allowed licence of the group, else `none`."""
    return next((one.strip() for one in group.split(" OR ") if one.strip() in allowed), "none")


def main():
    deny = tomllib.loads((ROOT / "deny.toml").read_text())
    found = packages(ROOT)
    allowed, skipped = set(deny["licenses"]["allow"]), set(deny["bans"]["skip"])
    wrong, used = set(), set()
    versions = defaultdict(set)
    for one in found + packages(ROOT / "tools/fuzz") + packages(ROOT / "tools/mutants"):
        name = f"{one['name']}@{one['version']}"
        if not is_allowed(one["license"] or "none", allowed):
            wrong.add(f"{name}: licence {one['license']}")
        if one["source"] != REGISTRY:
            wrong.add(f"{name}: source {one['source']}")
    for one in found:
        versions[one["name"]].add(f"{one['name']}@{one['version']}")
    for name, of in versions.items():
        if len(of) > 1:
            used |= of & skipped
        if len(of - skipped) > 1:
            wrong.add(f"{name}: more than one version: {', '.join(sorted(of))}")
    wrong |= {f"{name}: in `skip`, but there is no second version" for name in skipped - used}
    for line in sorted(wrong):
        print(f"check_dependencies: {line}", file=sys.stderr)
    print(f"{len(found)} dependencies, {len(used)} of them older versions; {len(wrong)} errors")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
