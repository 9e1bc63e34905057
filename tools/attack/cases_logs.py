"""Damaged logs and blocks of campaigns: files whose bytes are covered by checksums."""
import os
import re
import shutil
import struct
import zlib

from bench import CODE, SILENT, Case, Kind, Unsound

MAGIC = b"\x89MCAP0\r\n"
FOOTER, MESSAGE, CHUNK, METADATA, DATA_END = 0x02, 0x05, 0x06, 0x0C, 0x0F
LENGTHS = [0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1]
NUMBERS = [b"nan", b"-0", b"1e39", b"1e999", b"1e-320", b"null", b"18446744073709551616", b"-1", b'"x"', b"[]", b"{}"]


def records(data, at, end):
    """Records of a part of a file, as (place, operation, length of the content)."""
    found = []
    while at < end:
        operation, length = struct.unpack_from("<BQ", data, at)
        found.append((at, operation, length))
        at += 9 + length
    return found


def all_records(data):
    """Records of a log, including records in chunks."""
    found = []
    for at, operation, length in records(data, len(MAGIC), len(data) - len(MAGIC)):
        found.append((at, operation, length))
        if operation == CHUNK:
            found += records(data, at + 9 + 40, at + 9 + length)
    return found


def first_difference(a, b):
    """Place of the first byte that differs."""
    low, high = 0, min(len(a), len(b))
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if a[:middle] == b[:middle] else (low, middle - 1)
    return low


def flip(data, rng, count=None):
    """Flips some bits."""
    changed = bytearray(data)
    for _ in range(count or rng.choice([1, 1, 2, 8])):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(data, rng):
    return data[: rng.randrange(len(data))]


