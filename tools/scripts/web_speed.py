#!/usr/bin/env python3
"""Compares the speed of the simulation in WebAssembly with this machine: processor time of the same work, the difference
between a long and a short run. Prints a table in Markdown.

    web_speed.py MODULE.wasm NATIVE     NATIVE: the example `native` of the package web
"""

import os
import subprocess
import sys

WORK = {"whole loop": ("loop", 2, 22), "plant alone": ("plant", 20_000, 420_000)}
"""Name of the work: argument, size of the short and of the long run."""
REPEATS = 5


def seconds(command):
    """Processor time of a command, s."""
    before = os.times()
    subprocess.run(command, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    module, native = sys.argv[1:]
    commands = {"WebAssembly": ["node", "bindings/web/speed.mjs", module], "native": [native]}
    print("| work | WebAssembly over native |")
    print("|---|---|")
    for name, (argument, short, long) in WORK.items():
        # The least of several runs, in turns, so that a change of the machine's speed meets both.
        times = {kind: [] for kind in commands}
        for _ in range(REPEATS):
            for kind, command in commands.items():
                spent = [seconds([*command, argument, str(size)]) for size in (short, long)]
                times[kind].append(spent[1] - spent[0])
        share = min(times["native"]) / min(times["WebAssembly"])
        print(f"| {name} | {100 * share:.0f} % |", flush=True)


if __name__ == "__main__":
    main()
