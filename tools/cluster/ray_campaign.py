#!/usr/bin/env python3
"""A campaign on a Ray cluster, one part a task; then the merge.

    pip install ray
    python3 tools/cluster/ray_campaign.py tools/studies/tyres_and_sensor.toml --out out/tyres --shards 16

Every node needs cfmmr (--cfmmr PATH) and the same directory under --out. A task that fails is
repeated, and leaves alone what was finished.
"""

import argparse
import pathlib
import subprocess
import sys

import ray


def part(cfmmr, study, out, index, count, threads):
    """Runs part `index` of `count`; gives the line that cfmmr prints."""
    command = [cfmmr, "campaign", study, "--out", out, "--threads", str(threads)]
    command += ["--shard", f"{index}/{count}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 2:
        # The study or the command is wrong: repeating does not help.
        return done.returncode, done.stderr
    done.check_returncode()
    return 0, done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--shards", type=int, default=16)
    parser.add_argument("--threads", type=int, default=1, help="cores of one part")
    parser.add_argument("--cfmmr", default="cfmmr")
    parser.add_argument("--address", default=None, help="of a running cluster; none: start one here")
    arguments = parser.parse_args()
    if arguments.shards < 1 or arguments.threads < 1:
        parser.error("--shards and --threads must be at least 1")
    study, out = str(arguments.study.resolve()), str(arguments.out.resolve())

    ray.init(address=arguments.address)
    task = ray.remote(num_cpus=arguments.threads, max_retries=3, retry_exceptions=True)(part)
    waiting = [
        task.remote(arguments.cfmmr, study, out, index, arguments.shards, arguments.threads)
        for index in range(arguments.shards)
    ]
    while waiting:
        ready, waiting = ray.wait(waiting)
        code, text = ray.get(ready[0])
        print(text.strip(), file=sys.stderr if code else sys.stdout, flush=True)
        if code:
            for other in waiting:
                ray.cancel(other)
            sys.exit(code)
    sys.exit(subprocess.run([arguments.cfmmr, "campaign", "merge", out], check=False).returncode)


if __name__ == "__main__":
    main()
