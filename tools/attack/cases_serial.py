"""Peers on pseudo-terminals that do not behave as boards."""
import os
import re
import select
import struct
import threading
import time
import tty

from bench import CODE, Case, Kind

PROTOCOL = 14
HELLO, REFUSED, REPORT, LAST_REPLY = 0, 5, 10, 13


def crc32c(data):
    """CRC-32C (Castagnoli)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def varint(number):
    out = bytearray()
    while number >= 128:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes(out) + bytes([number])


def stuffed(data):
    """COBS encoding with a final byte 0."""
    out = bytearray()
    for part in data.split(b"\0"):
        while len(part) >= 254:
            out += b"\xff" + part[:254]
            part = part[254:]
        out += bytes([len(part) + 1]) + part
    return bytes(out) + b"\0"


def unstuffed(frame):
    out, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        out += frame[at + 1 : at + code]
        at += code
        if code < 255 and at < len(frame):
            out.append(0)
    return bytes(out)


def framed(payload):
    return stuffed(payload + struct.pack("<I", crc32c(payload)))


# Example frame of docs/serial.md.
assert framed(bytes.fromhex("01000dac02")).hex() == "0201080dac0250da40c800"


def greeting(number, nonce, protocol=PROTOCOL):
    """Reply of a front board to a hello; `nonce` has the bytes of the varint."""
    build = b"firmware-axle 0.1.0"
    return framed(bytes([number, HELLO, protocol]) + nonce + b"\0" + bytes([len(build)]) + build + bytes(3))


class Port:
    """Pseudo-terminal that the program opens by name."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.name = os.ttyname(self.slave)
        self.waiting = b""
        os.set_blocking(self.master, False)

    def write(self, data):
        try:
            os.write(self.master, data)
        except OSError:
            # The terminal is full or closed.
            time.sleep(0.001)

    def read(self):
        """Bytes received within 20 ms."""
        ready, _, _ = select.select([self.master], [], [], 0.02)
        try:
            return os.read(self.master, 4096) if ready else b""
        except OSError:
            time.sleep(0.02)
            return b""

    def requests(self):
        """Requests received within 20 ms: number, request and content."""
        *frames, self.waiting = (self.waiting + self.read()).split(b"\0")
        payloads = [unstuffed(frame)[:-4] for frame in frames if len(frame) > 6]
        return [payload for payload in payloads if len(payload) > 1]

    def close(self):
        for end in ("slave", "master"):
            if (descriptor := getattr(self, end)) is not None:
                setattr(self, end, None)
                os.close(descriptor)


# Peers. A peer is called repeatedly until the program has ended.


def silent(port, rng):
    port.read()


def noise(port, rng):
    """Random bytes, about 1000 a second."""
    port.read()
    port.write(rng.randbytes(20))


def flood(port, rng):
    """Random bytes without pause."""
    port.write(rng.randbytes(2048))


def endless(port, rng):
    """Endless frame."""
    port.read()
    port.write(b"\x2a" * 200)


def echo(port, rng):
    port.write(port.read())


def old(port, rng):
    """Greetings of another session with every number, of this and of the previous protocol."""
    port.read()
    for number in range(256):
        port.write(greeting(number, varint(7), rng.choice([PROTOCOL - 1, PROTOCOL])))


def damaged(port, rng):
    """Greetings with one flipped bit."""
    for request in port.requests():
        frame = bytearray(greeting(request[0], request[3:]))
        frame[rng.randrange(len(frame) - 1)] ^= 1 << rng.randrange(8)
        port.write(bytes(frame))


def hello(port, rng):
    """Replies to hellos only."""
    for request in port.requests():
        if request[1] == HELLO:
            port.write(greeting(request[0], request[3:]))


def liar(port, rng):
    """Greets, then sends random replies with right number and checksum."""
    for request in port.requests():
        if request[1] == HELLO and rng.random() < 0.9:
            port.write(greeting(request[0], request[3:]))
        else:
            content = rng.choice([b"", bytes(8), b"\xff" * 12, rng.randbytes(rng.randrange(1, 60))])
            port.write(framed(bytes([request[0], rng.randrange(LAST_REPLY + 2)]) + content))


def reporter(port, rng):
    """Greets, replies done to every request, and sends reports with random content."""
    for request in port.requests():
        done = framed(bytes([request[0], 1]))
        port.write(greeting(request[0], request[3:]) if request[1] == HELLO else done)
    sizes = varint(rng.randrange(65536)) + varint(rng.randrange(3))
    body = rng.randbytes(rng.randrange(150))
    port.write(framed(bytes([0, REPORT]) + sizes + varint(len(body)) + body + bytes(2)))


def closing(port, rng):
    """Closes the port after the first byte."""
    if port.master is not None and port.read():
        port.close()
    time.sleep(0.02)


PEERS = [silent, noise, echo, old, damaged, closing, flood, hello, liar, reporter, endless]
# Expected errors; the errors for other peers vary.
SILENCE = r"nothing arrived|silent"
FOREIGN = r"bytes arrived|returns every byte|answer that does not|no answer in .*: \d+|refuse|protocol"
COMMANDS = [["params", "list"], ["posture"], ["drive", "stop"], ["follow"], ["hil"], ["params", "get", "button.action"]]


class Serial(Kind):
    """Commands at a port without a proper board, and two programs at one port."""

    name, count = "serial", 12
    parallel = 12

    def case(self, rng, index, folder):
        port = Port()
        second = index % (len(PEERS) + 1) == len(PEERS)
        peer = silent if second else PEERS[index % (len(PEERS) + 1)]
        command = ["params", "list"] if second else COMMANDS[(index + index // (len(PEERS) + 1)) % len(COMMANDS)]
        others = []

        def during(process):
            act = threading.Thread(target=self.second, args=(port, folder, others)) if second else None
            if act:
                act.start()
            while process.poll() is None:
                peer(port, rng)
            if act:
                act.join()
            port.close()

        def check(ended):
            if second:
                right = others[0].code == 2 and "another program" in others[0].err
                return [] if right else [(CODE, f"second program: {others[0].code}: {others[0].err.strip()[:200]}")]
            if peer == silent and not re.search(SILENCE, ended.err):
                return [(CODE, f"silence is not named: {ended.err.strip()[:200]}")]
            if peer in (noise, flood, endless, echo) and not re.search(FOREIGN, ended.err):
                return [(CODE, f"{peer.__name__}: foreign bytes are not named: {ended.err.strip()[:200]}")]
            return []

        words = [*command, "--on", f"serial:front={port.name}"]
        return Case(words, codes=(1, 2), refuse=f"no board: {peer.__name__}", limit=20, during=during, check=check)

    def second(self, port, folder, others):
        """Starts a second program while the first program uses the port."""
        time.sleep(1.0)
        others.append(self.bench.run(Case(["params", "list", "--on", f"serial:front={port.name}"]), folder))
