"""Wrong text: TOML files, waypoints, JSON lines."""
import json
import re

from bench import CODE, SILENT, Case, Kind

VALUES = [
    "nan", "inf", "-inf", "-0.0", "1e308", "1e-320", "1e39", "-1", "0", "9" * 23, "9007199254740993", '"text"', '""',
    "true", "[]", "[1, 2]", "[[[1]]]", "{}", "{ a = 1 }", "1979-05-27", "'", '"""', "", "x",
]
NOT_FINITE = {"nan", "inf", "-inf"}
# A line number, a key of a scenario or table, or a quoted name.
NAMED = (
    r"line \d+|\b[a-z_]+\.[a-z_0-9.\[\]]+|`[^`]+`|^cfmmr: robot: \w+ = |not UTF-8|larger than"
    r"|^cfmmr: (scenario|world|study|mission|vary|placement|spread|plant)\b"
)


STUDY = """name = "s"
seed = 3
trials = 2
block = 1
starts = "random"
[[vary]]
key = "plant.friction"
values = [0.4, 0.6]
[[vary]]
key = "sensors.placement.heading_sigma_rad"
uniform = [0.0, 0.01]
[scenario.mission]
time_limit_s = 1.0
"""


class Toml(Kind):
    """Scenarios, worlds and studies."""

    name, count = "toml", 100

    def prepare(self):
        scenario = self.sound("config").out.decode()
        self.texts = {
            "scenario": re.sub(r"(?m)^time_limit_s = .*", "time_limit_s = 1.0", scenario),
            "world": self.sound("world", "ordinary", "--toml").out.decode(),
            "study": STUDY,
        }

    def case(self, rng, index, folder):
        which = rng.choice(["scenario", "scenario", "world", "study"])
        text, refuse = self.texts[which], ""
        changes = [
            self.value, self.value, self.value, self.element, self.delete, self.double, self.swap, self.nested,
            self.bytes, self.unknown,
        ]
        change = changes[index % len(changes)]
        data, refuse = change(text.splitlines(keepends=True), rng)
        data = data if isinstance(data, bytes) else data.encode()
        (folder / "file.toml").write_bytes(data)
        # For long texts the program does not search the line of a value nested too deeply.
        named = NAMED + ("|recursion limit" if len(data) > 100_000 else "")
        run = ["posture", "--rows", "joint", "--trials", "1", "--threads", "1", "--out", "out"]
        option = [f"--{which}", "file.toml"]
        words = ["config", *option] if rng.random() < 0.67 else [*run, *option]
        if which == "study":
            words = ["campaign", "file.toml", "--out", "out", "--threads", "1"]
        elif which == "world":
            words += ["--set", "mission.time_limit_s=1"]

        def check(ended):
            key = re.search(r"^cfmmr: robot: (\w+) = ", ended.err)
            tables = re.findall(r"(?ms)^\[robot\..*?(?=^\[|\Z)", text)
            count = sum(f"\n{key[1]} = " in table for table in tables) if key and ended.code == 2 else 0
            what = f"the refusal names {key[1]}, which {count} tables have" if count > 1 else ""
            return [(CODE, f"{what}: {ended.err.strip()[:200]}")] if what else []

        return Case(words, refuse=refuse, named=named, limit=8, check=check)

    def keys(self, lines):
        return [i for i, line in enumerate(lines) if re.match(r"\w+ = \S", line) and not line.rstrip().endswith("[")]

    def value(self, lines, rng):
        place, value = rng.choice(self.keys(lines)), rng.choice(VALUES)
        key = lines[place].split(" = ")[0]
        lines[place] = f"{key} = {value}\n"
        return "".join(lines), f"{key} = {value} was accepted" if value in NOT_FINITE else ""

    def element(self, lines, rng):
        """Replaces a number in a line."""
        places = [i for i, line in enumerate(lines) if re.search(r"\d", line) and not line.startswith(("#", "["))]
        place, value = rng.choice(places), rng.choice(VALUES)
        number = rng.choice(list(re.finditer(r"-?\d[\d.e+-]*", lines[place])))
        line = lines[place][: number.start()] + value + lines[place][number.end() :]
        changed, lines[place] = lines[place] != line, line
        in_text = "name" in line or "#" in line or '"' in line
        wrong = value in NOT_FINITE and changed and not in_text
        return "".join(lines), f"{line.strip()} was accepted" if wrong else ""

    def delete(self, lines, rng):
        del lines[rng.randrange(len(lines))]
        return "".join(lines), ""

    def double(self, lines, rng):
        """Repeats a key."""
        place = rng.choice(self.keys(lines))
        lines.insert(place, lines[place])
        return "".join(lines), f"the key in `{lines[place].strip()}` stands twice"

    def swap(self, lines, rng):
        a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[a], lines[b] = lines[b], lines[a]
        return "".join(lines), ""

    def nested(self, lines, rng):
        """Deep nesting, long lines, long keys."""
        deep = rng.choice([100, 10_000, 200_000])
        key = lines[rng.choice(self.keys(lines))].split(" = ")[0]
        text = rng.choice([
            f"{key} = {'[' * deep}\n", f"{key} = {'{a=' * deep}\n", f"{'a.' * deep}a = 1\n", f"[{'a.' * deep}a]\n",
            f"{key} = \"{'x' * 1_000_000}\"\n", f"{'k' * 1_000_000} = 1\n", f"{key} = {'9' * 1_000_000}\n",
            f"{key} = [{'1,' * 300_000}]\n", "".join(f"[[a{i}]]\n" for i in range(5000)),
        ])
        lines.insert(rng.randrange(len(lines) + 1), text)
        return "".join(lines), "nested, long or unknown key"

    def bytes(self, lines, rng):
        """Byte-order mark, line ends, bytes that are not UTF-8, empty file."""
        data = "".join(lines).encode()
        place = rng.randrange(len(data))
        wrong = rng.choice([b"\xff", b"\xc3", b"\xed\xa0\x80", b"\0", b"\x1b[2J"])
        return rng.choice([
            (b"\xef\xbb\xbf" + data, ""), (data.replace(b"\n", b"\r\n"), ""), (data.replace(b"\n", b"\r"), ""),
            (data[:place] + wrong + data[place:], f"{wrong!r} at byte {place}"), (b"\xff\xfe" + data, "UTF-16 mark"),
            (data[:place], ""), (bytes(1000), "1000 zeros"), (b"", ""),
        ])

    def unknown(self, lines, rng):
        lines_of = ["nobody = 1\n", "[nobody]\nx = 1\n", "[[plant]]\n", "[plant.friction]\n", "= 1\n", "a b = 1\n"]
        line = rng.choice(lines_of)
        lines.insert(rng.randrange(len(lines) + 1), line)
        return "".join(lines), "" if line.startswith("[") and "nobody" not in line else f"unknown {line.split()[0]}"


