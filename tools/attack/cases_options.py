"""Wrong options, and inputs that are not regular files."""
import os
import re
from pathlib import Path

from bench import MEMORY, Case, Kind
from cases_text import WAYPOINTS

NASTY = [
    "", " ", "-", "-1", "0", "-0", "nan", "inf", "1e99", "1e-320", "9" * 23, "9" * 5000, "x" * 100_000, "ünï→", "\u202e",
    "a\nb", b"\xff\xfe", "../escape", "../../escape", "..", ".", "a/b/c", "=", "a=b", "a=b=c", "1,2,3", "nan,nan,nan",
    ",", "0/0", "3/2", "front@nan", "front@-1", "nobody@1", "front@", "serial:", "serial:front=", "serial:front=gone",
    "serial:front=a,front=a", "serial:x=y", "%s%n", "$(id)", "~", "--", "--help=1", "mission.rps", "plant.friction=nan",
    "robot=1", "mission.start=[1]", ".=1", "a..b=1", "==", "[x]=1",
]
# Options that shorten a run, added if not drawn.
COMMANDS = {
    "posture": ["--trials 1", "--rows joint", "--threads 1", "--set mission.time_limit_s=1"],
    "follow": ["--path line", "--size 0.1", "--threads 1"],
    "track": ["--path line", "--size 0.1", "--threads 1"],
    "drive": ["stop"],
    "hil": [],
    "replay": ["gone.mcap"],
    "campaign": ["gone.toml"],
    "campaign merge": ["gone"],
    "campaign status": ["gone"],
    "consistency": ["--trials 2", "--fusion odometry", "--threads 1"],
    "paper": ["--trials 1", "--threads 1"],
    "glossary": ["claim"],
    "eval": ["rps"],
    "parameters": [],
    "params list": [],
    "params get": ["button.action"],
    "params set": ["button.action=1"],
    "params export": [],
    "params import": ["gone.toml"],
    "calibrate": ["gauges", "--laps 1"],
    "codes": [], "topics": [], "serial": [], "config": [], "doctor": [], "dbc": [],
    "world": ["ordinary"],
    "faults": ["--only none", "--seeds 1", "--threads 1"],
    "soak": ["--ticks 10000"],
    "completions": ["bash"],
}
# Not drawn: a short text for --only would start many faults.
NOT_DRAWN = {"--only", "--help", "--version"}


class Options(Kind):
    """Options of every command with invalid values."""

    name, count = "options", 60

    def prepare(self):
        self.options = {}
        for command in COMMANDS:
            text = self.sound(*command.split(), "--help").out.decode()
            found = re.findall(r"(?m)^\s+(?:-\w, )?(--[a-z-]+)(?: (\[?<[^>]+>\]?))?", text)
            self.options[command] = [(option, value) for option, value in found if option not in NOT_DRAWN]

    def case(self, rng, index, folder):
        command = list(COMMANDS)[index % len(COMMANDS)]
        words, drawn = command.split(), set()
        options = self.options[command]
        for option, value in rng.sample(options, min(len(options), rng.choice([1, 1, 2, 3]))):
            drawn.add(option)
            chosen = rng.choice(NASTY)
            # These values are valid for --live, and the server would wait.
            if option == "--live" and chosen in ("", "0", "-0", "--"):
                chosen = "nan"
            if value:
                words += rng.choice([[option, chosen]] * 3 + [joined(option, chosen)])
            else:
                words.append(option)
            if rng.random() < 0.1:
                words += [option, chosen] if value else [option]
        ends = []
        for base in COMMANDS[command]:
            option, _, value = base.partition(" ")
            if not option.startswith("--"):
                ends.append(rng.choice(NASTY) if rng.random() < 0.3 else base)
            elif option not in drawn or option == "--set":
                words += [option, value]
        (folder / "a" / "b" / "c").mkdir(parents=True)
        return Case(words + ends, cwd="a/b/c", stdin=b"")


def joined(option, value):
    """An option and its value in one word."""
    return [option.encode() + b"=" + value] if isinstance(value, bytes) else [f"{option}={value}"]


