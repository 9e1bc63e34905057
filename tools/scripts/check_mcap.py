"""Reads logs of cfmmr with the Python reader of MCAP and compares them with other outputs of these runs: CSV tables,
every bus frame decoded by cantools, wheel speeds from encoder counts. Looks up the names of docs/foxglove_layout.json
and docs/logs.md.

Needs the Python packages mcap, mcap-protobuf-support, jsonschema and cantools.

    check_mcap.py CFMMR      CFMMR: the program
"""

import csv
import json
import math
import re
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from pathlib import Path

import cantools
import jsonschema
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from check_dbc import RELATIVE, same, to_board

EACH_TICK = ["/boards/front/tick", "/boards/rear/tick", "/boards/beam/tick"]
EACH_EPOCH = ["/lead", "/truth", "/tf", "/truth/robot"]
ONCE = ["/goal", "/boards/front/start", "/boards/rear/start", "/boards/beam/start"]
COUNTS_PER_REVOLUTION = 8192
DOCS = Path(__file__).resolve().parents[2] / "docs"
# A path of Foxglove: topic, then fields. An array of arrays cannot be indexed.
FOXGLOVE = re.compile(r"((?:/\w+)+)((?:\.\w+(?:\[(?:\d+|:)\])?)+)")


def crc32c(data):
    """CRC-32C, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return f"{crc ^ 0xFFFFFFFF:08x}"


class Log:
    """Log with checks that apply to every log."""

    def __init__(self, path):
        self.messages = defaultdict(list)  # topic -> (log time, content)
        self.schemas = {}
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            for channel in summary.channels.values():
                self.schemas[channel.topic] = summary.schemas[channel.schema_id]
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                content = message.data
                if channel.message_encoding == "json":
                    content = json.loads(content)
                self.messages[channel.topic].append((message.log_time, content))
            counts = summary.statistics.channel_message_counts
            for channel in summary.channels.values():
                assert counts[channel.id] == len(self.messages[channel.topic]), channel.topic
            self.metadata = {record.name: record.metadata for record in reader.iter_metadata()}
            file.seek(0)
            self.standard = defaultdict(list)
            for decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=[topic for topic in self.schemas if self.schemas[topic].encoding == "protobuf"],
                log_time_order=False,
            ):
                self.standard[decoded.channel.topic].append(decoded.decoded_message)
        self.check()

    def check(self):
        for topic, messages in self.messages.items():
            # Boards behind links report one after the other.
            board_of = lambda message: message.get("board") if isinstance(message, dict) else None
            for board in ("front", "rear", "beam", None):
                times = [at for at, message in messages if board_of(message) == board]
                assert times == sorted(times) or topic == "/log", f"{topic}: times go back"
        for topic, schema in self.schemas.items():
            if schema.name.startswith("foxglove."):
                assert schema.encoding == "protobuf", topic
                continue
            assert schema.encoding == "jsonschema", topic
            described = json.loads(schema.data)
            assert described["title"] == schema.name, topic
            for name, field in described["properties"].items():
                assert field["description"], f"{topic}.{name} has no description"
            validator = jsonschema.Draft7Validator(described)
            messages = [content for _, content in self.messages[topic]]
            # A sample of about 500 messages per topic is enough.
            for content in messages[:: max(1, len(messages) // 500)]:
                validator.validate(content)
        for topic in EACH_TICK:
            ticks = [content["tick"] for _, content in self.messages[topic]]
            if ticks:
                first = ticks[0] if ticks else 0
            assert ticks == list(range(first, first + len(ticks))), f"{topic}: ticks are missing"
        for topic in EACH_TICK + ["/bus", "/lead"]:
            # The boards' common time began before the run; ticks before the run are logged at the start of the run.
            offsets = [content["tick"] * 1_000_000 - at for at, content in self.messages[topic] if at > 0]
            for at, content in self.messages[topic]:
                assert at == max(0, content["tick"] * 1_000_000 - offsets[0]), topic
        about = self.metadata["cfmmr"]
        scenario = tomllib.loads(about["scenario"])
        assert scenario["mission"] and about["build"].startswith("cfmmr "), about
        assert about["scenario_hash"] == crc32c(about["scenario"].encode())
        if not self.messages["/boards/front/start"]:
            # Autonomous boards: samples are not logged, and the parameters are in the boards' flash.
            return
        start = self.messages["/boards/front/start"][0][1]
        assert about["parameters_hash"] == start["parameters_hash"] == crc32c(bytes.fromhex(start["parameters"]))


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def frame_of(row):
    return "#".join(row[name].removeprefix("0x") for name in ("identifier_hex", "data_hex"))


def near(a, b, slack, where):
    a, b = float(a), float(b)
    assert a == b or abs(a - b) <= slack * max(1.0, abs(a), abs(b)), (where, a, b)


def pose_of(message):
    """x, y and heading of a pose message."""
    q = message.orientation
    return [message.position.x, message.position.y, 2.0 * math.atan2(q.z, q.w)]


def heading_near(a, b, where):
    assert abs(math.remainder(a - b, math.tau)) < 1e-9, (where, a, b)


def at(message, path):
    """Value at a path such as robot.covariance[0][1]; None below a null."""
    for key in re.findall(r"\w+", path):
        if message is None:
            return None
        message = message[int(key) if isinstance(message, list) else key]
    return message


def compare_row(message, row, topic, where):
    """Compares a message with the columns of a row that have the topic's prefix."""
    compared = 0
    for column, cell in row.items():
        if not column.startswith(topic):
            continue
        value, place = at(message, column.removeprefix(topic)), (where, column)
        if value is None or isinstance(value, (str, bool)):
            words = {None: "", True: "1", False: "0"}
            assert cell == words.get(value, value), place
        else:
            near(value, cell, 1e-6, place)
        compared += 1
    assert compared, topic


