"""Runs the program on one case and checks its end."""
import csv
import io
import json
import os
import re
import resource
import signal
import subprocess
import tempfile
import threading
import time
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Callable

LIMIT_S = 20.0
# Largest length of standard error, characters: twice the longest refused file.
LONGEST_REFUSAL = 2_100_000
# Address space of the program, bytes.
MEMORY = 6 << 30
PANIC, HANG, SILENT, HALF, CODE = "panics", "hangs", "silent acceptances", "half-written files", "wrong exit codes"
COLUMNS = [PANIC, HANG, SILENT, HALF, CODE]


class Unsound(Exception):
    """A sound command failed."""


@dataclass
class Case:
    """One command line with its allowed results. The files that it reads are in its folder."""

    words: list
    codes: tuple = (0, 1, 2)
    # Reason why exit code 0 is a silent acceptance; empty if exit code 0 is right.
    refuse: str = ""
    # Regular expression that standard error matches after exit code 2, file names left out.
    named: str = ""
    # Content of standard input, or a device.
    stdin: bytes | Path | None = None
    # Device that replaces the file of standard output.
    stdout: Path | None = None
    # Environment variables in addition to those of this process.
    env: dict = field(default_factory=dict)
    cwd: str = "."
    limit: float = LIMIT_S
    memory: int = MEMORY
    largest_file: int | None = None
    # True if temporary files are allowed: a second signal ends the process at once.
    may_leave_temporary: bool = False
    # Acts on the running process, in a separate thread.
    during: Callable | None = None
    # Regular expressions of the files that a refused run may write.
    writes: tuple = ()
    # True if standard error must have no long number and no control character.
    plain: bool = False
    # Additional defects of this case, as (column, text).
    check: Callable = field(default=lambda ended: [])


@dataclass
class Ended:
    """End of a process."""

    code: int
    out: bytes
    err: str
    hung: bool
    seconds: float = 0.0
    # Largest resident memory, bytes.
    resident: int = 0

    @property
    def panicked(self):
        return self.code == 101 or self.code < 0 or "panicked at" in self.err


class Kind:
    """A kind of case. `count` cases for `--times 1`, each drawn from the seed, the kind and its index."""

    name = ""
    count = 0
    # Number of parallel cases: more if cases mostly wait, one if others would disturb a case.
    parallel = 2

    def __init__(self, bench, folder):
        self.bench, self.folder = bench, folder

    def total(self, times):
        return max(1, round(self.count * times))

    def prepare(self):
        """Makes the shared files of all cases in `self.folder`. Returns a reason if there is nothing to attack."""

    def case(self, rng, index, folder):
        raise NotImplementedError

    def sound(self, *words, codes=(0,)):
        """Makes sound files with the program, in `self.folder`."""
        ended = self.bench.run(Case(list(words), limit=60), self.folder)
        if ended.code not in codes:
            raise Unsound(f"{' '.join(words)}: exit code {ended.code}: {last_line(ended.err)}")
        return ended


class Bench:
    """The program."""

    def __init__(self, program, seed):
        self.program, self.seed = program, seed

    def rng(self, kind, index):
        return Random(f"{self.seed}/{kind}/{index}")

    def run(self, case, folder):
        """Runs a case to its end, or to its limit."""
        def limit_files():
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.largest_file, case.largest_file))

        device = isinstance(case.stdin, Path)
        given = open(case.stdin, "rb") if device else tempfile.TemporaryFile()
        out = open(case.stdout, "r+b", buffering=0) if case.stdout else tempfile.TemporaryFile()
        began = time.monotonic()
        with out, tempfile.TemporaryFile() as err, given:
            if not device:
                given.write(case.stdin or b"")
                given.seek(0)
            process = subprocess.Popen(
                [self.program, *case.words], cwd=folder / case.cwd, stdout=out, stderr=err, stdin=given,
                start_new_session=True, env=environment() | case.env,
                # SIGXFSZ stays ignored, so a file beyond the limit is a write error.
                restore_signals=False,
                preexec_fn=limit_files if case.largest_file is not None else None,
            )
            try:
                resource.prlimit(process.pid, resource.RLIMIT_AS, (case.memory, case.memory))
            except ProcessLookupError:
                pass
            actor = threading.Thread(target=case.during, args=(process,)) if case.during else None
            if actor:
                actor.start()
            resident = ended(process, case.limit) if not actor else 0
            hung = False
            try:
                process.wait(case.limit if actor else 0)
            except subprocess.TimeoutExpired:
                hung = True
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            seconds = time.monotonic() - began
            if actor:
                actor.join()
            printed = b"" if case.stdout else (out.seek(0), out.read())[1]
            err.seek(0)
            said = err.read().decode(errors="replace")
            return Ended(process.returncode, printed, said, hung, seconds, resident)

    def judge(self, case, ended, folder, before):
        """Defects of an ended case, as (column, text)."""
        if ended.hung:
            return [(HANG, f"did not end within {case.limit:g} s")]
        if ended.panicked and ended.code not in case.codes:
            return [(PANIC, last_line(ended.err, r"panicked at|memory allocation|overflow"))]
        found = list(case.check(ended)) + (messages(ended.err) if case.plain else [])
        if ended.code == 0 and case.refuse:
            found.append((SILENT, case.refuse))
        elif ended.code not in case.codes:
            found.append((CODE, f"allowed are {', '.join(map(str, case.codes))}: {last_line(ended.err)}"))
        # Errors of the option parser begin with `error:`.
        if ended.code in (1, 2) and not re.search(r"^(cfmmr|error): \S", ended.err, re.M):
            found.append((CODE, f"no line of standard error begins with `cfmmr:`: {last_line(ended.err)}"))
        if len(ended.err) > LONGEST_REFUSAL:
            found.append((CODE, f"{len(ended.err)} characters on standard error: {last_line(ended.err)}"))
        if ended.code == 2 and case.named and not re.search(case.named, without_names(ended.err, case.words), re.M):
            found.append((CODE, f"the refusal names neither line nor key: {last_line(ended.err)}"))
        for name, state in snapshot(folder).items():
            if before.get(name) == state:
                continue
            if ended.code == 2 and not any(re.fullmatch(pattern, name) for pattern in case.writes):
                found.append((HALF, f"refused, but wrote {name}"))
            elif name.endswith(".partial"):
                if not case.may_leave_temporary:
                    found.append((HALF, f"left {name}"))
            elif problem := incomplete(folder / name):
                found.append((HALF, f"{name}: {problem}"))
        return found


