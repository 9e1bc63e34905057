"""Starts the programs that run the core in a comparison: examples of virtual-board."""

import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[3]


def build(example):
    """Builds an example; returns the path of its program."""
    command = ["cargo", "build", "--locked", "--quiet", "--release", "--package", "virtual-board"]
    if subprocess.run(command + ["--example", example], cwd=ROOT).returncode != 0:
        sys.exit(f"the example {example} of virtual-board does not build")
    return ROOT / "target" / "release" / "examples" / example


def start(example, *arguments):
    """Builds and starts an example; requests and answers go through its standard input and output."""
    command = [build(example), *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
