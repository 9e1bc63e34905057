"""Compares the boards' message codec with cantools, which reads the exported bus description.

Every message in both directions: values encoded by `cfmmr eval bus` are decoded by cantools, and frames
encoded by cantools are decoded by `cfmmr eval bus`. Needs the Python package cantools.

    check_dbc.py CFMMR [CASES]      CFMMR: the program; CASES: of each message, default 10000
"""

import json
import math
import random
import subprocess
import sys

import cantools

RELATIVE = 1e-6  # single precision on the boards, double in cantools
AXLES = {"Front": "front", "Rear": "rear"}
NODES = {"Lead": "lead", "FrontAxle": "front-axle", "RearAxle": "rear-axle", "Beam": "beam"}
BOARDS = {"Front": "front", "Rear": "rear", "Beam": "beam"}
POSTURE = {"x": ("posture", 0), "y": ("posture", 1), "phi": ("posture", 2)}
# Signal names of the description -> path of the value in the boards' message.
FIELDS = {
    "LeadStatus": {"steering": "steering_rad", "velocity": "velocity_m_s"},
    "ReferencePosture": POSTURE,
    "AxlePosture": POSTURE,
    "BeamPosture": POSTURE,
    "ReferenceMotion": {
        "velocity": "velocity_m_s",
        "yaw_rate": "yaw_rate_rad_s",
        "acceleration": "acceleration_m_s2",
        "yaw_acceleration": "yaw_acceleration_rad_s2",
    },
    "AxleMotion": {"velocity": "velocity_m_s", "yaw_rate": "yaw_rate_rad_s"},
    "BeamWrench": {
        name: ("wrench", name) for name in ("force_x", "force_y", "moment_root", "moment_end")
    },
    "BoardHealth": {
        "tick_jitter": "tick_jitter_us",
        "tick_worst": "tick_worst_us",
        "supply": "supply_v",
        "temperature": "temperature_c",
    },
}


def split(name):
    """Name of the message in the boards' form, with its axle, node or board."""
    if name.startswith("NodeStatus"):
        return "NodeStatus", {"node": NODES[name.removeprefix("NodeStatus")]}
    for suffix in ("Front", "Rear", "Beam"):
        if name.endswith(suffix):
            stem = name[: -len(suffix)]
            if stem.startswith("Board"):
                return stem, {"board": BOARDS[suffix]}
            return stem, {"axle": AXLES[suffix]}
    return name, {}


def covariance(signals):
    """Covariance from standard deviations and correlations."""
    sigma = [math.exp(signals[f"ln_sigma_{axis}"]) for axis in ("x", "y", "phi")]
    rho = {(0, 1): "xy", (0, 2): "xphi", (1, 2): "yphi"}
    m = [[0.0] * 3 for _ in range(3)]
    for i in range(3):
        m[i][i] = sigma[i] ** 2
    for (i, j), name in rho.items():
        m[i][j] = m[j][i] = signals[f"correlation_{name}"] * sigma[i] * sigma[j]
    return m


def to_board(name, signals):
    """Message in the boards' form for these physical values."""
    stem, content = split(name)
    rest = dict(signals)
    if stem == "TimeSync":
        delay = rest["last_delay"]
        content["epoch"] = int(rest["epoch_high"]) * 256 + int(rest["sequence"])
        content["last_delay_us"] = None if delay == 65535 else int(delay)
        return {stem: content}
    if stem == "NodeStatus":
        rest["notices"] += rest.pop("notices_high") << 24
    if stem == "BeamCalibration":
        content = {
            "sequence": int(rest["sequence"]),
            "calibrate": {rest["command"]: rest["curvature"]},
        }
        return {stem: content}
    if stem.endswith("Uncertainty"):
        content["sequence"] = int(rest["sequence"])
        content["covariance"] = covariance(rest)
        return {stem: content}
    for signal, value in rest.items():
        place = FIELDS.get(stem, {}).get(signal, signal)
        if isinstance(place, tuple):
            group, key = place
            if isinstance(key, int):
                content.setdefault(group, [0.0] * 3)[key] = value
            else:
                content.setdefault(group, {})[key] = value
        elif place in FLAGS:
            content[place] = bool(value)
        elif isinstance(value, str):
            content[place] = value.replace("_", "-")
        else:
            whole = not isinstance(value, float) or place in WHOLE
            content[place] = int(value) if whole else value
    return {stem: content}


