"""Opens the report pages of runs in a headless Chromium, at desktop and phone width, in light and dark mode, and uses
them. Checks that there is no error, and that playing, the slider and a plot move the robot.

Needs Chromium and the Python package websocket-client.

    check_report.py CFMMR [FOLDER]      CFMMR: the program; FOLDER: keeps the screenshots
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from browser import Browser

WIDTHS = {"desk": (1280, 900, False), "tablet": (400, 800, True), "phone": (360, 740, True)}


def scene(browser):
    """Sum over the pixels of the scene."""
    return browser.value(
        "(() => { const c = document.getElementById('scene'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " let h = 0; for (let i = 0; i < d.length; i++) h = (h * 31 + d[i]) | 0; return h; })()"
    )


def moved(a, b):
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


SLIDE = (
    "(() => { const s = document.getElementById('time'); s.value = String(Math.round(%s * Number(s.max)));"
    " s.dispatchEvent(new Event('input')); })()"
)


def use(browser, name, width):
    """Operates every control of a page and checks the effects."""
    length = browser.value("report.length()")
    assert length > 5.0, length
    # The run plays as soon as the page is open.
    browser.until(lambda: browser.value("report.time()") > 0.2, f"{name}: playing from the start")
    assert browser.value("report.playing()"), name
    browser.value(SLIDE % 0.0)
    assert not browser.value("report.playing()"), name
    start, empty = browser.value("report.pose()"), scene(browser)
    browser.value("document.getElementById('speed').value = '20'; document.getElementById('play').click()")
    browser.until(lambda: browser.value("report.time()") > 0.5 * length, f"{name}: playing")
    assert moved(browser.value("report.pose()"), start) > 0.05 and scene(browser) != empty, name
    browser.until(lambda: not browser.value("report.playing()"), f"{name}: the end")
    assert browser.value("report.time()") == length, name
    poses, scenes = [], []
    for share in (0.2, 0.5, 0.8):
        browser.value(SLIDE % share)
        assert abs(browser.value("report.time()") - share * length) < 0.02, name
        poses.append(browser.value("report.pose()"))
        scenes.append(scene(browser))
    assert len(set(scenes)) == 3 and moved(poses[0], poses[1]) > 0.02, (name, poses)
    # A click in the middle of a plot selects the middle of the time.
    box = browser.value(
        "(() => { const c = document.querySelector('.plot canvas'); c.scrollIntoView({ block: 'center' });"
        " const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })()"
    )
    browser.click(box[0] + 46 + (box[2] - 54) / 2, box[1] + box[3] / 2)
    assert abs(browser.value("report.time()") - 0.5 * length) < 0.02 * length, name
    browser.value("document.getElementById('view').value = 'robot'; document.getElementById('view').dispatchEvent(new Event('change'))")
    assert scene(browser) not in scenes, name
    browser.value("document.getElementById('view').value = 'all'; document.getElementById('view').dispatchEvent(new Event('change')); window.scrollTo(0, 0)")
    browser.value(SLIDE % 0.45)
    # A phone enlarges its window to what the page needs, so the width of the screen counts.
    wide = browser.value("document.documentElement.scrollWidth")
    assert wide <= width, f"{name}: {wide} px wide"
    outside = browser.value(
        "[...document.querySelectorAll('main *')].filter((e) => !e.closest('pre')"
        f" && e.getBoundingClientRect().right > {width} + 0.5).map((e) => e.tagName + ' ' + e.className)"
    )
    assert not outside, (name, outside)
    cells = browser.value("[...document.querySelectorAll('#summary td')].map((cell) => cell.textContent)")
    assert len(cells) >= 8 and all(cells), (name, cells)
    assert "[mission]" in browser.value("document.getElementById('configuration').textContent"), name
    # The plots' data of a successful run have no gap.
    gaps = browser.value("JSON.parse(document.getElementById('data').textContent).runs.flatMap((r) => r.plots.flatMap((p) => p.series.filter((s) => s.data.includes(null)).map((s) => p.title + ' ' + s.name)))")
    assert not gaps, (name, gaps)


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    program = sys.argv[1]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        shots = Path(sys.argv[2]) if len(sys.argv) == 3 else folder
        shots.mkdir(parents=True, exist_ok=True)
        runs = {
            "posture": ["posture", "--trials", "2", "--rows", "pair"],
            "follow": ["follow", "--path", "figure-eight"],
            "chain": ["follow", "--path", "figure-eight", "--axles", "3", "--world", "ideal"],
            "track": ["track", "--path", "circle", "--size", "0.8", "--imu"],
        }
        for run, arguments in runs.items():
            subprocess.run([program, *arguments, "--out", folder / run], check=True, capture_output=True)
        browser = Browser(folder / "profile")
        try:
            count = 0
            for run in runs:
                for width, (w, h, mobile) in WIDTHS.items():
                    for scheme in ("light", "dark"):
                        case = f"{run}-{width}-{scheme}"
                        browser.emulate(w, h, mobile, scheme)
                        browser.open(folder / run / "report.html", "window.report")
                        use(browser, case, w)
                        assert not browser.wrong(), (case, browser.wrong())
                        browser.screenshot(shots / f"{case}.png", whole=True)
                        count += 1
        finally:
            browser.close()
    print(f"{len(runs)} pages, {count} times opened and used: no error")


if __name__ == "__main__":
    main()
