"""Draws the terminal dashboard of a run as SVG: docs/images/dashboard.svg.

Needs the Python package pyte. The run keeps pace with the clock.

    dashboard_picture.py CFMMR SECONDS [ARGUMENT...] > dashboard.svg

CFMMR: the program. SECONDS: time from the start of the program to the picture.
"""

import fcntl
import os
import pty
import select
import struct
import sys
import termios
import time

import pyte
from pyte.graphics import FG_BG_256

COLUMNS, LINES = 100, 32
CELL_WIDTH, CELL_HEIGHT, MARGIN, FONT = 8, 17, 10, 13
BACKGROUND, FOREGROUND = "#1b1f24", "#d7dbe0"
# The terminal's own 16 colours, dull and bright, in the order of their numbers.
NAMED = ["#1b1f24", "#ff6b68", "#4fd6a0", "#e8bd4f", "#6cb2ff", "#f48fb1", "#4dd0e1", "#d7dbe0",
         "#8a939e", "#ff8a5c", "#7be8bd", "#ffe08a", "#9accff", "#ffb3cf", "#8fe9f5", "#ffffff"]
COLORS = dict(zip(FG_BG_256, NAMED))


def screen_after(seconds, command):
    """The screen of the command so long after its start."""
    screen = pyte.Screen(COLUMNS, LINES)
    stream = pyte.ByteStream(screen)
    child, terminal = pty.fork()
    if child == 0:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))
        os.environ["TERM"] = "xterm-256color"
        os.environ.pop("NO_COLOR", None)
        os.execvp(command[0], command)
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0:
        if select.select([terminal], [], [], left)[0]:
            try:
                stream.feed(os.read(terminal, 65536))
            except OSError:
                sys.exit(f"dashboard_picture.py: the program ended within {seconds:g} s")
    lines = [[screen.buffer[y][x] for x in range(COLUMNS)] for y in range(LINES)]
    # Twice: the second ends the program at once.
    try:
        for _ in range(2):
            os.write(terminal, b"q")
            time.sleep(0.3)
        while os.read(terminal, 65536):
            pass
    except OSError:
        pass
    os.waitpid(child, 0)
    return lines


def color(name, default):
    if name == "default":
        return default
    return COLORS.get(name, f"#{name}")


def look(cell):
    """Foreground, background and weight of a cell."""
    front, back = color(cell.fg, FOREGROUND), color(cell.bg, BACKGROUND)
    if cell.reverse:
        front, back = back, front
    return front, back, cell.bold


def escape(text):
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def runs(line):
    """Adjacent cells of one look: first column, text, look."""
    start = 0
    for x in range(1, len(line) + 1):
        if x == len(line) or look(line[x]) != look(line[start]):
            yield start, "".join(cell.data for cell in line[start:x]).replace("\u2800", " "), look(line[start])
            start = x


def svg(lines, title):
    width, height = COLUMNS * CELL_WIDTH + 2 * MARGIN, LINES * CELL_HEIGHT + 2 * MARGIN
    yield (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
           f'font-family="DejaVu Sans Mono, Menlo, Consolas, monospace" font-size="{FONT}">')
    yield f"<title>{escape(title)}</title>"
    yield f'<rect width="{width}" height="{height}" rx="6" fill="{BACKGROUND}"/>'
    for y, line in enumerate(lines):
        top = MARGIN + y * CELL_HEIGHT
        for x, text, (front, back, bold) in runs(line):
            left = MARGIN + x * CELL_WIDTH
            if back != BACKGROUND:
                yield (f'<rect x="{left}" y="{top}" width="{len(text) * CELL_WIDTH}" height="{CELL_HEIGHT}" '
                       f'fill="{back}"/>')
            # Each word at its column, whatever the width of the reader's font.
            weight = ' font-weight="bold"' if bold else ""
            at = 0
            for word in text.split(" "):
                if word:
                    yield (f'<text x="{left + at * CELL_WIDTH}" y="{top + CELL_HEIGHT - 4}" '
                           f'textLength="{len(word) * CELL_WIDTH}" lengthAdjust="spacingAndGlyphs" '
                           f'fill="{front}"{weight}>{escape(word)}</text>')
                at += len(word) + 1
    yield "</svg>"


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    program, seconds, *arguments = sys.argv[1:]
    lines = screen_after(float(seconds), [program, *arguments])
    print(*svg(lines, f"Terminal dashboard, {seconds} s after the start of the program"), sep="\n")


if __name__ == "__main__":
    main()
