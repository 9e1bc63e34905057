"""Large sparse files, waypoints of other programs, damaged logs that are recovered."""
import signal
import time

from bench import CODE, HALF, Case, Kind, last_line
from cases_logs import append, cut, flip, overwrite

DRIVE = ["drive", "--out", "out"]
FOLLOW = ["follow", "--threads", "1", "--out", "out", "--path"]


class Sizes(Kind):
    """Sparse files of gigabytes instead of each input."""

    name, count = "sizes", 14
    parallel = 1
    # Largest resident memory of a refusal, bytes.
    RESIDENT = 200 << 20
    PLACES = {
        "path": ([*FOLLOW, "F"], "f.csv"), "step": ([*DRIVE, "follow", "F"], "f.csv"),
        "scenario": (["config", "--scenario", "F"], "f.toml"), "world": (["config", "--world", "F"], "f.toml"),
        "script": ([*DRIVE, "--script", "F"], "f.txt"), "in a script": ([*DRIVE, "follow 'F'"], "f.csv"),
        "study": (["campaign", "F", "--out", "out"], "f.toml"), "log": (["replay", "F"], "f.mcap"),
        "recover": (["replay", "F", "--recover"], "f.mcap"), "with": (["replay", "log.mcap", "--with", "F"], "f.toml"),
        "block": (["campaign", "merge", "study", "--out", "out"], "study/block-000000.jsonl"),
        "status": (["campaign", "status", "study"], "study/block-000000.jsonl"),
        "axle image": (["posture", "--on", "virtual", "--axle-image", "F", "--beam-image", "F", "--out", "out"], "f.elf"),
        "parameters": (["params", "import", "F", "--flash", "flash"], "f.toml"),
        "flash": (["params", "list", "--flash", "F"], "f.flash"),
    }

    def total(self, times):
        return max(len(self.PLACES), super().total(times))

    def prepare(self):
        (self.folder / "s.toml").write_text('name = "s"\ntrials = 1\n[scenario.mission]\ntime_limit_s = 0.1\n')
        self.sound("campaign", "s.toml", "--threads", "1", "--out", "study")
        self.sound("drive", "stop", "--out", "out", "--log", "log.mcap")

    def case(self, rng, index, folder):
        name = list(self.PLACES)[index % len(self.PLACES)]
        words, path = self.PLACES[name]
        size = rng.choice([3 << 30, (4 << 30) + 1, 8 << 30, 20 << 30])
        (folder / "study").mkdir()
        for one in (self.folder / "study").iterdir():
            (folder / "study" / one.name).write_bytes(one.read_bytes())
        (folder / "log.mcap").symlink_to(self.folder / "log.mcap")
        path = folder / path
        # A file that begins as a log is recovered, whatever follows.
        beginning = b"" if name == "recover" else rng.choice([b"", self.begin(path)])
        with path.open("wb") as file:
            file.write(beginning)
            file.truncate(size)

        def check(ended):
            found = []
            if ended.resident > self.RESIDENT:
                found.append((CODE, f"{name}, {size >> 30} GiB: {ended.resident >> 20} MiB resident"))
            if ended.seconds > 5:
                found.append((CODE, f"{name}, {size >> 30} GiB: ended after {ended.seconds:.1f} s"))
            return found

        words = [word.replace("F", path.name) if word in ("F", "follow 'F'") else word for word in words]
        # A block of this size is invalid: status counts it as missing.
        codes = (0, 1, 2) if name in ("block", "status", "recover") else (2,)
        return Case(words, codes=codes, refuse="" if 0 in codes else f"{name} of {size >> 30} GiB", check=check, plain=True,
                    memory=2 << 30)

    def begin(self, path):
        """Beginning of a sound file with this suffix."""
        return {".csv": b"x,y\n0,0\n0.05,0\n", ".mcap": (self.folder / "log.mcap").read_bytes(), ".txt": b"stop\n",
                ".toml": b"\n", ".elf": b"\x7fELF\1\1\1" + bytes(9) + b"\2\0\x28\0", ".jsonl": b"{\n"}.get(path.suffix, b"")


