"""Reads a live run by websocket, as Foxglove does, and compares the messages with the run's log.

Needs the Python packages websockets, mcap, mcap-protobuf-support and jsonschema.

    check_live.py CFMMR      CFMMR: the program
"""

import base64
import json
import math
import re
import signal
import struct
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import jsonschema
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

# Watched simulated time, s; the robot starts to move after 0.5 s.
SECONDS = 3.0
EACH_EPOCH = ["/lead", "/truth", "/truth/robot", "/estimate/robot", "/tf"]
MESSAGE, TIME = 1, 2


class Viewer:
    """Client that subscribes to all topics that exist when it connects."""

    def __init__(self, address):
        # No keepalive: a viewer that has finished does not read.
        self.socket = connect(
            address, subprotocols=["foxglove.sdk.v1"], max_size=None, open_timeout=20, ping_interval=None
        )
        assert self.socket.subprotocol == "foxglove.sdk.v1"
        info = json.loads(self.socket.recv(timeout=20))
        assert info["op"] == "serverInfo" and info["name"] == "cfmmr" and "time" in info["capabilities"], info
        self.channels = {}
        self.messages = defaultdict(list)  # topic -> (log time, bytes)
        self.times = []

    def look_for(self, count):
        """Waits until `count` topics are advertised, and subscribes to them."""
        while len(self.channels) < count:
            said = self.socket.recv(timeout=20)
            # The server sends the time to all clients.
            if isinstance(said, bytes):
                continue
            said = json.loads(said)
            if said["op"] == "advertise":
                self.channels.update({channel["id"]: channel for channel in said["channels"]})
        wanted = [{"id": key, "channelId": key} for key in self.channels]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def watch(self, seconds):
        """Receives messages until the simulated time."""
        while not self.times or self.times[-1] < seconds * 1e9:
            try:
                said = self.socket.recv(timeout=60)
            except ConnectionClosed:
                return
            if isinstance(said, str):
                continue
            if said[0] == TIME:
                self.times.append(struct.unpack_from("<Q", said, 1)[0])
            elif said[0] == MESSAGE:
                subscription, at = struct.unpack_from("<IQ", said, 1)
                self.messages[self.channels[subscription]["topic"]].append((at, said[13:]))

    def channel(self, topic):
        return next(channel for channel in self.channels.values() if channel["topic"] == topic)

    def decoded(self, topic):
        """Times and contents of a topic, checked against the received schema."""
        channel = self.channel(topic)
        if channel["encoding"] == "json":
            assert channel["schemaEncoding"] == "jsonschema", topic
            schema = json.loads(channel["schema"])
            assert schema["title"] == channel["schemaName"], topic
            validator = jsonschema.Draft7Validator(schema)
            contents = [(at, json.loads(data)) for at, data in self.messages[topic]]
            for _, content in contents[:: max(1, len(contents) // 100)]:
                validator.validate(content)
            return contents
        assert channel["encoding"] == "protobuf", topic
        data = base64.b64decode(channel["schema"])
        schema = Schema(id=1, name=channel["schemaName"], encoding="protobuf", data=data)
        decode = DecoderFactory().decoder_for("protobuf", schema)
        return [(at, decode(data)) for at, data in self.messages[topic]]


def start(program, folder, command, *more):
    """Starts a live run; returns the process and its address."""
    run = subprocess.Popen(
        [program, command, "--live", "127.0.0.1:0", "--seed", "4", "--out", folder / "out", *more],
        cwd=folder,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    line = run.stderr.readline()
    found = re.match(r"live: (ws://127\.0\.0\.1:\d+), waiting", line)
    assert found, line + run.stderr.read()
    return run, found[1]


def logged(path):
    """Topics with schemas, and messages of a log."""
    topics, messages = {}, defaultdict(list)
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        for channel in summary.channels.values():
            topics[channel.topic] = summary.schemas[channel.schema_id]
        for _, channel, message in reader.iter_messages(log_time_order=False):
            messages[channel.topic].append((message.log_time, message.data))
    return topics, messages


def check(program):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        log = folder / "run.mcap"
        run, address = start(program, folder, "posture", "--log", log)
        viewer = Viewer(address)
        viewer.look_for(21)
        viewer.watch(SECONDS)
        # A late viewer also receives the goal.
        late = Viewer(address)
        late.look_for(21)
        late.watch(SECONDS + 0.5)
        run.send_signal(signal.SIGINT)
        assert run.wait(timeout=30) == 130, run.stderr.read()
        topics, messages = logged(log)

    # The log has only topics with a message.
    without = {channel["topic"] for channel in viewer.channels.values()} - set(topics)
    assert len(viewer.channels) == len(topics) + len(without), "a topic of the log is not served"
    assert not any(viewer.messages[topic] for topic in without), without
    for topic, schema in topics.items():
        channel = viewer.channel(topic)
        assert (channel["schemaName"], channel["schemaEncoding"]) == (schema.name, schema.encoding), topic
        text = schema.encoding == "jsonschema"
        data = channel["schema"].encode() if text else base64.b64decode(channel["schema"])
        assert data == schema.data, f"{topic}: another schema than in the log"
    assert viewer.times == sorted(viewer.times)
    for topic in EACH_EPOCH:
        # All messages, with equal bytes.
        times = [at for at, _ in viewer.messages[topic]]
        of_log = [message for message in messages[topic] if message[0] <= times[-1]]
        assert viewer.messages[topic] == of_log, f"{topic}: other messages than in the log"
        assert len(times) > 95 * SECONDS, f"{topic}: {len(times)} messages"
    ticks = [content["tick"] for _, content in viewer.decoded("/boards/front/tick")]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks))) and len(ticks) > 900 * SECONDS
    assert viewer.decoded("/bus") and viewer.decoded("/scene") and viewer.decoded("/log")
    for one in (viewer, late):
        (at, goal), *_ = one.decoded("/goal")
        assert goal.frame_id == "world" and math.hypot(goal.pose.position.x, goal.pose.position.y) < 1e-9
    assert at > SECONDS * 1e9 - 2e8, "told when it was asked for"

    # Truth and estimate: at the start posture, then moving.
    place = [content.pose.position for _, content in viewer.decoded("/truth/robot")]
    assert math.hypot(place[0].x + 1.342, place[0].y + 1.342) < 0.05, place[0]
    way = math.hypot(place[-1].x - place[0].x, place[-1].y - place[0].y)
    assert 0.05 < way < 0.25 * SECONDS, way
    believed = [content.pose.position for _, content in viewer.decoded("/estimate/robot")]
    off = math.hypot(believed[-1].x - place[-1].x, believed[-1].y - place[-1].y)
    assert off < 0.05, off
    moving = [content for _, content in viewer.decoded("/lead") if content["velocity_m_s"] != 0.0]
    assert moving, "the lead node never set out"
    counts = sum(len(messages) for messages in viewer.messages.values())
    print(f"live: {len(viewer.channels)} topics, {counts} messages in {SECONDS} s, as in the log")


