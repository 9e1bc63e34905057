#!/usr/bin/env python3
"""Runs a campaign on a Ray cluster, one task per part, then the merge.

    pip install ray
    python3 tools/cluster/ray_campaign.py tools/studies/tyres_and_sensor.toml --out out/tyres --shards 16

Every node needs cfmmr (--cfmmr PATH) and a shared directory at --out. A task whose worker or program is killed is
repeated, at most --retries times, and skips complete blocks. If a part still fails, the other parts continue; the
merge then names the missing blocks, and the exit code is 1.
"""

import argparse
import ctypes
import pathlib
import signal
import subprocess
import sys

import ray


def end_with_parent():
    """Ends this process when the Ray worker is killed; an orphan would use the core of the repeated task."""
    pr_set_pdeathsig = 1
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGTERM)


def part(cfmmr, study, out, index, count, threads):
    """Runs part `index` of `count`; returns the exit code and the output of cfmmr."""
    command = [cfmmr, "campaign", study, "--out", out, "--threads", str(threads)]
    command += ["--shard", f"{index}/{count}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=end_with_parent)
    if done.returncode not in (0, 2):
        raise RuntimeError(f"part {index} of {count}: exit code {done.returncode}: {done.stderr.strip()}")
    # Exit code 2: the study or an option is wrong, so a repetition cannot succeed.
    return done.returncode, done.stderr if done.returncode else done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--shards", type=int, default=16)
    parser.add_argument("--threads", type=int, default=1, help="cores of one part")
    parser.add_argument("--retries", type=int, default=3, help="repetitions of a failed part")
    parser.add_argument("--cfmmr", default="cfmmr")
    parser.add_argument("--address", default=None, help="of a running cluster; none: start one here")
    arguments = parser.parse_args()
    if arguments.shards < 1 or arguments.threads < 1 or arguments.retries < 0:
        parser.error("--shards and --threads must be at least 1, --retries at least 0")
    study, out = str(arguments.study.resolve()), str(arguments.out.resolve())

    ray.init(address=arguments.address)
    options = {"num_cpus": arguments.threads, "max_retries": arguments.retries, "retry_exceptions": True}
    task = ray.remote(**options)(part)
    parts = {
        task.remote(arguments.cfmmr, study, out, index, arguments.shards, arguments.threads): index
        for index in range(arguments.shards)
    }
    failed = []
    waiting = list(parts)
    while waiting:
        ready, waiting = ray.wait(waiting)
        try:
            code, text = ray.get(ready[0])
        except ray.exceptions.RayError as error:
            failed.append(parts[ready[0]])
            print(f"part {failed[-1]} failed: {error}", file=sys.stderr, flush=True)
            continue
        print(text.strip(), file=sys.stderr if code else sys.stdout, flush=True)
        if code:
            for other in waiting:
                ray.cancel(other)
            sys.exit(code)
    ray.shutdown()
    if failed:
        print(f"failed parts: {', '.join(map(str, sorted(failed)))}", file=sys.stderr, flush=True)
    sys.exit(subprocess.run([arguments.cfmmr, "campaign", "merge", out], check=False).returncode)


if __name__ == "__main__":
    main()
