#!/usr/bin/env python3
"""Runs `cfmmr hil` over serial ports: three emulated boards, each behind a pseudo-terminal.

Needs target/release/cfmmr and the emulated images (cargo build-axle and build-beam with
--features emulated). Further arguments go to `cfmmr hil`, for example --real-time. Ends with the
exit code of `cfmmr hil --compare`.
"""

import os
import pathlib
import pty
import selectors
import socket
import subprocess
import sys
import tempfile
import threading
import tty

ROOT = pathlib.Path(__file__).resolve().parents[2]
IMAGES = ROOT / "target" / "thumbv7em-none-eabihf" / "image"
BOARDS = {"front": "firmware-axle", "rear": "firmware-axle", "beam": "firmware-beam"}
START_S = 20  # time in which an emulated board opens its ports
LIMIT_S = 180


class Board:
    """An emulated board whose two serial ports are one pseudo-terminal."""

    def __init__(self, role, folder):
        listeners = []
        for name in ("in", "out"):
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(f"{folder}/{role}-{name}")
            listener.listen(1)
            listener.settimeout(START_S)
            listeners.append(listener)
        command = ["qemu-system-arm", "-M", "olimex-stm32-h405", "-kernel", IMAGES / BOARDS[role]]
        command += ["-display", "none", "-monitor", "none", "-serial", "null"]
        command += ["-serial", f"unix:{folder}/{role}-in", "-serial", f"unix:{folder}/{role}-out"]
        options = f"enable=on,target=native,arg=role={role},arg=link=uart"
        self.qemu = subprocess.Popen(
            [*command, "-semihosting-config", options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        self.to_board, self.from_board = (listener.accept()[0] for listener in listeners)
        self.terminal, far_end = pty.openpty()
        tty.setraw(far_end)
        # The far end stays open here, so that the host may close and open it as it likes.
        self.far_end, self.port = far_end, os.ttyname(far_end)

    def pump(self, selector):
        """Registers both directions."""
        selector.register(self.from_board, selectors.EVENT_READ, self.up)
        selector.register(self.terminal, selectors.EVENT_READ, self.down)

    def up(self):
        os.write(self.terminal, self.from_board.recv(4096))

    def down(self):
        self.to_board.sendall(os.read(self.terminal, 4096))


def main():
    program = ROOT / "target" / "release" / "cfmmr"
    for path in (program, *(IMAGES / image for image in set(BOARDS.values()))):
        if not path.exists():
            sys.exit(f"check_serial_ports.py: {path.relative_to(ROOT)} is missing: build it first")
    boards, hil = [], None
    with tempfile.TemporaryDirectory() as folder:
        try:
            selector = selectors.DefaultSelector()
            for role in BOARDS:
                boards.append((role, Board(role, folder)))
                boards[-1][1].pump(selector)
            ports = [word for role, board in boards for word in (f"--{role}", board.port)]
            command = [program, "hil", "--compare", *ports, "--out", f"{folder}/out", *sys.argv[1:]]
            hil = subprocess.Popen(command, stdin=subprocess.DEVNULL)
            overdue = threading.Timer(LIMIT_S, hil.kill)
            overdue.start()
            while hil.poll() is None:
                for key, _ in selector.select(timeout=0.1):
                    key.data()
            overdue.cancel()
        finally:
            if hil is not None and hil.poll() is None:
                hil.kill()
            for _, board in boards:
                board.qemu.kill()
                board.qemu.wait()
    sys.exit(hil.returncode)


if __name__ == "__main__":
    main()