CELLS = [
    "nan", "inf", "-inf", "-0", "1e39", "1e308", "1e999", "1e-320", "", "x", "1;2", '"0.1"', '"', "0x10", "9" * 400,
    " 0.1 ", "٣",
]
JSON_VALUES = [
    "NaN", "Infinity", "-0.0", "1e39", "-1e39", "1e999", "1e-320", "1e-46", "3.4e38", "1e19", "-1", "0", '"x"', "null",
    "true", "[]", "{}", "18446744073709551616", "9" * 400, "01", "1.", "[[[[1]]]]",
]
WAYPOINTS = "x,y\n0,0\n0.05,0\n0.1,0.001\n0.15,0.003\n"
Q3, Q7 = (json.dumps([[1e-4 * (i == j) for j in range(size)] for i in range(size)]) for size in (3, 7))
EVAL = {
    "rps": [
        '{"length":0.36,"half_thickness":0.0005,"gauges":[0.02,0.1,0.18,0.26,0.34],"strain":[1e-4,1e-4,1e-4,1e-4,1e-4],'
        '"method":"piecewise","segments":20}'
    ],
    "ci": [f'{{"a":[0,0,3.0],"A":{Q3},"b":[0.1,0.2,-3.0],"B":{Q3},"criterion":"det"}}'],
    "ekf": [
        f'{{"dt":0.001,"track":0.324,"Q":{Q7},"R":[4e-4,4e-4,2.5e-5,0.01],"R_pose":{Q3},"x0":[0,0,0,0,0,0,0],'
        f'"P0":{Q7}}}',
        '{"left":0.1,"right":0.12,"gyro":0.1,"accel":null}',
        '{"pose":[0,0.01,0]}',
    ],
    "ipec": [
        '{"track":0.324,"axle1":[0.37,0,0],"axle2":[0,0,0],"sigma":{"wheel":1e-5,"r_y":1e-5,"r_phi":1e-4}}',
        '{"d":[0.001,0.001,0.001,0.001],"r":[-0.37,0,0]}',
    ],
    "kinematic": [
        '{"posture":[-1,-1,0],"reference":[0,0,0],"v_r":0.1,"kappa_r":0,"r":0.2,"epsilon":0.001,"k1":1.5,"k2":2,'
        '"form":"printed"}'
    ],
    "cascade": ['{"v":0.2,"kappa":1.5,"kappa_dot":0.3,"length":0.37,"form":"exact"}'],
    "bus": [
        '{"encode":{"LeadStatus":{"sequence":3,"mode":"hold","steering_rad":-0.0001,"velocity_m_s":0.25}}}',
        '{"decode":{"id":112,"data":"0302ffffc409"}}',
    ],
    "frame": ['{"length":0.4,"ei":0.5,"ea":1e7,"pose":[0.38,0.08,0.4],"seed_curvature":[1,1,1,1,1]}'],
}
# Algorithms whose first line has no output.
CONFIGURED = {"ekf", "ipec"}


