"""Disturbed runs: full disks, folders in use, signals, invalid viewers."""
import base64
import os
import re
import signal
import socket
import struct
import time
from pathlib import Path

from bench import CODE, HALF, Case, Kind, Unsound, snapshot

RUN = ["posture", "--rows", "joint", "--trials", "1", "--threads", "1"]
RESULTS = ["--out", "out", "--log", "x.mcap", "--csv", "tables", "--json", "x.json"]

STUDY = 'name = "s"\ntrials = 20\nblock = 1\n[scenario.mission]\ntime_limit_s = 2.0\n'


class Disk(Kind):
    """Files that cannot be written, or not completely."""

    name, count = "disk", 12
    parallel = 1

    def prepare(self):
        self.sound(*RUN, *RESULTS)
        self.sizes = {name: size for name, (size, _) in snapshot(self.folder).items()}

    def case(self, rng, index, folder):
        special = [self.is_file, self.under_file, self.full, self.in_use, self.log_to_pipe, self.read_only]
        make = special[index // 2 % len(special)] if index % 2 else self.limited
        return make(rng, folder)

    def limited(self, rng, folder):
        """Limits the size of files below the size of the largest result."""
        results = rng.choice([RESULTS, ["--out", "out", "--csv", "tables", "--json", "x.json"], ["--out", "out"]])
        names = {name: size for name, size in self.sizes.items() if name.split("/")[0] in results}
        largest = max(names.values())
        size = rng.choice([rng.randrange(largest), rng.choice(list(names.values())) - 1, rng.randrange(4096)])

        def check(ended):
            named = any(Path(name).name in ended.err for name in names)
            return [] if named else [(CODE, f"no file is named: {ended.err.strip()[:200]}")]

        refuse = f"no file may exceed {size} bytes"
        return Case([*RUN, *results], codes=(1,), refuse=refuse, largest_file=size, check=check)

    def is_file(self, rng, folder):
        (folder / "out").write_text("kept\n")

        def check(ended):
            return [] if (folder / "out").read_text() == "kept\n" else [(HALF, "the file was overwritten")]

        return Case([*RUN, "--out", "out"], codes=(1, 2), refuse="--out is a file", check=check)

    def under_file(self, rng, folder):
        (folder / "out").write_text("kept\n")
        option = rng.choice(["--out", "--log", "--json", "--csv"])
        words = [*RUN, option, "out/below"] + ([] if option == "--out" else ["--out", "results"])
        return Case(words, codes=(1, 2), refuse=f"{option} is below a file")

    def full(self, rng, folder):
        (folder / "full.json").symlink_to("/dev/full")
        return Case([*RUN, "--out", "out", "--json", "full.json"], codes=(1,), refuse="/dev/full takes nothing")

    def log_to_pipe(self, rng, folder):
        """Log to a pipe: refused or written, and the pipe is not replaced."""
        os.mkfifo(folder / "pipe.mcap")

        def check(ended):
            return [] if (folder / "pipe.mcap").is_fifo() else [(HALF, "the pipe was replaced by a file")]

        return Case([*RUN, "--out", "out", "--log", "pipe.mcap"], check=check)

    def read_only(self, rng, folder):
        """Output folder without write permission, or in /proc."""
        out = "/proc/self/out"
        if os.geteuid() != 0:
            (folder / "out").mkdir(mode=0o555)
            out = "out"
        return Case([*RUN, "--out", out], codes=(1, 2), refuse="the folder takes no files")

    def in_use(self, rng, folder):
        """Two runs with one folder and one log, or one part of a campaign started twice."""
        others = []
        (folder / "study.toml").write_text(STUDY)
        words = rng.choice([[*RUN, *RESULTS], ["campaign", "study.toml", "--out", "study", "--threads", "1"]])

        def during(process):
            time.sleep(rng.random() * 0.1)
            others.append(self.bench.run(Case(words), folder))

        def check(ended):
            right = {ended.code, others[0].code} in ({0}, {0, 1}, {0, 2})
            what = f"the second of two runs ended with {others[0].code}: {others[0].err[:200]}"
            return [] if right else [(CODE, what)]

        return Case(words, during=during, check=check)


class Signals(Kind):
    """Signals at any time."""

    name, count = "signals", 12
    parallel = 1
    RUNS = [
        ["posture", "--trials", "400", "--threads", "1", "--out", "out", "--json", "x.json"],
        ["follow", "--laps", "50", "--log", "x.mcap", "--csv", "tables", "--out", "out"],
        ["campaign", "study.toml", "--threads", "1", "--out", "out"],
        ["track", "--laps", "50", "--csv", "x.csv", "--out", "out", "--json", "x.json"],
        ["consistency", "--trials", "200", "--threads", "1", "--out", "out", "--json", "x.json"],
        ["soak", "--ticks", "2000000", "--json", "x.json"],
        ["paper", "--trials", "200", "--threads", "1", "--out", "out", "--json", "x.json"],
        ["drive", "--script", "script.txt", "--log", "x.mcap", "--out", "out"],
        ["calibrate", "wheels", "--laps", "20", "--out", "x.toml", "--json", "x.json"],
        ["faults", "--seeds", "2", "--threads", "1", "--json", "x.json"],
    ]

    def case(self, rng, index, folder):
        (folder / "study.toml").write_text('name = "s"\ntrials = 500\nblock = 5\nstarts = "random"\n')
        (folder / "script.txt").write_text("speed 0.1 0.5 60\n" * 20)
        words = self.RUNS[index % len(self.RUNS)]
        kind = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP][index // 2 % 3]
        at, twice = rng.choice([0.05, 0.2, 0.6]) * (0.5 + rng.random()), index % 6 == 5
        gap = rng.choice([0.0, 0.02])

        def during(process):
            time.sleep(at)
            process.send_signal(kind)
            if twice:
                time.sleep(gap)
                process.send_signal(kind)

        return Case(words, codes=(0, 1, 130), during=during, may_leave_temporary=twice)


class Live(Kind):
    """Live run with a good viewer and invalid clients."""

    name, count = "live", 5
    parallel = 5
    WORDS = ["drive", "stop", "--threads", "1", "--out", "out", "--live", "127.0.0.1:0"]

    def prepare(self):
        # If the port is in use, the run ends at once.
        with socket.create_server(("127.0.0.1", 0)) as server:
            words = [*self.WORDS[:-1], f"127.0.0.1:{server.getsockname()[1]}"]
            ended = self.bench.run(Case(words), self.folder)
        if ended.code != 2:
            raise Unsound(f"a port that is taken: exit code {ended.code}: {ended.err[:200]}")
        return None

    def case(self, rng, index, folder):
        clients = [self.silent, self.half, self.noise, self.masked_noise, self.deaf]
        bad = [clients[index % len(clients)], *rng.sample(clients, 2)]

        def during(process):
            port = self.port(process)
            open_sockets = []
            for client in bad:
                if port:
                    made = socket.create_connection(("127.0.0.1", port), timeout=5)
                    open_sockets.append(made)
                    try:
                        client(made, rng)
                    except OSError:
                        pass
            if port:
                self.viewer(port)
            while process.poll() is None:
                time.sleep(0.02)
            for made in open_sockets:
                made.close()

        def check(ended):
            return [] if (folder / "out" / "report.html").exists() else [(CODE, "no results were written")]

        return Case(self.WORDS, codes=(0,), during=during, check=check, limit=40)

    def port(self, process):
        """Port on which the process listens, from /proc/net/tcp."""
        while process.poll() is None:
            links = []
            for descriptor in Path(f"/proc/{process.pid}/fd").iterdir():
                try:
                    links.append(os.readlink(descriptor))
                except OSError:
                    pass
            inodes = {match[1] for link in links if (match := re.match(r"socket:\[(\d+)\]", link))}
            for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
                parts = line.split()
                # Only the public port listens on 127.0.0.1; the internal server uses another address.
                if parts[3] == "0A" and parts[9] in inodes and parts[1].startswith("0100007F:"):
                    return int(parts[1].split(":")[1], 16)
            time.sleep(0.02)
        return None

    HANDSHAKE = (
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\nSec-WebSocket-Key: " + base64.b64encode(bytes(16)) + b"\r\n\r\n"
    )

    def silent(self, client, rng):
        pass

    def half(self, client, rng):
        client.sendall(self.HANDSHAKE[: rng.randrange(1, len(self.HANDSHAKE) - 2)])

    def noise(self, client, rng):
        client.sendall(rng.randbytes(5000))

    def masked_noise(self, client, rng):
        """Handshake, then frames with random content."""
        client.sendall(self.HANDSHAKE)
        for operation in (1, 2, 9, rng.randrange(16)):
            client.sendall(frame(rng.choice([b"{", b"\xff" * 100, rng.randbytes(60)]), operation))
        client.sendall(b"\x82\xff" + struct.pack(">Q", 2**63 - 1) + rng.randbytes(100))

    def deaf(self, client, rng):
        """Subscribes to many topics and reads nothing."""
        client.sendall(self.HANDSHAKE + frame(subscription(range(1, 40)), 1))

    def viewer(self, port):
        """Good viewer: subscribes and reads to the end."""
        with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
            client.sendall(self.HANDSHAKE)
            client.recv(4096)
            time.sleep(0.2)
            client.sendall(frame(subscription(range(1, 40)), 1))
            try:
                while client.recv(65536):
                    pass
            except OSError:
                pass


def subscription(channels):
    entries = ",".join(f'{{"id":{i},"channelId":{i}}}' for i in channels)
    return f'{{"op":"subscribe","subscriptions":[{entries}]}}'.encode()


def frame(data, operation):
    """Frame of a client, masked with zeros."""
    size = bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + struct.pack(">H", len(data))
    return bytes([0x80 | operation]) + size + bytes(4) + data
