"""Keys of a scenario: constants without a key, whole numbers, misspelled keys, distributions, configured values."""
import csv
import re
import string
import tomllib
from pathlib import Path

from bench import CODE, SILENT, Case, Kind, Unsound, last_line

DOCS = Path(__file__).resolve().parents[2] / "docs"
UNKNOWN = r"unknown key; (did you mean|nearest keys:)"
DRIVE = ["drive", "speed", "0.1", "0.5", "0.3", "--out", "out"]
POSTURE = ["posture", "--rows", "joint", "--trials", "3", "--threads", "1", "--out", "out"]
SHORT = ["--set", "mission.time_limit_s=0.2"]


def entries(table, path=""):
    """Keys of a scenario with their values."""
    found = {}
    for name, value in table.items():
        at = f"{path}.{name}" if path else name
        found |= entries(value, at) if isinstance(value, dict) else {at: value}
    return found


def is_whole(value):
    return isinstance(value, int) and not isinstance(value, bool)


def shown(value):
    """A value as TOML."""
    if isinstance(value, list):
        return f"[{', '.join(map(shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def scaled(value, factor):
    """Number, or all numbers of a list, times a factor."""
    if isinstance(value, list):
        return [scaled(item, factor) for item in value]
    return round(value * factor) if is_whole(value) else value * factor


class Keyed(Kind):
    def prepare(self):
        self.keys = entries(tomllib.loads(self.sound("config").out.decode()))

    def ranges(self, keys):
        """Range of each key, read from the error of a value beyond the range; keys without a range are left out."""
        found = {}
        for key in keys:
            ended = self.bench.run(Case(["config", "--set", f"{key}={shown(scaled_to(self.keys[key], 1e30))}"]), self.folder)
            if match := re.search(r"must be a number from (\S+) to ([\d.e+-]+)", ended.err):
                found[key] = float(match[1]), float(match[2])
        return found


def scaled_to(value, number):
    """Value of equal shape with another number."""
    return [scaled_to(item, number) for item in value] if isinstance(value, list) else number