def environment():
    """Environment without the variables of a scheduler."""
    drop = ("CFMMR_", "SLURM_", "JOB_COMPLETION_")
    return {name: value for name, value in os.environ.items() if not name.startswith(drop)}


def ended(process, limit):
    """Waits for the end of a process, at most `limit` s. Returns its largest resident memory, bytes."""
    end, pause = time.monotonic() + limit, 0.001
    while time.monotonic() < end:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return usage.ru_maxrss * 1024
        time.sleep(pause)
        pause = min(pause * 1.5, 0.02)
    return 0


# Number with more digits than any value needs.
LONG_NUMBER = re.compile(r"\d{41}")
# Control characters except newline and tab, and characters that reverse the direction of text.
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def messages(text):
    """Defects of a text for people, as (column, text)."""
    found = []
    if match := LONG_NUMBER.search(text):
        found.append((CODE, f"a number of more than 40 digits: {text[max(0, match.start() - 60) : match.end()]}"))
    if match := CONTROL.search(text):
        where = text[max(0, match.start() - 40) : match.end() + 20]
        found.append((CODE, f"control character U+{ord(match[0]):04X}: {where!r}"))
    return found


def without_names(text, words):
    """Text without repeated arguments of the command."""
    for word in words:
        if isinstance(word, str) and "." in word:
            text = text.replace(word, "")
    return text


def last_line(text, pattern=r"^(cfmmr|error):"):
    """First matching line, else the last line."""
    lines = text.strip().splitlines() or ["(nothing on standard error)"]
    return next((line for line in lines if re.search(pattern, line)), lines[-1])[:200]


def snapshot(folder):
    """Regular files below a folder, by path: size and time of the last change."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            if path.is_file() and not path.is_symlink():
                found[str(path.relative_to(folder))] = (path.stat().st_size, path.stat().st_mtime_ns)
    return found


def no_constant(text):
    raise ValueError(f"{text} is no JSON")


def incomplete(path):
    """Reason why a result file is not complete, else None."""
    data = path.read_bytes()
    ends = {
        ".png": (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"),
        ".svg": (b"<", b"</svg>"),
        ".html": (b"<", b"</html>"),
        ".mcap": (b"\x89MCAP0\r\n", b"\x89MCAP0\r\n"),
    }
    if path.suffix in ends:
        first, last = ends[path.suffix]
        body = data.strip() if path.suffix in (".svg", ".html") else data
        return None if body.startswith(first) and body.endswith(last) else f"not complete, {len(data)} bytes"
    try:
        if path.suffix == ".json":
            json.loads(data, parse_constant=no_constant)
        elif path.suffix == ".jsonl":
            for line in data.decode().splitlines():
                json.loads(line, parse_constant=no_constant)
            if not data.endswith(b"\n"):
                return f"last bytes {data[-20:]!r}"
        elif path.suffix == ".toml":
            tomllib.loads(data.decode())
        elif path.suffix == ".csv":
            widths = {len(row) for row in csv.reader(io.StringIO(data.decode(), newline=""))}
            if len(widths) != 1 or not data.endswith(b"\n"):
                return f"rows of {sorted(widths)} cells, last bytes {data[-20:]!r}"
    except ValueError as error:
        return str(error)[:200]
    return None
