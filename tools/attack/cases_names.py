"""Names with unusual characters, angles, two outputs with one file, control characters."""
import os
import re
from pathlib import Path

from bench import CODE, HALF, Case, Kind, last_line, messages
from cases_text import WAYPOINTS

DRIVE = ["drive", "speed", "0.1", "0.5", "0.05"]
PARTS = ["a", "sp ace", "#1", "a#b", "se;mi", "it's", "ünï→", "日本", "a,b", "100%", "$(id)", "`x`", "a&b", "(1)", "{x}", "a=b",
         "-dash", "\\", "a\\tb", "*", "?", "~", "!", "“q”", "🤖", "[1]", "a:b", "circle 1", "stop", "e\u0301"]
QUOTES = ['quo"te', '"', '""', "'\"'"]


def name(rng):
    return "".join(rng.sample(PARTS + QUOTES, rng.choice([1, 1, 2, 3])))


class Names(Kind):
    """Files whose names contain spaces, quotes, # and other characters: the result is that of a plain name."""

    name, count = "names", 7

    def case(self, rng, index, folder):
        makes = [self.follow, self.path, self.outputs, self.script, self.in_script, self.one_word, self.scenario]
        return makes[index % len(makes)](rng, folder)

    def file(self, rng, folder, content, suffix):
        path = folder / ("./" + name(rng) + suffix)
        path.write_text(content)
        return f"./{path.name}"

    def path_file(self, rng, folder):
        return self.file(rng, folder, WAYPOINTS, ".csv")

    def follow(self, rng, folder):
        return Case(["drive", "--out", "out", "follow", self.path_file(rng, folder)], codes=(0,), plain=True)

    def path(self, rng, folder):
        return Case(["follow", "--threads", "1", "--out", "out", "--path", self.path_file(rng, folder)], codes=(0,), plain=True)

    def scenario(self, rng, folder):
        return Case(["config", "--scenario", self.file(rng, folder, "[plant]\nfriction = 0.5\n", ".toml")], codes=(0,), plain=True)

    def script(self, rng, folder):
        return Case(["drive", "--out", "out", "--script", self.file(rng, folder, "stop\n", ".txt")], codes=(0,), plain=True)

    def in_script(self, rng, folder):
        """Quoted path in a script; a quote in the name ends the word."""
        path = self.path_file(rng, folder)
        (folder / "script.txt").write_text(f'follow "{path}" # "comment"\nstop\n')
        codes = (0, 2) if '"' in path or "\\" in path else (0,)
        return Case(["drive", "--out", "out", "--script", "script.txt"], codes=codes, named="line 1", plain=True)

    def one_word(self, rng, folder):
        path = self.path_file(rng, folder)
        codes = (0, 2) if '"' in path or "\\" in path else (0,)
        return Case(["drive", "--out", "out", f'follow "{path}"'], codes=codes, named="line 1", plain=True)

    def outputs(self, rng, folder):
        """Results with unusual names."""
        out, json, log, table = (f"./{name(rng)}{suffix}" for suffix in ("", ".json", ".mcap", ".csv"))

        def check(ended):
            if ended.code != 0:
                return []
            gone = [name for name in (f"{out}/result.json", json, log, table) if not (folder / name).is_file()]
            again = self.bench.run(Case(["replay", log]), folder)
            found = [(HALF, f"not written: {gone}")] if gone else []
            return found + ([(CODE, f"replay: {again.code}: {last_line(again.err)}")] if again.code else [])

        words = [*DRIVE, "--out", out, "--json", json, "--log", log, "--csv", table]
        return Case(words, codes=(0,), check=check, plain=True)


# Text, and true if the text is an angle.
ANGLES = [
    ("90deg", True), ("90°", True), ("-90deg", True), ("90 deg", True), ("360deg", True), ("-360°", True), ("0", True),
    ("1e-3deg", True), ("1.5", True), ("-6.28", True), ("+1", True), ("361deg", False), ("6.3", False),
    ("-1e9deg", False), ("1e400", False), ("nan", False), ("nandeg", False), ("infdeg", False), ("deg", False), ("°", False),
    ("90degdeg", False), ("90°°", False), ("90d", False), ("90 rad", False), ("90rad", False), ("½", False), ("٣", False),
    ("", False), ("1,5", False), ("0x10", False), ("9" * 60, False), ("9" * 60 + "deg", False),
    ("--90deg", False), ("9 0deg", False), ("90DEG", False), ("π", False), ("90\u00ba", False),
]