def overwrite(data, rng):
    """Overwrites a part with zeros or with another part."""
    size = rng.randrange(1, min(4096, len(data) // 2))
    to, source = rng.randrange(len(data) - size), rng.randrange(len(data) - size)
    part = bytes(size) if rng.random() < 0.5 else data[source : source + size]
    return data[:to] + part + data[to + size :]


def append(data, rng):
    return data + rng.choice([b"\0", rng.randbytes(100), MAGIC, data])


class Logs(Kind):
    """`replay` of damaged logs, and of logs with wrong content and right checksums."""

    name, count = "logs", 60

    def prepare(self):
        self.sound("drive", "speed", "0.1", "0.5", "0.3", "--log", "x.mcap", "--out", "out")
        self.log = (self.folder / "x.mcap").read_bytes()
        self.sound("replay", "x.mcap")
        self.all = all_records(self.log)
        self.top = records(self.log, len(MAGIC), len(self.log) - len(MAGIC))
        if rebuilt(self.parts()) != self.log:
            raise Unsound("a log with recomputed checksums differs")

    def parts(self):
        """Operations and contents of the records outside of chunks."""
        return [(op, self.log[at + 9 : at + 9 + length]) for at, op, length in self.top]

    def case(self, rng, index, folder):
        damages = [
            flip, cut, self.length, self.swallow, self.operation, self.double, self.remove, append, self.insert,
            overwrite, self.swap, self.crafted,
        ]
        damage = damages[index % len(damages)]
        data = self.log
        while data == self.log:
            data = damage(self.log, rng)
        (folder / "x.mcap").write_bytes(data)
        words = ["replay", "x.mcap", "--json", "result.json"]
        if damage == self.crafted:
            return Case(words)
        byte = first_difference(self.log, data)
        operation = max((record for record in self.all if record[0] <= byte), default=(0, 0, 0))[1]
        where = f"byte {byte}, in a record of operation {operation:#04x}"
        return Case(words, codes=(2,), refuse=f"{damage.__name__}: changed from {where} on")

    def length(self, data, rng):
        """Changes the length of a record."""
        at, _, length = rng.choice(rng.choice([self.top, self.all]))
        changed = rng.choice([*LENGTHS, length + 1, max(length - 1, 0)])
        return data[: at + 1] + struct.pack("<Q", changed) + data[at + 9 :]

    def swallow(self, data, rng):
        """Makes a record so long that it contains the following records."""
        last = len(self.top) - 1
        ends = [i for i, (_, operation, _) in enumerate(self.top) if operation == DATA_END]
        first = rng.choice([rng.randrange(last), ends[0]])
        end = rng.choice([self.top[rng.randrange(first + 1, last + 1)][0], self.top[last][0]])
        at = self.top[first][0]
        return data[: at + 1] + struct.pack("<Q", end - at - 9) + data[at + 9 :]

    def operation(self, data, rng):
        at, _, _ = rng.choice(rng.choice([self.top, self.all]))
        return data[:at] + bytes([rng.choice([0, rng.randrange(1, 16), 0x80, 0xFF])]) + data[at + 1 :]

    def record(self, rng):
        """Record with its head; a chunk in every second draw."""
        chunks = [record for record in self.top if record[1] == CHUNK]
        at, _, length = rng.choice(rng.choice([chunks, self.top]))
        return at, at + 9 + length

    def double(self, data, rng):
        """Repeats a record between other records."""
        start, end = self.record(rng)
        place = rng.choice([rng.choice(self.top)[0], len(data) - len(MAGIC)])
        return data[:place] + data[start:end] + data[place:]

    def remove(self, data, rng):
        start, end = self.record(rng)
        return data[:start] + data[end:]

    def insert(self, data, rng):
        """Inserts bytes or a record of an unknown operation between records."""
        place = rng.choice([rng.choice(self.top)[0], len(data) - len(MAGIC)])
        part = rng.choice([rng.randbytes(20), b"\x90" + struct.pack("<Q", 3) + b"abc", b"\x90" + bytes(8)])
        return data[:place] + part + data[place:]

    def swap(self, data, rng):
        """Exchanges two neighbouring records."""
        first = rng.randrange(len(self.top) - 1)
        a, b = self.top[first][0], self.top[first + 1][0]
        c = b + 9 + self.top[first + 1][2]
        return data[:a] + data[b:c] + data[a:b] + data[c:]

    def crafted(self, _data, rng):
        """Writes wrong content into a chunk or the metadata, with right checksums."""
        parts = self.parts()
        place = rng.choice([i for i, (operation, _) in enumerate(parts) if operation in (CHUNK, METADATA)])
        operation, content = parts[place]
        if operation == METADATA:
            parts[place] = operation, wrong_text(content, rng)
            return rebuilt(parts)
        inner = [(op, content[at + 9 : at + 9 + length]) for at, op, length in records(content, 40, len(content))]
        for _ in range(rng.choice([1, 1, 5])):
            at = rng.randrange(len(inner))
            op, body = inner[at]
            change = rng.choice(["text", "text", "head", "flip", "remove", "double", "move"])
            if change == "text":
                inner[at] = op, body[:22] + wrong_text(body[22:], rng)
            elif change == "head" and op == MESSAGE:
                extreme = [0, 1, 2**63, 2**64 - 1, rng.randrange(2**64)]
                head = struct.pack("<HIQQ", rng.choice([0, 1, 65535]), 0, rng.choice(extreme), rng.choice(extreme))
                inner[at] = op, head + body[22:]
            elif change == "flip":
                inner[at] = op, flip(body or b"\0", rng)
            elif change == "remove" and len(inner) > 1:
                del inner[at]
            elif change == "double":
                inner.insert(rng.randrange(len(inner)), inner[at])
            elif change == "move":
                inner.insert(rng.randrange(len(inner)), inner.pop(at))
        body = b"".join(op.to_bytes() + struct.pack("<Q", len(part)) + part for op, part in inner)
        sums = struct.pack("<QIIQ", len(body), zlib.crc32(body), 0, len(body))
        parts[place] = operation, content[:16] + sums + body
        return rebuilt(parts)


def wrong_text(text, rng):
    """Replaces a number in a text, or removes or doubles a part of the text."""
    numbers = list(re.finditer(rb"-?\d[\d.e+-]*", text))
    if numbers and rng.random() < 0.7:
        start, end = rng.choice(numbers).span()
        return text[:start] + rng.choice(NUMBERS) + text[end:]
    start = rng.randrange(len(text) + 1)
    end = min(len(text), start + rng.randrange(1, 30))
    return text[:start] + rng.choice([b"", text[start:end] * 2, b"[" * 100_000, b"\xff"]) + text[end:]


def rebuilt(parts):
    """Log of these records, with recomputed checksums of data and summary."""
    data, start = MAGIC, 0
    for operation, content in parts:
        if operation == DATA_END:
            content = struct.pack("<I", zlib.crc32(data))
        if operation == FOOTER:
            offsets = struct.unpack_from("<Q", content, 8)[0]
            old = struct.unpack_from("<Q", content, 0)[0]
            content = struct.pack("<QQ", start, offsets and offsets - old + start)
            head = operation.to_bytes() + struct.pack("<Q", 20) + content
            content += struct.pack("<I", zlib.crc32(data[start:] + head))
        data += operation.to_bytes() + struct.pack("<Q", len(content)) + content
        if operation == DATA_END:
            start = len(data)
    return data + MAGIC


STUDY = """name = "attacked"
seed = {seed}
trials = 3
block = 2
starts = "random"

[[vary]]
key = "{key}"
uniform = [0.0, 0.01]

[[vary]]
key = "mission.rps"
values = [true, false]

[scenario.mission]
time_limit_s = 2.0
"""


class Blocks(Kind):
    """`campaign merge`, `status` and restarted parts with damaged blocks."""

    name, count = "blocks", 40
    BLOCKS = ["block-000000.jsonl", "block-000001.jsonl", "block-000002.jsonl"]

    def prepare(self):
        key = "sensors.placement.heading_sigma_rad"
        studies = {"sound": (3, key), "seed": (4, key), "study": (3, "sensors.geometry.track_sigma")}
        for name, (seed, key) in studies.items():
            (self.folder / f"{name}.toml").write_text(STUDY.format(seed=seed, key=key))
            for part in ("0/2", "1/2"):
                self.sound("campaign", f"{name}.toml", "--out", name, "--shard", part, "--threads", "1")
        self.sound("campaign", "merge", "sound", "--out", "merged")
        self.result = self.merged(self.folder / "merged")

    def merged(self, folder):
        return [(folder / name).read_bytes() for name in ("runs.csv", "result.json")]

    def case(self, rng, index, folder):
        shutil.copytree(self.folder / "sound", folder / "study")
        shutil.copy(self.folder / "sound.toml", folder)
        changes = [flip, cut, overwrite, append, self.foreign, self.renamed, self.gone, self.special, self.copy]
        change = changes[index % len(changes)]
        name = rng.choice(self.BLOCKS)
        path = folder / "study" / name
        if change in (flip, cut, overwrite, append):
            data = path.read_bytes()
            while (changed := change(data, rng)) == data:
                pass
            path.write_bytes(changed)
        else:
            change(folder / "study", name, rng)
        action = index // len(changes) % 4
        if action == 1:
            words = ["campaign", "merge", "study", "--out", "merged", "--partial"]
        elif action == 2:
            words = ["campaign", "status", "study", "--json", "status.json"]
        elif action == 3:
            words = ["campaign", "sound.toml", "--out", "study", "--threads", "1"]
        else:
            words = ["campaign", "merge", "study", "--out", "merged"]

        def check(ended):
            if ended.code != 0:
                return []
            if action == 0 and self.merged(folder / "merged") != self.result:
                return [(SILENT, f"another result than that of the sound blocks ({change.__name__})")]
            said = ended.err + ended.out.decode(errors="replace")
            if action == 1 and self.merged(folder / "merged") != self.result and "left out" not in said:
                return [(SILENT, f"blocks were left out without a word ({change.__name__})")]
            if action == 3 or action == 2 and " 6 of 6 runs" in said:
                again = self.bench.run(Case(["campaign", "merge", "study", "--out", "merged"]), folder)
                if again.code != 0 or self.merged(folder / "merged") != self.result:
                    column = SILENT if action == 2 else CODE
                    what = "all runs are counted" if action == 2 else "not repaired by a second run"
                    return [(column, f"{what} ({change.__name__}): {again.err.strip()[:200]}")]
            return []

        return Case(words, check=check)

    def foreign(self, study, name, rng):
        """Replaces a block by one of another seed or of another study."""
        shutil.copy(self.folder / rng.choice(["seed", "study"]) / name, study / name)

    def renamed(self, study, name, rng):
        """Stores a block under the name of another block, or exchanges both."""
        other = rng.choice([block for block in self.BLOCKS if block != name])
        content = (study / other).read_bytes()
        if rng.random() < 0.5:
            shutil.copy(study / name, study / other)
        (study / name).write_bytes(content)

    def gone(self, study, name, rng):
        (study / name).unlink()
        if rng.random() < 0.5:
            (study / name).write_bytes(b"")

    def special(self, study, name, rng):
        """Replaces a block by something other than a file."""
        path = study / name
        path.unlink()
        makes = [
            path.mkdir, lambda: os.mkfifo(path), lambda: path.symlink_to(path.name), lambda: path.symlink_to("gone"),
        ]
        rng.choice(makes)()

    def copy(self, study, name, rng):
        """Changes the copy of the study, or a manifest."""
        path = rng.choice([study / "study.toml", *sorted(study.glob("*.json"))])
        data = path.read_bytes()
        path.write_bytes(rng.choice([flip, cut, append])(data, rng))
