"""Drives a robot from 0, 0, 0 to a posture through the serial port of its front board (docs/serial.md).

pip install pyserial cobs crc32c
usage: drive.py PORT X Y PHI (m, m, rad)
"""
import os, struct, sys, time
import serial
from cobs import cobs
from crc32c import crc32c

PROTOCOL, HELLO, ORDER, KEEP, RELEASE, WATCH = 13, 0, 5, 6, 7, 16
PLACE, TASK, IDLE, REGULATE = 0, 1, 0, 3
REFUSED, REPORT = 5, 10
NOTHING = bytearray(2)

def varint(data):
    byte = data.pop(0)
    return byte if byte < 128 else byte - 128 + 128 * varint(data)

class Board:
    def __init__(self, path):
        self.port = serial.Serial(path, 921600, timeout=0.5, exclusive=True)
        self.number, self.owner, self.posture = 0, os.urandom(1)[0] % 128, None

    def receive(self):
        try:
            data = bytearray(cobs.decode(self.port.read_until(b"\0")[:-1]))
        except cobs.DecodeError:
            return NOTHING
        if len(data) < 6 or crc32c(data[:-4]) != int.from_bytes(data[-4:], "little"):
            return NOTHING
        if data[0] == 0 and data[1] == REPORT:
            report = data[2:-4]
            varint(report), varint(report)  # number of the report, number of lost entries
            del report[: varint(report)]  # entries
            offset, count = varint(report), varint(report)
            if offset == 0 and count > 111:  # after length, mode, and the estimates of both axles
                self.posture = struct.unpack_from("<3f", report, 2 + 1 + 2 * 48)
        return data

    def ask(self, *request):
        self.number += 1
        data = b"".join([bytes([self.number])] + [bytes(part) for part in request])
        for _ in range(20):
            self.port.write(b"\0" + cobs.encode(data + struct.pack("<I", crc32c(data))) + b"\0")
            until = time.monotonic() + 0.25
            while time.monotonic() < until:
                reply = self.receive()
                if reply[0] == self.number:
                    return sys.exit(f"refused for reason {reply[2]}") if reply[1] == REFUSED else None
        sys.exit("no answer")

    def order(self, *content):
        self.ask([ORDER, self.owner, self.number], *content)

def main(path, x, y, phi):
    board, sigmas = Board(path), [1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 1e-4]
    board.ask([HELLO, PROTOCOL, 1])
    board.ask([WATCH])
    board.order([PLACE], struct.pack("<25f", 0, 0, 0, *sigmas, 0.37, 0, 0, *sigmas, 0.01))
    board.order([TASK, REGULATE], struct.pack("<5f", x, y, phi, 0.1, 0.1))
    until, near, kept = time.monotonic() + 60, 0, 0
    try:
        while time.monotonic() < until and near < 500:
            board.receive()
            if time.monotonic() > kept + 0.25:  # without KEEP the robot stops after 1 s
                board.ask([KEEP, board.owner, board.number])
                kept = time.monotonic()
            near = near + 1 if board.posture and abs(complex(*board.posture[:2]) - complex(x, y)) < 0.01 else 0
    finally:
        board.order([TASK, IDLE])
        board.ask([RELEASE, board.owner, board.number])
    print("at", board.posture)
    return near < 500

if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(float, sys.argv[2:])) if len(sys.argv) == 5 else __doc__)
