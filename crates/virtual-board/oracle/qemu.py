#!/usr/bin/env python3
"""Compares the core of the virtual boards with QEMU on firmware-bench.

    crates/virtual-board/oracle/qemu.py [--cycles]

Both run the image that counts the instructions of the boards' algorithms (tools/scripts/count_instructions.py),
QEMU with a fixed time for each instruction, the core with a SysTick that says the same
(`crates/virtual-board/examples/count.rs`). What it prints must be equal to the byte: the instructions of each case,
mean and largest, the stack of each, and the state at which the filter ends. Exit 1 if it is not.

With --cycles the core runs it once more, and a table of the cycles of each case is printed.
"""

import argparse
import difflib
import subprocess
import sys

import core_side

sys.path.insert(0, str(core_side.ROOT / "tools" / "scripts"))
import count_instructions


def ours(what):
    """What the image prints on the core, counting instructions or cycles."""
    program = core_side.build("count")
    command = [program, count_instructions.IMAGE, what]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    if run.returncode != 0:
        sys.exit(f"qemu.py: the core ended with {run.returncode}:\n{run.stdout}{run.stderr}")
    return run.stdout


def means(printed):
    """Mean of each case, by its name."""
    lines = [line.split() for line in printed.splitlines()]
    return {words[1]: int(words[2]) for words in lines if words[0] == "count"}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", action="store_true", help="print cycles of each case")
    arguments = parser.parse_args()
    theirs, printed = count_instructions.emulate(), ours("instructions")
    if theirs != printed:
        lines = [text.splitlines(keepends=True) for text in (theirs, printed)]
        sys.stdout.writelines(difflib.unified_diff(*lines, "QEMU", "virtual board"))
        sys.exit("qemu.py: the core and QEMU differ")
    print(f"{len(means(printed))} cases: instructions, stacks and results are those of QEMU")
    if arguments.cycles:
        instructions, cycles = means(printed), means(ours("cycles"))
        print("| | instructions | cycles | cycles an instruction |\n|---|---|---|---|")
        for name, (title, _) in count_instructions.TITLES.items():
            count, took = instructions[name], cycles[name]
            print(f"| {title} | {count} | {took} | {took / count:.2f} |")


if __name__ == "__main__":
    main()
