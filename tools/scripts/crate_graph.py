#!/usr/bin/env python3
"""Print the graph of the workspace's crates as Mermaid, from `cargo metadata`.

    tools/scripts/crate_graph.py

An arrow points from a crate to a crate that depends on it. Dependencies of tests, and arrows that follow from other
arrows, are left out.
"""
import json
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def dependencies():
    """Crates of the workspace that each crate of the workspace depends on."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--no-deps"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    packages = json.loads(done.stdout)["packages"]
    names = {package["name"] for package in packages}
    return {
        package["name"]: {
            one["name"] for one in package["dependencies"] if one["name"] in names and one["kind"] != "dev"
        }
        for package in packages
    }


def below(graph, name):
    """All crates that a crate depends on, directly or not."""
    found = set()
    for one in graph[name]:
        found |= {one} | below(graph, one)
    return found


def main():
    graph = dependencies()
    print("```mermaid\ngraph LR")
    for name in sorted(graph, key=lambda name: (len(below(graph, name)), name)):
        indirect = set().union(*(below(graph, one) for one in graph[name]))
        for one in sorted(graph[name] - indirect):
            print(f"  {one} --> {name}")
    print("```")


if __name__ == "__main__":
    main()