class Recover(Kind):
    """`replay --recover` of damaged logs and of the unfinished logs of killed runs."""

    name, count = "recover", 20

    def prepare(self):
        self.sound("drive", "speed", "0.1", "0.5", "0.3", "--log", "x.mcap", "--out", "out")
        self.log = (self.folder / "x.mcap").read_bytes()

    def case(self, rng, index, folder):
        if index % 5 == 4:
            return self.killed(rng, folder)
        damage = [cut, flip, append, overwrite][index % 5]
        data = self.log
        for _ in range(rng.choice([1, 1, 2])):
            data = damage(data, rng)
        (folder / "x.mcap").write_bytes(data)
        plain = index // 5 % 3 == 2
        changed = data != self.log
        if plain and changed:
            return Case(["replay", "x.mcap"], codes=(2,), refuse=damage.__name__, plain=True)
        words = ["replay", "x.mcap", "--recover"] + rng.choice([[], ["--out", "new.mcap"], ["--json", "x.json"]])
        return Case(words, codes=(0, 1, 2), check=lambda ended: self.again(ended, folder, "x.mcap", data), plain=True,
                    writes=(r".*\.mcap",))

    def again(self, ended, folder, name, data):
        """Checks that the log is unchanged, and that the recovered log replays or is refused cleanly."""
        found = []
        if (folder / name).read_bytes() != data:
            found.append((HALF, "the damaged log was changed"))
        for new in [path for path in folder.glob("*.mcap") if path.name != name]:
            again = self.bench.run(Case(["replay", new.name]), folder)
            if again.panicked or again.hung or again.code not in (0, 1, 2):
                found.append((CODE, f"replay of {new.name}: exit code {again.code}: {last_line(again.err)}"))
            elif ended.code == 0 and again.code != 0:
                found.append((CODE, f"replay of {new.name} after exit code 0: {again.code}: {last_line(again.err)}"))
        return found

    def killed(self, rng, folder):
        """Kills a run and recovers its unfinished log."""
        at = 0.1 + rng.random() * 0.8

        def during(process):
            time.sleep(at)
            process.kill()

        def check(ended):
            partial = list(folder.glob(".x.mcap.*.partial"))
            if ended.code >= 0 or not partial:
                return []
            data = partial[0].read_bytes()
            words = ["replay", partial[0].name, "--recover", "--out", "new.mcap"]
            recovered = self.bench.run(Case(words), folder)
            found = self.again(recovered, folder, partial[0].name, data)
            if recovered.panicked or recovered.hung or recovered.code not in (0, 1, 2):
                found.append((CODE, f"recover after {at:.2f} s: exit code {recovered.code}: {last_line(recovered.err)}"))
            # The last chunk may be missing, but not the whole run.
            if len(data) > 200_000 and recovered.code != 0:
                found.append((CODE, f"{len(data)} bytes, not recovered: {recovered.code}: {last_line(recovered.err)}"))
            return found

        return Case(["follow", "--threads", "1", "--out", "out", "--log", "x.mcap", "--laps", "20"], codes=(-signal.SIGKILL, 0),
                    during=during, check=check, may_leave_temporary=True)


POINTS = [(0, 0), (0.05, 0), (0.1, 0.001), (0.15, 0.003)]
# Separator, and words of its error.
SEPARATORS = {",": "", ";": "separator ;", "\t": "separator tab", " ": "separator space", "|": "field", ":": "field"}


class Separators(Kind):
    """Waypoints with separators of other programs: accepted if documented, else the error names the separator."""

    name, count = "separators", 16

    def case(self, rng, index, folder):
        separator = list(SEPARATORS)[index % len(SEPARATORS)]
        head = rng.choice([["x", "y"], ["x_m", "y_m"], ["X", "Y"], None])
        rows = ([head] if head else []) + [[f"{x:g}", f"{y:g}"] for x, y in POINTS]
        quoted, decimal = rng.random() < 0.3, rng.random() < 0.3
        if decimal:
            rows = [[cell.replace(".", ",") for cell in row] for row in rows]
        if quoted:
            rows = [[f'"{cell}"' for cell in row] for row in rows]
        end = rng.choice(["\n", "\r\n", "\n\n"])
        text = end.join(separator.join(row) for row in rows) + rng.choice(["", end])
        if rng.random() < 0.2:
            text = text.replace(separator, f"{separator} " if separator == "," else separator)
        data = rng.choice([b"", b"", b"\xef\xbb\xbf"]) + text.encode()
        (folder / "p.csv").write_bytes(data)
        right = separator == "," and not decimal
        words = rng.choice([[*FOLLOW, "p.csv"], [*DRIVE, "follow", "p.csv"]])
        if right:
            return Case(words, codes=(0,), plain=True)
        named = SEPARATORS[separator] or "comma|quote|decimal|field"
        return Case(words, codes=(2,), refuse=f"separator {separator!r}, decimal comma {decimal}", named=rf"line \d+.*{named}",
                    plain=True, limit=5)