class Lines(Kind):
    """CSV waypoints for `follow`, and JSON lines for `eval`."""

    name, count = "lines", 60

    def case(self, rng, index, folder):
        return self.eval(rng, index) if index % 2 else self.waypoints(rng, folder)

    def waypoints(self, rng, folder):
        lines = WAYPOINTS.splitlines(keepends=True)
        place, refuse = rng.randrange(1, len(lines)), ""
        change = rng.randrange(10)
        if change < 5:
            cells, value = lines[place].strip().split(","), rng.choice(CELLS)
            cells[rng.randrange(2)] = value
            lines[place] = ",".join(cells) + "\n"
            refuse = f"{value[:20]} was accepted" if value not in ("-0", "1e-320", '"0.1"', " 0.1 ") else ""
        elif change == 5:
            del lines[rng.randrange(len(lines))]
        elif change == 6:
            lines.insert(place, lines[rng.randrange(len(lines))])
        elif change == 7:
            others = ["0.05\n", "0.05,0,0\n", "\n", ",\n", "x,y\n", "0.05 0\n", "\0\n", "1," * 500_000 + "\n"]
            lines[place] = rng.choice(others)
        elif change == 8:
            lines[0] = rng.choice(["", "x\n", "a,b\n", "y,x\n", "x,x\n", "x,y,z\n", "X,Y\n", " x , y \n", '"x","y"\n'])
        data = "".join(lines).encode()
        if change == 9:
            place = rng.randrange(len(data))
            data = rng.choice([
                b"", b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data[:place] + b"\xff" + data[place:],
                b"x,y\n", b"x,y\n0,0\n", b"x,y\n" + b"0,0\n" * 1000, data + b'"' * 1001, b"x" * 1_000_000,
                b"\n" * 1_000_000,
            ])
        (folder / "path.csv").write_bytes(data)
        words = ["follow", "--path", "path.csv", "--threads", "1", "--out", "out"]
        return Case(words, refuse=refuse, named=r"path\.csv|line \d+|waypoint")

    def eval(self, rng, index):
        algorithm = list(EVAL)[index // 2 % len(EVAL)]
        lines = [line.encode() for line in EVAL[algorithm]]
        # Usually the first line is right, else all outputs may be errors.
        first = lines if algorithm not in CONFIGURED or rng.random() < 0.8 else [self.wrong(lines[0], rng)]
        lines = first + [self.wrong(rng.choice(lines[1:] or lines), rng) for _ in range(30)]
        data = b"\n".join(lines) + rng.choice([b"", b"\n", b"\r\n"])
        asked = len([line for line in data.split(b"\n") if line.strip()])

        def check(ended):
            answers = ended.out.decode(errors="replace").splitlines()
            allowed = (asked, asked - 1) if algorithm in CONFIGURED else (asked,)
            found = [(CODE, f"{len(answers)} answers to {asked} lines")] if len(answers) not in allowed else []
            errors = 0
            for number, answer in enumerate(answers):
                try:
                    value = json.loads(answer, parse_constant=lambda text: [][0])
                    errors += "error" in value
                    if "error" not in value and has_null(value):
                        found.append((SILENT, f"answer {number + 1} holds null: {answer[:200]}"))
                except (ValueError, IndexError, TypeError):
                    found.append((SILENT, f"answer {number + 1} is no JSON of finite numbers: {answer[:200]}"))
            if ended.code != (2 if errors else 0):
                found.append((CODE, f"{errors} errors among {len(answers)} answers"))
            return found[:3]

        return Case(["eval", algorithm], codes=(0, 2), stdin=data, check=check)

    def wrong(self, line, rng):
        """Line with a replaced value, a removed or doubled key, or random content."""
        text = line.decode()
        if rng.random() < 0.6:
            for _ in range(rng.choice([1, 1, 3])):
                if numbers := list(re.finditer(r'(?<![\w"])-?\d[\d.e+-]*', text)):
                    start, end = rng.choice(numbers).span()
                    text = text[:start] + rng.choice(JSON_VALUES) + text[end:]
            return text.encode()
        key = rng.choice(list(re.finditer(r'"\w+":', text)))
        at, place = key.start(), rng.randrange(len(line))
        double = f"{text[:at]}{key[0]}{rng.choice(JSON_VALUES)},{text[at:]}"
        return rng.choice([
            double.encode(), (text[:at] + text[key.end() :]).encode(), b"[" * 100_000, b'{"a":' * 50_000,
            b" " * 500_000, b"x" * 500_000, line[:place], b"null", b"[]", b"0", b"{}", line + line,
            line[:place] + b"\xff" + line[place:], line[:place] + b"\0" + line[place:], b"\xef\xbb\xbf" + line,
            b'{"' + b"k" * 300_000 + b'":1}',
        ])


def has_null(value):
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return value is None or any(map(has_null, children))