class Angles(Kind):
    """Angles of goals, postures and starts."""

    name, count = "angles", 16

    def case(self, rng, index, folder):
        text, right = ANGLES[index % len(ANGLES)] if index >= len(ANGLES) else rng.choice(ANGLES)
        places = [
            ["drive", "--out", "out", "pose", "0", "0", text], ["drive", "--out", "out", f"pose 0 0 {text}"],
            ["drive", "--out", "out", "stop", "--from", f"0,0,{text}"],
            ["drive", "--out", "out", "--set", "mission.time_limit_s=0.1", "goto", "1", "0", text],
            ["posture", "--rows", "joint", "--trials", "1", "--out", "out", "--set", "mission.time_limit_s=0.1",
             f"--from=1,1,{text}"],
            ["drive", "--out", "out", "--script", "script.txt"],
        ]
        (folder / "script.txt").write_text(f"pose 0 0 {text}\n")
        place = (index + index // len(ANGLES)) % len(places)
        words = places[place]
        if not right:
            return Case(words, codes=(2,), refuse=f"{text} is no angle", limit=3, plain=True,
                        named=r"must be|expected|invalid|value is required|unexpected argument")
        # A space separates the words of a step.
        apart = " " in text and place in (1, 5)
        return Case(words, codes=(2,) if apart else (0, 1), plain=True)


OPTIONS = ["--log", "--csv", "--json", "--out"]
RESULTS = ["result.json", "report.html", "log.csv", "ends.csv", "paths.svg", "paths.png"]


class Outputs(Kind):
    """Two outputs with one file, and other things in place of results."""

    name, count = "outputs", 24

    def case(self, rng, index, folder):
        makes = [self.two, self.result, self.special, self.two, self.hard_link, self.special_option]
        return makes[index % len(makes)](rng, index, folder)

    def refused(self, words, folder, refuse, named):
        """Case that must be refused before the run, with all existing files untouched."""
        before = state(folder)

        def check(ended):
            after = state(folder)
            changed = sorted(name for name in before | after if before.get(name) != after.get(name))
            found = [(HALF, f"changed: {', '.join(changed)}")] if changed and ended.code == 2 else []
            gone = [name for name in before if name not in after or before[name][0] != after[name][0]]
            return found + ([(HALF, f"replaced: {', '.join(gone)}")] if gone and ended.code != 2 else [])

        return Case(words, codes=(2,), refuse=refuse, named=named, check=check, plain=True, limit=8)

    def two(self, rng, index, folder):
        """Two options that name one file."""
        one, other = rng.sample(OPTIONS, 2)
        exists = rng.random() < 0.5
        (folder / "sub").mkdir(), (folder / "link").symlink_to("sub")
        (folder / "out").mkdir() if rng.random() < 0.5 else None
        if exists:
            (folder / "f").write_text("kept\n")
        (folder / "to f").symlink_to("f")
        names = ["./f", "sub/../f", "link/../f", str(folder / "f"), "to f", ".//f", "gone/../f", "out/../f", "../" + folder.name + "/f"]
        second = rng.choice(names)
        words = [*DRIVE, one, "f", other, second]
        if "--out" not in (one, other):
            words += ["--out", "out"]
        return self.refused(words, folder, f"{one} f and {other} {second} are one file", rf"{one}|{other}")

    def hard_link(self, rng, index, folder):
        """Two hard links to one file: refused, or each becomes a separate file; a third link keeps its content."""
        (folder / "kept").write_text("kept\n")
        suffix = {"--log": ".mcap", "--csv": ".csv", "--json": ".json"}
        chosen = rng.sample(OPTIONS[:3], 2)
        names = [f"f{suffix[option]}" for option in chosen]
        for one in names:
            os.link(folder / "kept", folder / one)

        def check(ended):
            if (folder / "kept").read_text() != "kept\n":
                return [(HALF, "written through a hard link")]
            inodes = {(folder / one).stat().st_ino for one in names}
            return [(HALF, "both are one file")] if ended.code == 0 and len(inodes) < 2 else []

        words = [word for option, one in zip(chosen, names) for word in (option, one)]
        return Case([*DRIVE, "--out", "out", *words], codes=(0, 2), check=check, plain=True)

    def special_option(self, rng, index, folder):
        """Pipe, folder or file instead of the kind of file that an option needs."""
        option, kind = rng.choice([
            ("--log", "folder"), ("--json", "folder"), ("--log", "pipe"), ("--csv", "pipe"), ("--csv", "file"), ("--out", "pipe"),
            ("--out", "file"), ("--log", "/dev"), ("--csv", "/dev"), ("--out", "/dev"),
        ])
        path = folder / ("f.csv" if option == "--csv" and kind != "file" else "f")
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "folder":
            path.mkdir()
            (path / "kept").write_text("kept\n")
        elif kind == "file":
            path.write_text("kept\n")
        else:
            path.symlink_to("/dev/null")
        words = [*DRIVE, option, path.name] + ([] if option == "--out" else ["--out", "out"])
        case = self.refused(words, folder, f"{option} is a {kind}", option)
        # 1: a file that cannot be written.
        case.codes = (1, 2)
        return case

    def result(self, rng, index, folder):
        """Option that names a result file in --out."""
        option, result = rng.choice(OPTIONS[:3]), rng.choice(RESULTS)
        (folder / "other").mkdir(), (folder / "to").symlink_to("other")
        (folder / "out").mkdir() if rng.random() < 0.5 else None
        out, path = rng.choice([
            ("out", f"out/{result}"), ("out", f"./out/{result}"), ("to", f"other/{result}"), ("other", f"to/{result}"),
            ("out", f"other/../out/{result}"), ("out/.", f"out/{result}"), ("gone/../out", f"out/{result}"), ("new", f"new/./{result}"),
            (".", result), (str(folder / "out"), f"out/{result}"),
        ])
        return self.refused([*DRIVE, "--out", out, option, path], folder, f"{path} is a result of --out {out}", option)

    def special(self, rng, index, folder):
        """Pipe, folder or device in place of a result."""
        (folder / "out").mkdir()
        result = rng.choice(RESULTS)
        path = folder / "out" / result
        kind = rng.choice(["pipe", "folder", "full folder", "null", "tty", "zero", "dangling folder"])
        if kind == "pipe":
            os.mkfifo(path)
        elif "folder" in kind and kind != "dangling folder":
            path.mkdir()
            (path / "kept").write_text("kept\n") if kind == "full folder" else None
        elif kind == "dangling folder":
            (folder / "aside").mkdir()
            path.symlink_to("../aside")
        else:
            path.symlink_to(f"/dev/{kind}")
        return self.refused([*DRIVE, "--out", "out"], folder, f"{result} is a {kind}", re.escape(result))


def state(folder):
    """Everything below a folder: kind, size and time of files."""
    found = {}
    for place, folders, names in os.walk(folder):
        for one in folders + names:
            path = Path(place, one)
            data = path.lstat()
            file = path.is_file() and not path.is_symlink()
            found[str(path.relative_to(folder))] = (data.st_mode, os.readlink(path) if path.is_symlink() else "",
                                                    (data.st_size, data.st_mtime_ns) if file else ())
    return found


CONTROLS = ["\x1b[31m", "\x1b]0;t\x07", "\x07", "\r", "\x7f", "\x9b31m", "\u202e", "\x08", "\u2066", "\x0b", "\u200f", "\n", "\x1b[2J", "\x85"]


class Controls(Kind):
    """Control characters in names, keys, values and lines: none is printed on the terminal."""

    name, count = "controls", 24

    def case(self, rng, index, folder):
        bad = CONTROLS[index // len(self.MAKES) % len(CONTROLS)] if index >= len(self.MAKES) else rng.choice(CONTROLS)
        words = self.MAKES[index % len(self.MAKES)](folder, f"a{bad}b", bad)

        def check(ended):
            return [(column, f"standard output: {text}") for column, text in messages(ended.out.decode(errors="replace"))]

        return Case(words, check=check, plain=True, stdin=b"")

    @staticmethod
    def written(path, text):
        path.write_text(text)
        return f"./{path.name}"

    def _study(folder, text, bad):
        bad = text.encode("unicode_escape").decode().replace("\\x", "\\u00")
        Controls.written(folder / "s.toml", f'name = "{bad}"\ntrials = 1\n[scenario.mission]\ntime_limit_s = 0.1\n')
        return ["campaign", "s.toml", "--threads", "1", "--out", "out"]

    def _study_key(folder, text, bad):
        bad = text.encode("unicode_escape").decode().replace("\\x", "\\u00")
        Controls.written(folder / "s.toml", f'name = "s"\ntrials = 1\n[[vary]]\nkey = "plant.{bad}"\nvalues = [1]\n')
        return ["campaign", "s.toml", "--threads", "1", "--out", "out"]

    MAKES = [
        _study, _study_key,
        lambda folder, text, bad: ["posture", "--trials", "1", "--rows", "joint", "--set", "mission.time_limit_s=0.1", "--out", "out",
                                   "--world", Controls.written(folder / f"{text}.toml", "[plant]\nfriction = 0.5\n")],
        lambda folder, text, bad: ["follow", "--out", "out", "--path", Controls.written(folder / f"{text}.csv", WAYPOINTS)],
        lambda folder, text, bad: ["follow", "--out", "out", "--path", f"{text}.csv"],
        lambda folder, text, bad: ["config", "--set", f"plant.{text}=1"],
        lambda folder, text, bad: ["config", "--set", f"plant.friction={text}"],
        lambda folder, text, bad: ["config", "--set", f"bus.kind={text}"],
        lambda folder, text, bad: ["config", "--set", text],
        lambda folder, text, bad: ["drive", "--out", "out", "--script", Controls.written(folder / "s.txt", f"stop\n{text} 1\n")],
        lambda folder, text, bad: ["drive", "--out", "out", "--script", Controls.written(folder / "s.txt", f"goto 1 {bad} 2\n")],
        lambda folder, text, bad: ["drive", "--out", "out", "--script", Controls.written(folder / "s.txt", f'stop # {text}\nfollow "{text}"\n')],
        lambda folder, text, bad: ["drive", "--out", "out", "stop", text],
        lambda folder, text, bad: ["drive", "--out", "out", "follow", Controls.written(folder / f"{text}.csv", WAYPOINTS)],
        lambda folder, text, bad: ["drive", "stop", "--out", f"./{text}"],
        lambda folder, text, bad: ["drive", "stop", "--out", "out", "--log", f"{text}.mcap", "--json", f"{text}.json", "--csv", f"./{text}"],
        lambda folder, text, bad: ["config", "--scenario", Controls.written(folder / "s.toml", f'[plant]\n"{text}" = 1\n')],
        lambda folder, text, bad: ["config", "--scenario", Controls.written(folder / f"{text}.toml", f"[plant]\nx = 1\n")],
        lambda folder, text, bad: ["config", "--scenario", Controls.written(folder / "s.toml", f'[plant]\nfriction = {text}\n')],
        lambda folder, text, bad: ["config", "--scenario", Controls.written(folder / "s.toml", f'[plant]\nfriction = "{text}"\n')],
        lambda folder, text, bad: ["world", text],
        lambda folder, text, bad: ["replay", Controls.written(folder / f"{text}.mcap", "x")],
        lambda folder, text, bad: [text],
        lambda folder, text, bad: ["posture", f"--{text}"],
        lambda folder, text, bad: ["posture", "--rows", text],
        lambda folder, text, bad: ["drive", "stop", "--from", f"0,{text},0"],
        lambda folder, text, bad: ["posture", "--kill", f"{text}@1"],
        lambda folder, text, bad: ["posture", "--on", f"serial:{text}=x"],
        lambda folder, text, bad: ["posture", "--on", f"serial:front={text}", "--log", "x"],
        lambda folder, text, bad: ["params", "get", text],
        lambda folder, text, bad: ["params", "set", f"{text}=1"],
        lambda folder, text, bad: ["eval", text],
        lambda folder, text, bad: ["faults", "--only", text],
        lambda folder, text, bad: ["campaign", "merge", f"./{text}"],
        lambda folder, text, bad: ["campaign", "status", f"./{text}"],
        lambda folder, text, bad: ["campaign", "s.toml", "--shard", text],
        lambda folder, text, bad: ["completions", text],
        lambda folder, text, bad: ["follow", "--out", "out", "--path", Controls.written(folder / "p.csv", f"x,y\n0,0\n{text},1\n")],
    ]