FLAGS = {"gyro_zeroed"}
WHOLE = {
    "sequence", "reason", "notices", "refused", "gyro_samples", "uptime", "gauges", "gauge",
    "missed_ticks", "tick_jitter_us", "tick_worst_us",
}


def integral(signal):
    return signal.scale == 1 and signal.offset == 0 and signal.unit in (None, "us")


def draw(signal, generator, between):
    """Random physical value of a signal; with `between`, not on the grid of the bus."""
    if signal.choices:
        return str(generator.choice(list(signal.choices.values())))
    low, high = signal.minimum, signal.maximum
    if signal.name == "phi":
        low, high = -math.pi, math.pi
    if between and signal.name.startswith("ln_sigma"):
        low = -20.0  # the boards send smaller deviations as 2e-9
    edge = generator.random()
    raw_low = math.ceil((low - signal.offset) / signal.scale - 1e-6)
    raw_high = math.floor((high - signal.offset) / signal.scale + 1e-6)
    raw = generator.randint(raw_low, raw_high)
    if edge < 0.02:
        raw = raw_low
    elif edge > 0.98:
        raw = raw_high
    if signal.name.startswith("correlation"):
        # Any three correlations of this size give a valid covariance.
        raw = raw % 63 - 31
    value = raw * signal.scale + signal.offset
    if integral(signal):
        return int(value)
    if between and raw_low < raw < raw_high:
        value += generator.uniform(-0.5, 0.5) * signal.scale
    return float(value)


def same(a, b, name, slack):
    """Compares two messages in the boards' form, number by number."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), (name, a, b)
        for key in a:
            same(a[key], b[key], f"{name}.{key}", slack)
    elif isinstance(a, list):
        assert len(a) == len(b), (name, a, b)
        for i, (x, y) in enumerate(zip(a, b)):
            same(x, y, f"{name}[{i}]", slack)
    elif isinstance(a, float) or isinstance(b, float):
        assert abs(a - b) <= slack * max(abs(a), abs(b)) + 1e-12, (name, a, b)
    else:
        assert a == b, (name, a, b)


def boards(program, lines):
    """Outputs of the boards' codec for these lines."""
    text = "".join(json.dumps(line) + "\n" for line in lines)
    run = subprocess.run([program, "eval", "bus"], input=text, capture_output=True, text=True)
    answers = [json.loads(line) for line in run.stdout.splitlines()]
    bad = [(line, answer) for line, answer in zip(lines, answers) if "error" in answer]
    assert not bad, bad[0]
    assert run.returncode == 0 and len(answers) == len(lines), run.stderr
    return answers


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program = sys.argv[1]
    cases = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    text = subprocess.run([program, "dbc"], capture_output=True, text=True, check=True).stdout
    database = cantools.database.load_string(text, "dbc", strict=True)
    generator = random.Random(1)
    for message in database.messages:
        drawn = [
            {s.name: draw(s, generator, between=True) for s in message.signals}
            for _ in range(cases)
        ]
        frames = boards(program, [{"encode": to_board(message.name, case)} for case in drawn])
        for case, frame in zip(drawn, frames):
            assert frame["id"] == message.frame_id, (message.name, frame)
            data = bytes.fromhex(frame["data"])
            assert len(data) == message.length, (message.name, frame)
            decoded = message.decode(data)
            for signal in message.signals:
                sent, got = case[signal.name], decoded[signal.name]
                where = (message.name, signal.name, sent, got)
                if signal.choices:
                    assert str(got) == sent, where
                    continue
                # Half a unit, and the rounding error of single precision.
                slack = 0.5 * signal.scale + RELATIVE * max(abs(sent), abs(signal.offset), 1.0)
                assert abs(got - sent) <= slack, where

        drawn = [
            {s.name: draw(s, generator, between=False) for s in message.signals}
            for _ in range(cases)
        ]
        lines = [
            {"decode": {"id": message.frame_id, "data": message.encode(case).hex()}}
            for case in drawn
        ]
        # Standard deviations are exponentials of up to 15.
        slack = 2e-5 if "Uncertainty" in message.name else RELATIVE
        for case, answer in zip(drawn, boards(program, lines)):
            same(to_board(message.name, case), answer["message"], message.name, slack)
    count = len(database.messages)
    print(f"{count} messages, {cases} values each way: the boards and cantools agree")


if __name__ == "__main__":
    main()
