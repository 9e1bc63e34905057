"""Terminals and pipes that are closed, a full standard output, environments of schedulers."""
import fcntl
import os
import pty
import re
import signal
import subprocess
import termios
import time
from pathlib import Path

from bench import CODE, HALF, HANG, Case, Kind, environment, last_line

SHORT = ["--set", "mission.time_limit_s=0.1", "--out", "out"]


class Terminals(Kind):
    """Runs whose terminal is closed at any time, and pipes without a reader."""

    name, count = "terminals", 10
    parallel = 4
    LIMIT_S = 5.0
    RUNS = [
        ["drive", "--out", "out"], ["drive", "--out", "out", "--dashboard", "speed", "0.1", "0.5", "60"],
        ["posture", "--trials", "400", "--threads", "1", "--out", "out"], ["soak", "--ticks", "20000000"],
        ["follow", "--dashboard", "--out", "out"], ["drive", "--out", "out", "--log", "x.mcap", "--csv", "t"],
        ["follow", "--laps", "100", "--out", "out", "--log", "x.mcap"], ["faults", "--threads", "1"],
        ["campaign", "study.toml", "--threads", "1", "--out", "out"], ["consistency", "--trials", "400", "--threads", "1", "--out", "out"],
    ]
    PIPED = [["soak", "--ticks", "20000000"], ["config"], ["faults", "--threads", "1", "--only", "none", "--seeds", "1"],
             ["topics"], ["dbc"], ["world", "careful"]]

    def case(self, rng, index, folder):
        (folder / "study.toml").write_text('name = "s"\ntrials = 500\nblock = 5\nstarts = "random"\n')
        piped = index % 5 == 4
        runs = self.PIPED if piped else self.RUNS
        words = runs[(index // 5 if piped else index) % len(runs)]
        at, keys = rng.choice([0.1, 0.2, 0.3, 1.0]) * (0.5 + rng.random()), rng.choice([b"", b"", b"w", b"\x1b[A", b"wwa \x1b"])

        def check(ended):
            run = self.pipe if piped else self.terminal
            code, seconds, left = run(words, folder, at, keys)
            ended.code = ended.code if code is None else code
            if code is None:
                return [(HANG, f"closed after {at:.2f} s: did not end within {self.LIMIT_S:g} s: {' '.join(words)}")]
            found = [(CODE, f"processes left: {left}: {' '.join(words)}")] if left else []
            # 0: ended before, or by q; 1: ended early, with results.
            if code not in (0, 1, 130) or not piped and code == 1 and "soak" in words:
                found.append((CODE, f"closed after {at:.2f} s: exit code {code}: {' '.join(words)}"))
            names = [name for name in os.listdir(folder) if name.endswith(".partial")]
            ended.code = 0
            return found + ([(HALF, f"left {names}: {' '.join(words)}")] if names else [])

        # Placeholder command: the run with the terminal or pipe is in check.
        return Case(["codes"], codes=(0,), check=check, may_leave_temporary=True)

    def terminal(self, words, folder, at, keys):
        """Closes the terminal of a run; returns exit code, time to the end, remaining processes."""
        master, slave = pty.openpty()

        def control():
            os.setsid()
            fcntl.ioctl(slave, termios.TIOCSCTTY, 0)

        process = subprocess.Popen([self.bench.program, *words], cwd=folder, stdin=slave, stdout=slave, stderr=slave,
                                   preexec_fn=control, env=environment() | {"TERM": "xterm"}, close_fds=True)
        os.close(slave)
        reading, printed = time.monotonic() + at, False
        os.set_blocking(master, False)
        while time.monotonic() < reading:
            try:
                printed = bool(os.read(master, 65536)) or printed
            except BlockingIOError:
                time.sleep(0.01)
            except OSError:
                break
        if keys:
            try:
                os.write(master, keys)
            except OSError:
                pass
        os.close(master)
        code, seconds, left = self.end(process)
        # A program that has printed nothing may not have begun: the signal of the terminal ends it.
        return (0 if code == -signal.SIGHUP and not printed else code), seconds, left

    def pipe(self, words, folder, at, keys):
        """Run whose pipe has no reader."""
        reader, writer = os.pipe()
        process = subprocess.Popen([self.bench.program, *words], cwd=folder, stdin=subprocess.DEVNULL, stdout=writer,
                                   stderr=writer if keys else subprocess.DEVNULL, start_new_session=True, env=environment())
        os.close(writer)
        time.sleep(at)
        os.close(reader)
        return self.end(process)

    def end(self, process):
        began = time.monotonic()
        try:
            code = process.wait(self.LIMIT_S)
        except subprocess.TimeoutExpired:
            code = None
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        left = []
        for place in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = place.read_text().rpartition(")")[2].split()
                if fields[3] == str(process.pid) and fields[0] != "Z":
                    left.append(place.parent.name)
            except OSError:
                pass
        return code, time.monotonic() - began, left


class Full(Kind):
    """Standard output that cannot be written: exit code 1, and the error names it."""

    name, count = "full", 10
    WORDS = [
        ["config"], ["codes"], ["topics"], ["serial"], ["parameters"], ["dbc"], ["world"], ["world", "careful"], ["completions", "bash"],
        ["--help"], ["--version"], ["drive", "--help"], ["help"], ["campaign", "help", "merge"], ["world", "careful", "--toml"],
        ["drive", "stop", "--out", "out"], ["drive", "stop", "--out", "out", "--json", "-"],
        ["posture", "--rows", "joint", "--trials", "1", *SHORT], ["params", "list", "--flash", "flash"], ["params", "get", "button.action", "--flash", "flash"],
        ["params", "export", "--all", "--flash", "flash"], ["params", "set", "button.action=1", "--board", "front", "--flash", "flash"],
        ["follow", "--path", "line", "--size", "0.1", "--out", "out"], ["track", "--path", "line", "--size", "0.1", "--out", "out"],
        ["faults", "--only", "none", "--seeds", "1", "--threads", "1"], ["soak", "--ticks", "10000"], ["doctor"],
        ["consistency", "--trials", "2", "--fusion", "odometry", "--threads", "1", "--out", "out"], ["calibrate", "gauges", "--laps", "1", "--out", "x.toml"],
        ["campaign", "s.toml", "--threads", "1", "--out", "out"], ["campaign", "status", "study"], ["campaign", "merge", "study", "--out", "m"],
        ["replay", "log.mcap"], ["replay", "log.mcap", "--json", "-"], ["eval", "rps"], ["dbc", "--load"], ["drive", "stop", "--out", "out", "--log", "x.mcap"],
    ]

    def prepare(self):
        (self.folder / "s.toml").write_text('name = "s"\ntrials = 1\n[scenario.mission]\ntime_limit_s = 0.1\n')
        self.sound("campaign", "s.toml", "--threads", "1", "--out", "study")
        self.sound("drive", "stop", "--out", "out", "--log", "log.mcap")

    def case(self, rng, index, folder):
        words = self.WORDS[index * 7 % len(self.WORDS)]
        for name in ("s.toml", "study", "log.mcap"):
            (folder / name).symlink_to(self.folder / name)
        text = b"{}\n" if words[0] == "eval" else b""
        named = lambda ended: [] if "standard output" in ended.err else [(CODE, f"standard output is not named: {last_line(ended.err)}")]
        return Case(words, codes=(1,), refuse="standard output is full", stdout=Path("/dev/full"), stdin=text, check=named, plain=True)


VALUES = ["0", "1", "2", "3", "5", "4", "10", "", "-1", "x", "1.5", " 1", "+1", "18446744073709551615", "9" * 50, "0x1", "١", "1e1"]
STUDY = 'name = "s"\ntrials = 4\nblock = 1\n[scenario.mission]\ntime_limit_s = 0.1\n'


class Shards(Kind):
    """Environments of schedulers: complete and consistent ones select a part of the study, others are refused."""

    name, count = "shards", 40
    SLURM = ["ID", "COUNT", "MIN", "STEP", "MAX"]

    def case(self, rng, index, folder):
        (folder / "s.toml").write_text(STUDY)
        env = self.sound_slurm(rng) if index % 3 == 0 else self.sound_kubernetes(rng) if index % 3 == 1 else {}
        names = ["CFMMR_SHARDS", "JOB_COMPLETION_INDEX", *(f"SLURM_ARRAY_TASK_{name}" for name in self.SLURM)]
        for name in rng.sample(names, rng.choice([0, 0, 1, 1, 2, 3, 7])):
            change = rng.random()
            env[name] = rng.choice(VALUES)
            if change < 0.3:
                del env[name]
        right, part = self.expected(env)
        words = ["campaign", "s.toml", "--threads", "1", "--out", "out"]

        def check(ended):
            if ended.code != 0 or not right:
                return []
            blocks = sorted(int(path.stem[6:]) for path in (folder / "out").glob("block-*.jsonl"))
            asked = [block for block in range(4) if block % part[1] == part[0]]
            return [] if blocks == asked else [(CODE, f"{env}: blocks {blocks}, expected {asked}")]

        named = "|".join(names)
        refuse = f"{env}" if not right else ""
        return Case(words, codes=(0,) if right else (2,), refuse=refuse, env=env, check=check, named=named, plain=True)

    def sound_slurm(self, rng):
        count, low, step = rng.randrange(1, 6), rng.choice([0, 0, 1, 7]), rng.choice([1, 1, 2, 5])
        values = dict(ID=low + step * rng.randrange(count), COUNT=count, MIN=low, STEP=step, MAX=low + step * (count - 1))
        return {f"SLURM_ARRAY_TASK_{name}": str(value) for name, value in values.items()}

    def sound_kubernetes(self, rng):
        count = rng.randrange(1, 6)
        return {"CFMMR_SHARDS": str(count), "JOB_COMPLETION_INDEX": str(rng.randrange(count))}

    def expected(self, env):
        """True if an environment is right, and the selected part: index and number of parts."""
        numbers = {}
        for name, value in env.items():
            if not re.fullmatch("[0-9]+", value) or int(value) >= 2**64:
                return False, None
            numbers[name.rpartition("_")[2] if name.startswith("SLURM") else name] = int(value)
        parts = []
        if any(name in numbers for name in self.SLURM):
            if any(name not in numbers for name in self.SLURM[:4]):
                return False, None
            task, count, low, step = (numbers[name] for name in self.SLURM[:4])
            if not 1 <= count <= 1_000_000 or step < 1 or task < low or (task - low) % step or (task - low) // step >= count:
                return False, None
            if numbers.get("MAX", low + step * (count - 1)) != low + step * (count - 1) or low + step * (count - 1) >= 2**64:
                return False, None
            parts.append(((task - low) // step, count))
        if "CFMMR_SHARDS" in numbers or "JOB_COMPLETION_INDEX" in numbers:
            index, count = numbers.get("JOB_COMPLETION_INDEX"), numbers.get("CFMMR_SHARDS")
            if index is None or count is None or not 1 <= count <= 1_000_000 or index >= count:
                return False, None
            parts.append((index, count))
        if len(set(parts)) > 1:
            return False, None
        return True, parts[0] if parts else (0, 1)