def check_boards(program):
    """Checks that virtual boards in the loop are served from the first tick to the end of the run."""
    with tempfile.TemporaryDirectory() as folder:
        run, address = start(program, Path(folder), "hil", "--on", "virtual", "--stop-after", "0.5")
        viewer = Viewer(address)
        viewer.look_for(21)
        viewer.watch(math.inf)
        assert run.wait(timeout=60) == 0, run.stderr.read()
    for board in ["front", "rear", "beam"]:
        ticks = [content["tick"] for _, content in viewer.decoded(f"/boards/{board}/tick")]
        # Messages queued when the server ends need not arrive.
        assert ticks == list(range(len(ticks))) and len(ticks) > 400, (board, len(ticks))
    print(f"live: virtual boards, {len(ticks)} of 500 ticks of each")


def check_refusals(program):
    """Checks the errors for an address in use and for an invalid address."""
    with tempfile.TemporaryDirectory() as folder:
        run, address = start(program, Path(folder), "posture")
        port = address.rsplit(":", 1)[1]
        for given, words in [(port, [port, "free"]), ("here", ["--live", "here", "ADDRESS:PORT"])]:
            second = subprocess.run(
                [program, "posture", "--live", given, "--out", folder], capture_output=True, text=True, timeout=60
            )
            assert second.returncode == 2 and all(word in second.stderr for word in words), second.stderr
        run.send_signal(signal.SIGINT)
        assert run.wait(timeout=30) == 130, "one that waits for a viewer can be ended"


if __name__ == "__main__":
    program = Path(sys.argv[1]).resolve()
    check(program)
    check_boards(program)
    check_refusals(program)