def compare_epochs(log, rows, in_process=True):
    """Compares the messages of each epoch with the rows of the run's table."""
    truth = {round(m["time_s"] * 1e3): m for _, m in log.messages["/truth"]}
    lead = {m["tick"] // 10: m for _, m in log.messages["/lead"]}
    robot = {at // 1_000_000: m for (at, _), m in zip(log.messages["/truth/robot"], log.standard["/truth/robot"])}
    led = None
    for row in rows:
        tick = round(float(row["time_s"]) * 1e3)
        # If an output does not arrive within its epoch, the row has the output before.
        m, led = truth[tick], lead.get(tick // 10 - 1, led)
        compare_row(m, row, "truth.", tick)
        if not in_process:
            # The row has one of the estimates reported by the front board.
            wanted = [float(row[f"lead.robot.{key}"]) for key in ("x_m", "y_m", "phi_rad")]
            gaps = ((m["robot"][k] - w for k, w in zip(("x_m", "y_m", "phi_rad"), wanted)) for m in lead.values())
            assert min(max(map(abs, gap)) for gap in gaps) < 2e-6, tick
            continue
        if led is None:
            continue
        compare_row(led, row, "lead.", tick)
        x, y, phi = pose_of(robot[tick].pose)
        near(x, row["truth.robot.x_m"], 1e-12, tick)
        near(y, row["truth.robot.y_m"], 1e-12, tick)
        heading_near(phi, float(row["truth.robot.phi_rad"]), tick)


def compare_wheels(log):
    """Compares wheel speeds from encoder counts with the true speeds, epoch by epoch."""
    worst = 0.0
    for topic, places in (("/boards/front/tick", (0, 1)), ("/boards/rear/tick", (2, 3))):
        ticks = {m["tick"]: m["encoder"] for _, m in log.messages[topic]}
        truth = {round(m["time_s"] * 1e3): m["wheel_speed_rad_s"] for _, m in log.messages["/truth"]}
        for tick in range(600, max(ticks) - 20, 50):
            for side, place in enumerate(places):
                turned = ticks[tick + 10][side] - ticks[tick][side]
                measured = turned * math.tau / COUNTS_PER_REVOLUTION / 0.010
                mean = 0.5 * (truth[tick][place] + truth[tick + 10][place])
                worst = max(worst, abs(measured - mean))
    # One count in 10 ms is 0.08 rad/s, and the speed may change during 10 ms.
    assert worst < 0.35, f"wheel speeds differ by {worst} rad/s"


def compare_bus(log, database, unrecorded=0):
    """Compares every frame decoded by cantools with the log's message; `unrecorded` frames are outside the record."""
    frames = [frame for _, entry in log.messages["/bus"] for frame in entry["frames"]]
    for entry in frames:
        identifier, data = entry["frame"].split("#")
        message = database.get_message_by_frame_id(int(identifier, 16))
        assert message.name == entry["name"], entry
        signals = message.decode(bytes.fromhex(data))
        known = {s.name for s in message.signals if s.choices}
        signals = {key: str(v) if key in known else v for key, v in signals.items()}
        slack = 2e-5 if "Uncertainty" in message.name else 10 * RELATIVE
        same(to_board(message.name, signals), entry["message"], message.name, slack)
    received = {frame for topic in EACH_TICK for _, m in log.messages[topic] for frame in m["received"]}
    missing = received - {entry["frame"] for entry in frames}
    assert len(missing) <= unrecorded, f"frames arrived that were never sent: {len(missing)}, {sorted(missing)[:5]}"
    return len(frames)


def compare_tables(log, folder):
    """Compares the tables of ticks and frames with the log."""
    axles = table(folder / "axles.csv")
    for board in ("front", "rear"):
        rows = [row for row in axles if row["board"] == board]
        messages = log.messages[f"/boards/{board}/tick"]
        assert len(rows) == len(messages)
        for row, (_, m) in zip(rows, messages):
            near(float(row["time_s"]) * 1e3, m["tick"], 1e-9, board)
            own = {column: cell for column, cell in row.items() if column not in ("time_s", "board")}
            compare_row(m, own, "", (board, row))
    beam = table(folder / "beam.csv")
    for row, (_, m) in zip(beam, log.messages["/boards/beam/tick"], strict=True):
        row.pop("time_s")
        compare_row(m, row, "", "beam")
    frames = [frame_of(row) for row in table(folder / "bus.csv")]
    assert frames == [frame["frame"] for _, m in log.messages["/bus"] for frame in m["frames"]]


def has_path(log, path):
    """True if Foxglove's path leads to a number or a text."""
    match = FOXGLOVE.fullmatch(path)
    if not match or match[1] not in log.schemas:
        return False
    topic, fields = match.groups()
    for _, message in log.messages[topic]:
        try:
            value = at(message, fields.replace("[:]", "[0]"))
        except (KeyError, IndexError, TypeError):
            return False
        # Null before the first measurement.
        if value is not None:
            return isinstance(value, (int, float, str))
    return False


def check_layout(log, layout):
    """Every topic, path and coordinate frame of the layout is in the log; gives the number of paths."""
    panels = layout["configById"]
    transforms = log.standard["/tf"][0].transforms
    frames = {frame for t in transforms for frame in (t.parent_frame_id, t.child_frame_id)}
    paths, topics = [], []
    for panel in panels.values():
        paths += [series["value"] for series in panel.get("paths", [])]
        topics += [*panel.get("topics", {}), *filter(None, [panel.get("topicToRender")])]
        shown = {panel.get("followTf"), *(layer.get("frameId") for layer in panel.get("layers", {}).values())}
        assert shown <= frames | {None}, f"the layout names frames that are not in the log: {shown - frames}"
    wrong = [topic for topic in topics if not log.messages.get(topic)]
    wrong += [path for path in paths if not has_path(log, path)]
    assert not wrong, f"the layout names what is not in the log: {wrong}"

    def placed(part):
        return [part] if isinstance(part, str) else placed(part["first"]) + placed(part["second"])

    assert sorted(placed(layout["layout"])) == sorted(panels), "a panel of the layout is placed twice or never"
    return len(paths)


def plotjuggler(topic, value):
    """Names under which PlotJuggler shows the numbers of a message."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from plotjuggler(f"{topic}/{key}", part)
    elif isinstance(value, list):
        for n, part in enumerate(value):
            yield from plotjuggler(f"{topic}[{n}]", part)
    elif isinstance(value, (int, float)):
        yield topic


def check_viewers(log):
    """Every path of Foxglove and name of PlotJuggler in docs/logs.md, section Viewers, is in the log."""
    section = (DOCS / "logs.md").read_text().split("\n## Viewers\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(/[^`]+)`", section, re.MULTILINE)
    paths = [one for one in re.findall(r"`(/[^`]+)`", section) if one not in rows]
    names = {name for topic, schema in log.schemas.items() if schema.encoding == "jsonschema"
             for _, message in log.messages[topic][-1:] for name in plotjuggler(topic, message)}
    wrong = [path for path in paths if not has_path(log, path)] + [row for row in rows if row not in names]
    assert paths and rows and not wrong, f"docs/logs.md names what is not in the log: {wrong}"


def virtual(call, folder, database):
    """Checks a run on virtual boards: reports of each board, and the truth."""
    path, tables, out = folder / "virtual.mcap", folder / "virtual-tables", folder / "virtual"
    arguments = ["--stop-after", 1.5, "--log", path, "--csv", tables, "--out", out]
    call("posture", "--on", "virtual", *arguments)
    log = Log(path)
    about, end = log.metadata["cfmmr"], log.metadata["cfmmr.end"]
    assert about["command"] == "posture" and end["whole"] == "true" and end["kind"] == "interrupted", end
    assert about["board_front"] == about["board_rear"] != about["board_beam"], about
    epochs = int(end["epochs"])
    assert epochs == 150, epochs
    for topic in EACH_EPOCH[1:]:
        assert len(log.messages[topic]) == epochs, topic
    # The record begins at the start of the nodes, before the run.
    assert 0 <= len(log.messages["/lead"]) - epochs <= 120, len(log.messages["/lead"])
    for topic in EACH_TICK:
        assert 1500 <= len(log.messages[topic]) <= 2700, (topic, len(log.messages[topic]))
    assert "identical over" in call("replay", path)
    rows = table(out / "log-joint.csv")
    compare_epochs(log, rows[1:], in_process=False)
    compare_epochs(log, table(tables / "epochs.csv")[1:], in_process=False)
    bus = table(tables / "bus.csv")
    frames = [frame_of(row) for row in bus]
    assert frames == [frame["frame"] for _, m in log.messages["/bus"] for frame in m["frames"]]
    assert {row["board"] for row in bus} == {"front", "rear", "beam"}
    assert len(table(tables / "axles.csv")) > 3000 and len(table(tables / "beam.csv")) > 1500
    result = json.loads((out / "result.json").read_text())
    # Frames before the beginning of the record are not in the log.
    share = (1.5 / result["simulated_s"])
    assert 0.9 * share < len(frames) / result["frames"] < 1.0, (len(frames), result["frames"])
    return compare_bus(log, database, unrecorded=100)


def interrupted(program, folder):
    """Checks that an interrupted run leaves a readable log."""
    path = folder / "interrupted.mcap"
    run = subprocess.Popen(
        [program, "follow", "--path", "circle", "--laps", "200", "--log", path, "--out", folder / "no"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )
    for _ in range(600):
        partial = list(folder.glob(".interrupted.mcap.*"))
        if partial and partial[0].stat().st_size > 3_000_000:
            break
        time.sleep(0.1)
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 130 and "interrupted" in said, (run.returncode, said)
    assert not list(folder.glob(".interrupted*")), "a temporary file was left"
    log = Log(path)
    assert log.metadata["cfmmr.end"]["kind"] == "interrupted"
    assert len(log.messages["/boards/front/tick"]) > 1000


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    program = sys.argv[1]
    call = lambda *arguments: subprocess.run(
        [program, *map(str, arguments)], capture_output=True, text=True, check=True
    ).stdout
    database = cantools.database.load_string(call("dbc"), "dbc", strict=True)
    topics = call("topics")
    frames = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = {
            "posture": (["posture", "--trials", "1", "--rows", "pair", "--seed", "7"], "log-joint.csv"),
            "follow": (["follow", "--path", "circle", "--size", "0.8", "--imu"], "log.csv"),
            "track": (["track", "--path", "line", "--size", "1.5", "--set", "bus.loss=0.02"], "log.csv"),
        }
        for run, (arguments, rows) in runs.items():
            path, tables = folder / f"{run}.mcap", folder / f"{run}-tables"
            call(*arguments, "--log", path, "--csv", tables, "--out", folder / run)
            log = Log(path)
            about, end = log.metadata["cfmmr"], log.metadata["cfmmr.end"]
            assert about["command"] == run and end["whole"] == "true" and end["kind"] in ("reached", "uncertain"), end
            assert about["messages_hash"] == crc32c(call("dbc").encode())
            assert about["board_front"].startswith("in process")
            assert about["seed"] == ("7" if run == "posture" else "1")
            for topic, schema in log.schemas.items():
                assert f"| `{topic}` | `{schema.name}` |" in topics, f"{topic} is not in the table"
            epochs = int(end["epochs"])
            for topic in EACH_TICK:
                assert len(log.messages[topic]) == 10 * epochs, topic
            for topic in EACH_EPOCH:
                assert len(log.messages[topic]) == epochs, topic
            for topic in ONCE:
                assert len(log.messages[topic]) == 1, topic
            names = [t.child_frame_id for t in log.standard["/tf"][50].transforms]
            assert names == ["robot", "front_axle", "rear_axle", "robot_estimate"], names
            assert len(log.standard["/scene"][0].entities[0].cubes) == 4
            assert len(log.standard["/truth/path"][-1].poses) > 20
            assert any("Active" in entry.message or "active" in entry.message for entry in log.standard["/log"])
            compare_epochs(log, table(folder / run / rows))
            compare_epochs(log, table(tables / "epochs.csv"))
            compare_tables(log, tables)
            compare_wheels(log)
            frames += compare_bus(log, database)
            assert "identical over" in call("replay", path)
            if run == "follow":
                paths = check_layout(log, json.loads((DOCS / "foxglove_layout.json").read_text()))
                check_viewers(log)
        one = folder / "one.csv"
        call("track", "--path", "line", "--size", "1", "--csv", one, "--out", folder / "one")
        assert table(one) and not (folder / "one.mcap").exists()
        interrupted(program, folder)
        frames += virtual(call, folder, database)
    print(f"{len(runs) + 1} runs: logs, tables and cantools ({frames} frames) agree; {paths} paths of the layout found")


if __name__ == "__main__":
    main()