IMAGES = ["--on", "virtual", "--axle-image", "F", "--beam-image", "F"]
# Command, content of a good file (a file of `prepare`), and exit codes of an empty file.
FILES = {
    "--scenario": (["config", "--scenario", "F"], "scenario.toml", (0,)),
    "--world": (["config", "--world", "F"], "world.toml", (0,)),
    "world": (["world", "F"], "world.toml", (0,)),
    "--path": (["follow", "--threads", "1", "--out", "out", "--path", "F"], "path.csv", (2,)),
    "replay": (["replay", "F"], "log.mcap", (2,)),
    "--with": (["replay", "log.mcap", "--with", "F"], "with.toml", (2,)),
    "campaign": (["campaign", "F", "--threads", "1", "--out", "out"], "study.toml", (2,)),
    "--script": (["drive", "--out", "out", "--script", "F"], "script.txt", (2,)),
    "drive follow": (["drive", "--out", "out", "follow", "F"], "path.csv", (2,)),
    "import": (["params", "import", "F", "--flash", "flash"], "exported.toml", (0, 2)),
    "merge": (["campaign", "merge", "F"], "study", (2,)),
    "status": (["campaign", "status", "F"], "study", (2,)),
    "--axle-image": (["posture", *IMAGES], None, (2,)),
    "faults image": (["faults", "--only", "none", *IMAGES], None, (2,)),
}
# Name, and a function that makes the wrong file from the good file.
WRONG = {
    "pipe": lambda path, good: os.mkfifo(path),
    "/dev/zero": lambda path, good: path.symlink_to("/dev/zero"),
    "/dev/null": lambda path, good: path.symlink_to("/dev/null"),
    "folder": lambda path, good: path.mkdir(),
    "dangling link": lambda path, good: path.symlink_to("gone"),
    "link to itself": lambda path, good: path.symlink_to(path.name),
    "good link": lambda path, good: path.symlink_to(good),
    "empty file": lambda path, good: path.write_bytes(b""),
    "name of no text": lambda path, good: path.symlink_to(good),
    "9 MiB of spaces": lambda path, good: path.write_bytes(b" " * (9 << 20)),
    "name too long": lambda path, good: None,
}


class Inputs(Kind):
    """Every argument that names a file, with a wrong kind of file or an unusual file."""

    name = "inputs"

    def total(self, times):
        return len(FILES) * len(WRONG) + 1

    def prepare(self):
        write = lambda name, content: (self.folder / name).write_bytes(content)
        write("scenario.toml", self.sound("config").out)
        write("world.toml", self.sound("world", "ordinary", "--toml").out)
        write("with.toml", b"[robot.lead.fusion.joint]\nscale_sigma = 0.001\n")
        write("path.csv", WAYPOINTS.encode())
        write("script.txt", b"stop\n")
        write("study.toml", b'name = "s"\ntrials = 1\n[scenario.mission]\ntime_limit_s = 1.0\n')
        self.sound("campaign", "study.toml", "--out", "study", "--threads", "1")
        self.sound("drive", "stop", "--out", "out", "--log", "log.mcap")
        self.sound("params", "export", "--all", "--flash", "flash", "--out", "exported.toml")

    def case(self, rng, index, folder):
        if index == len(FILES) * len(WRONG):
            refuse = "a line without end"
            return Case(["eval", "rps"], codes=(1, 2), refuse=refuse, stdin=Path("/dev/zero"), memory=512 << 20)
        name, wrong = list(FILES)[index // len(WRONG)], list(WRONG)[index % len(WRONG)]
        words, good, empty = FILES[name]
        path = folder / ("x" * 300 if wrong == "name too long" else "file" + (os.path.splitext(good or "")[1]))
        good = self.folder / (good or "log.mcap")
        if wrong == "name of no text":
            path = folder / os.fsdecode(b"\xff\xfe" + os.fsencode(path.name))
        WRONG[wrong](path, good)
        if "log.mcap" in words:
            (folder / "log.mcap").symlink_to(self.folder / "log.mcap")
        words = [os.fsencode(path.name) if word == "F" else word for word in words]
        codes = {"good link": (0,), "name of no text": (0, 2), "empty file": empty}.get(wrong, (2,))
        # A run on virtual boards needs a board's image, so a link to the log is refused too.
        image = "virtual" in words
        if image or name in ("merge", "status") and wrong == "folder":
            codes = (2,)
        refuse = "" if 0 in codes else f"{wrong} as {name}"
        return Case(words, codes=codes, refuse=refuse, memory=(512 << 20 if image else MEMORY), limit=5)