class Constants(Keyed):
    """Constants without a key, and the number of substeps."""

    name, count = "constants", 10
    GONE = [
        "plant.step_s", "robot.lead.governor.max_interval_s", "robot.axle.wheel.interval_s",
        "robot.lead.regulator.tick_s",
    ]
    # Tolerance of encoder counts after 0.3 s, in which 0.03 m give 536 counts.
    TOLERANCE = 6

    def prepare(self):
        super().prepare()
        self.sound(*DRIVE, "--csv", "tables")
        self.travel = self.counts(self.folder)

    def counts(self, folder):
        """Last counts of each encoder."""
        rows = list(csv.DictReader((folder / "tables" / "axles.csv").open()))[-2:]
        return [int(row[f"encoder[{side}]"]) for row in rows for side in (0, 1)]

    def case(self, rng, index, folder):
        if index % 2:
            return self.substeps(rng, index, folder)
        key = self.GONE[index // 2 % len(self.GONE)]
        value = rng.choice(["0.001", "1", "0", "-1", "nan", '"x"', "[]", "{}", "true", "9" * 60])
        words = [rng.choice([["config"], DRIVE, POSTURE])]
        if rng.random() < 0.5:
            words = [*words[0], "--set", f"{key}={value}"]
        else:
            table, _, name = key.rpartition(".")
            (folder / "s.toml").write_text(f"[{table}]\n{name} = {value if len(value) < 20 else 1}\n")
            words = [*words[0], "--scenario", "s.toml"]
        return Case(words, codes=(2,), refuse=f"{key} is a constant", named=UNKNOWN, limit=3, plain=True)

    def substeps(self, rng, index, folder):
        edges = [1, 2, 100, 0, 101, -1, 1.5, 2**31, 10**60, rng.randrange(1, 101), rng.randrange(1, 101)]
        value = edges[index // 2 % len(edges)]
        words = [*DRIVE, "--set", f"plant.substeps={value}", "--csv", "tables"]
        if not (is_whole(value) and 1 <= value <= 100):
            named = r"plant\.substeps.*(from 1 to 100|whole number)"
            return Case(words, codes=(2,), refuse="out of range", named=named, limit=3, plain=True)

        def check(ended):
            if ended.code != 0:
                return []
            counts = self.counts(folder)
            far = max(abs(a - b) for a, b in zip(counts, self.travel))
            return [(SILENT, f"encoders {counts}, with one substep {self.travel}")] if far > self.TOLERANCE else []

        return Case(words, codes=(0,), check=check, plain=True)


class Spreads(Keyed):
    """Distributions at the edges of their ranges: refused before the run, or every trial runs."""

    name, count = "spreads", 12
    MEANS = [
        "plant.tyre.brush.slip_stiffness", "plant.bending_stiffness_n_m2", "plant.strip_length_m", "plant.wheel_radius_m",
        "plant.half_track_m", "plant.friction", "plant.backlash_rad", "plant.side_slip", "plant.carpet_drift",
        "plant.radius_load_sensitivity", "plant.mass_kg",
    ]

    def prepare(self):
        super().prepare()
        own = [key for key in self.keys if key.startswith("spread.") or "sigma" in key and key.startswith("sensors.")]
        self.spread = self.ranges(own)
        self.mean = self.ranges([key for key in self.MEANS if key in self.keys])
        if len(self.spread) < 8 or len(self.mean) < 5:
            raise Unsound(f"ranges of {sorted(self.spread | self.mean)} only")

    def edge(self, rng, low, high):
        """Value at an edge, next to an edge, or between the edges."""
        step = rng.choice([0, 1e-9, 1e-6, 0.01, 0.3]) * (high - low) * rng.choice([1, 1, 1, -1])
        return rng.choice([low + step, high - step, high - step, low + (high - low) * rng.random()])

    def drawn(self, rng):
        """Values of randomly chosen keys."""
        spread = {key: rng.choice([self.spread[key][1], self.edge(rng, *self.spread[key])])
                  for key in rng.sample(sorted(self.spread), rng.choice([1, 1, 2, 4]))}
        mean = {}
        for key in rng.sample(sorted(self.mean), rng.choice([0, 1, 1, 2])):
            low, high = self.mean[key]
            # Largest factor at which five standard deviations of a relative spread stay in the range.
            five = 1 + 5 * max([spread.get("sensors.geometry.wheel_radius_sigma", 0.003), *spread.values()], default=0)
            mean[key] = rng.choice([self.edge(rng, low, high), high / five, low * five, (low + high) / 2])
        return spread | mean

    def case(self, rng, index, folder):
        drawn = self.drawn(rng)
        if index % 2:
            return self.campaign(rng, drawn, folder)
        sets = [f"{key}={shown(scaled_to(self.keys[key], value))}" for key, value in drawn.items()]
        words = ["posture", "--rows", "joint", "--trials", "20", "--seed", str(rng.randrange(1000)), *SHORT]
        words += ["--threads", "1", "--out", "out", *(word for one in sets for word in ("--set", one))]
        return self.judged(words, drawn)

    def campaign(self, rng, drawn, folder):
        # A list has no distribution.
        numbers = [key for key in self.spread | self.mean if not isinstance(self.keys[key], list)]
        key = rng.choice(sorted(numbers))
        low, high = (self.spread | self.mean)[key]
        a, b = sorted(self.edge(rng, low, high) for _ in range(2))
        law = rng.choice([f"uniform = [{a!r}, {b!r}]", f"log_uniform = [{a!r}, {b!r}]", f"normal = [{a!r}, {b - a!r}]",
                          f"normal = [{(a + b) / 2!r}, {(b - a) / 10!r}]", f"normal = [{a!r}, {(high - low) / 5!r}]"])
        tables = {}
        for other, value in drawn.items():
            table, _, name = other.rpartition(".")
            if other != key:
                tables.setdefault(table, []).append(f"{name} = {shown(scaled_to(self.keys[other], value))}")
        text = f'name = "s"\ntrials = 20\nblock = 1\n[[vary]]\nkey = "{key}"\n{law}\n[scenario.mission]\ntime_limit_s = 0.2\n'
        text += "".join(f"[scenario.{table}]\n" + "\n".join(lines) + "\n" for table, lines in tables.items())
        (folder / "study.toml").write_text(text)
        return self.judged(["campaign", "study.toml", "--threads", "1", "--out", "out"], {key: 0, **drawn})

    def judged(self, words, drawn):
        def check(ended):
            found = []
            if ended.code == 2 and ended.seconds > 3:
                found.append((CODE, f"refused after {ended.seconds:.1f} s: {last_line(ended.err)}"))
            if ended.code != 2 and re.search(r"must be (a number )?(from|at|above|below)", ended.err):
                found.append((CODE, f"a range error of a run: {last_line(ended.err, 'must be')}"))
            return found

        names = "|".join(re.escape(key) for key in drawn)
        return Case(words, codes=(0, 1, 2), named=rf"({names}|vary|plant\.\w+)", check=check, plain=True)


class Pairs(Keyed):
    """Quantities with a key for the true and one for the configured value: a notice if only one of them is changed."""

    name, count = "pairs", 6
    COMMANDS = [["drive", "stop"], ["posture", "--rows", "joint", "--trials", "1", *SHORT], ["follow", "--path", "line", "--size", "0.1"]]

    def pairs(self):
        part = (DOCS / "worlds.md").read_text().partition("## Truth and belief")[2]
        return re.findall(r"(?m)^\| `([^`]+)` \| `([^`]+)` \|$", part.partition("\n## ")[0])

    def prepare(self):
        super().prepare()
        if not self.pairs():
            raise Unsound("no pairs in docs/worlds.md")

    def case(self, rng, index, folder):
        pairs = self.pairs()
        truth, belief = pairs[index % len(pairs)]
        which = (index + index // len(pairs)) % 3
        factor = 1.02 if which != 2 else 1.01
        changed = [[truth], [belief], [truth, belief]][which]
        value = lambda key: 0.001 if "rigid" in key else scaled(self.keys[key], factor)
        # One configured value applies to both rigid ends.
        if which == 2 and "rigid" in truth:
            changed = ["plant.rigid_root_m", "plant.rigid_tip_m", belief]
        words = [*rng.choice(self.COMMANDS[:1] * 3 + self.COMMANDS), "--threads", "1", "--out", "out"]
        words += [word for key in changed for word in ("--set", f"{key}={shown(value(key))}")]

        def check(ended):
            noticed = any(truth in line and belief in line for line in ended.err.splitlines())
            if ended.code == 2 or noticed == (which != 2):
                return []
            return [(SILENT, f"{'no' if which != 2 else 'a'} notice on {truth} and {belief}: {last_line(ended.err)}")]

        return Case(words, codes=(0, 1), check=check, plain=True)


class Whole(Keyed):
    """Negative numbers and fractions for whole-number keys."""

    name, count = "whole", 12

    def prepare(self):
        super().prepare()
        self.whole = [key for key, value in self.keys.items() if is_whole(value)]

    def case(self, rng, index, folder):
        key = rng.choice(self.whole)
        value = rng.choice(["-1", "-9223372036854775808", "0.5", "1.5", "-0.5", "1e3", "9223372036854775808", "9" * 50, "1e300", "nan"])
        words = [*rng.choice([["config"], DRIVE]), "--set", f"{key}={value}"]
        return Case(words, codes=(2,), refuse=f"{key} = {value}", named=re.escape(key) + r".*(expected|must be|from|whole)",
                    limit=3, plain=True)


class Misspelled(Keyed):
    """One wrong character in a key: at least nine of ten refusals name the right key."""

    name, count = "misspelled", 1
    SAMPLE, SHARE = 40, 0.9

    def case(self, rng, index, folder):
        """Case of the last key of the sample; check runs the others."""
        sample = [self.typo(rng, rng.choice(list(self.keys))) for _ in range(self.SAMPLE)]

        def check(ended):
            missed = []
            for wrong, key in sample:
                ended = self.bench.run(Case(["config", "--set", f"{wrong}=1"]), folder)
                if ended.code != 2 or f" {key}" not in ended.err.replace("?", "").replace(",", ""):
                    missed.append(f"{wrong} (for {key}): exit code {ended.code}: {last_line(ended.err)}")
            many = len(missed) > (1 - self.SHARE) * len(sample)
            return [(CODE, f"{len(missed)} of {len(sample)} refusals do not name the key: {'; '.join(missed)}")] if many else []

        return Case(["config", "--set", "nobody=1"], codes=(2,), check=check, refuse="unknown key")

    def typo(self, rng, key):
        """Misspelled key: a character removed, doubled, replaced or exchanged, and not another key."""
        while True:
            at = rng.randrange(len(key) - 1)
            wrong = rng.choice([
                key[:at] + key[at + 1 :], key[:at] + key[at] + key[at:],
                key[:at] + rng.choice(string.ascii_lowercase) + key[at + 1 :],
                key[:at] + key[at + 1] + key[at] + key[at + 2 :],
            ])
            if wrong not in self.keys and "." not in (key[at], key[at + 1]) and ".." not in wrong:
                return wrong, key
