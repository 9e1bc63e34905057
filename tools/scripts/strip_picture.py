#!/usr/bin/env python3
"""Draws the strip from above with its gauges: docs/images/strip.svg.

    cfmmr config [--scenario FILE] | tools/scripts/strip_picture.py > strip.svg

Reads the scenario from standard input. Places of the gauges are robot.beam.strip.gauges_m.
"""
import sys
import tomllib

# Colours of crates/view/src/style.rs: frame, axles and wheels, truth, failure, ink.
FRAME, BODY, PLUS, MINUS, INK = "#e69f00", "#6e6e6e", "#0072b2", "#d55e00", "#000000"
WIDTH, HEIGHT = 780, 356
# Ends of the axles' distance on the page, and centre line of the strip.
REAR, FRONT, MIDDLE = 70, 710, 124
RULER = 186
HALF_STRIP, GAUGE = 6, 18


def line(x1, y1, x2, y2, color=INK, width=1.0, more=""):
    return f'<path d="M{x1:.1f} {y1:.1f} L{x2:.1f} {y2:.1f}" stroke="{color}" stroke-width="{width}" {more}/>'


def box(x, y, width, height, color, more=""):
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{color}" {more}/>'


def text(x, y, words, anchor="middle", more=""):
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{words}</text>'


def axle(x, outwards, name, clamp_end):
    """An axle with its wheels cut short, and the clamp from behind the axle to the strip."""
    top, bottom = MIDDLE - 62, MIDDLE + 42
    back = x + 18 * outwards
    yield line(x, top, x, bottom, BODY, 5)
    yield box(x - 20, top - 5, 40, 10, BODY, 'rx="3"')
    yield box(x - 20, bottom - 5, 40, 10, BODY, 'rx="3"')
    yield box(min(back, clamp_end), MIDDLE - 14, abs(back - clamp_end), 28, BODY)
    yield text(x, top - 14, name)


def picture(robot):
    gauges = robot["beam"]["strip"]["gauges_m"]
    length, rigid = robot["geometry"]["frame_length_m"], robot["geometry"]["rigid_end_m"]
    scale = (FRONT - REAR) / (length + 2 * rigid)
    root, tip = REAR + rigid * scale, FRONT - rigid * scale
    places = [(number, root + gauge * scale, 1e3 * gauge) for number, gauge in enumerate(gauges, 1)]

    yield box(0, 0, WIDTH, HEIGHT, "#ffffff")
    yield from axle(REAR, -1, "rear axle, C2", root)
    yield from axle(FRONT, 1, "front axle, C1", tip)
    yield box(root, MIDDLE - HALF_STRIP, tip - root, 2 * HALF_STRIP, FRAME)
    yield text((root + tip) / 2, 24, "strip seen from above, gauges on both faces", more='font-weight="bold"')
    yield text(root + 14, MIDDLE - 36, "left face", "start")
    yield text(root + 14, MIDDLE + 36, "right face", "start")
    yield text(tip - 14, MIDDLE + 36, "x, forward →", "end")
    for number, x, _ in places:
        for side in (-1, 1):
            y = MIDDLE + side * (HALF_STRIP + 2.5)
            yield box(x - GAUGE / 2, y - 2.5, GAUGE, 5, MINUS if side < 0 else PLUS)
        yield f'<circle cx="{x:.1f}" cy="{MIDDLE - 22}" r="9" fill="#ffffff" stroke="{INK}"/>'
        yield text(x, MIDDLE - 17.5, number)

    # Distances.
    yield line(root, RULER, tip, RULER)
    for x, words in [(root, "0"), *((x, f"{mm:.1f}") for _, x, mm in places), (tip, f"{1e3 * length:.1f}")]:
        end = x in (root, tip)
        yield line(x, RULER - 6, x, RULER + 6, width=1.6 if end else 1.0)
        yield line(x, MIDDLE + 16, x, RULER - 8, BODY, 0.6, 'stroke-dasharray="2 3"')
        # The ends beside their ticks, so that a gauge close to an end keeps its place.
        shift = 0 if not end else -14 if x == root else 20
        yield text(x + shift, RULER + 21, words)
    yield text(root - 14, RULER + 38, "root")
    yield text(tip + 20, RULER + 38, "tip")
    rigid_text = f"; {1e3 * rigid:.1f} mm of rigid clamp at each end" if rigid else ""
    yield text((root + tip) / 2, RULER + 42, f"mm from the root to the middle of each gauge{rigid_text}")

    # Sign.
    left, right, y, sag = 90, 330, 262, 88
    bend = f"M{left} {y + 40} Q{(left + right) / 2} {y + sag} {right} {y}"
    yield f'<path d="{bend}" fill="none" stroke="{FRAME}" stroke-width="12"/>'
    yield box(left - 14, y + 26, 14, 28, BODY)
    for x, dy in ((150, 60), (205, 58), (260, 44)):
        yield text(x, y + dy - 16, "−", more=f'fill="{MINUS}" font-weight="bold"')
        yield text(x + 4, y + dy + 24, "+", more=f'fill="{PLUS}" font-weight="bold"')
    yield text(372, y + 12, "strain &gt; 0: bend to the left, seen from the root", "start", 'font-weight="bold"')
    yield text(372, y + 34, "right face (+): stretched", "start", f'fill="{PLUS}"')
    yield text(372, y + 54, "left face (−): compressed", "start", f'fill="{MINUS}"')
    yield text(372, y + 76, "thickness and gauges not to scale", "start", f'fill="{BODY}"')


def main():
    robot = tomllib.load(sys.stdin.buffer).get("robot")
    if robot is None:
        sys.exit("strip_picture.py: no table [robot] on standard input; type: cfmmr config | strip_picture.py")
    print(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
          f'font-size="13" fill="{INK}">')
    print("<title>Places of the strain gauges on the strip</title>")
    print(*picture(robot), sep="\n")
    print("</svg>")


if __name__ == "__main__":
    main()
