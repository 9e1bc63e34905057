"""Uses the browser page in a headless Chromium as a visitor does, by mouse, keys and fingers, and checks the effects.
Then carries out random actions.

Needs Chromium and the Python package websocket-client.

    check_page.py PAGE [FOLDER] [--only NAME] [--actions N] [--seeds N …] [--trials N] [--keep-going]

PAGE: target/web/cfmmr.html; FOLDER: keeps the screenshots; --only: checks whose name contains NAME; --actions: random
actions a seed (1000 take half a minute); --trials: trials that are carried out instead of the 100 that the page asks for.
"""

import argparse
import csv
import json
import math
import random
import struct
import tempfile
import time
import traceback
import zlib
from pathlib import Path

from browser import CONTROL, SHIFT, Browser

MAX_BYTES = 1_100_000
# Tolerance of a goal, m.
TOLERANCE_M = 0.1
DESK, TABLET, PHONE = (1280, 900), (400, 800), (360, 740)

# Runs before the scripts of the page: time until it is ready.
BEFORE = """{ const timer = setInterval(() => { if (window.cfmmr && cfmmr.ready()) { window.readyMs = performance.now(); clearInterval(timer); } }, 5); }"""

# Runs in the loaded page. Limits the number of trials; observes what is drawn in the colour of the estimate while there
# is no valid estimate. The line of earlier estimates is left out for this, since it stays.
WATCH = """(() => {
  window.watch = { asked: [], invalid: 0, drawn: 0, seen: 0 };
  const trials = Trials.prototype.run;
  Trials.prototype.run = function (count, ...rest) { watch.asked.push(count); return trials.call(this, Math.min(count, %d), ...rest); };
  let marks = 0;
  for (const name of ["stroke", "fill", "fillRect"]) {
    const own = CanvasRenderingContext2D.prototype[name];
    CanvasRenderingContext2D.prototype[name] = function (...given) {
      const style = document.createElement("canvas").getContext("2d");
      if (this.canvas.id === "scene") {
        style.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--estimate").trim();
        if ((name === "stroke" ? this.strokeStyle : this.fillStyle) === style.fillStyle) marks += 1;
      }
      return own.apply(this, given);
    };
  }
  const draw = Stage.prototype.draw, valid = (row) => page.layout.of(row, "valid")[0] === 1;
  Stage.prototype.draw = function (row, held) {
    const line = this.trails.estimate, hidden = !valid(row);
    marks = 0;
    if (hidden) this.trails.estimate = [];
    draw.call(this, row, held);
    if (hidden) { this.trails.estimate = line; watch.invalid += 1; watch.drawn += marks; } else if (marks) watch.seen += 1;
  };
  const add = Stage.prototype.add, points = (stage) => stage.trails.estimate.flat().length;
  Stage.prototype.add = function (row) {
    const before = points(this);
    add.call(this, row);
    if (!valid(row) && points(this) > before) watch.drawn += 1;
  };
  return true;
})()"""

# Number of pixels of the scene in a colour of the page.
PIXELS = """(() => {
  const probe = document.createElement("canvas").getContext("2d");
  probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("%s").trim(); probe.fillRect(0, 0, 1, 1);
  const wanted = probe.getImageData(0, 0, 1, 1).data, c = document.getElementById("scene");
  const data = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  let count = 0;
  for (let i = 0; i < data.length; i += 4)
    if (data[i + 3] > 200 && [0, 1, 2].every((k) => Math.abs(data[i + k] - wanted[k]) <= 6)) count += 1;
  return count;
})()"""


class Page:
    def __init__(self, browser, path, shots, options):
        self.browser, self.path, self.shots, self.options = browser, path, shots, options
        self.value = browser.value
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=BEFORE)

    def open(self, fragment="", size=DESK, scheme="light", motion="no-preference", watch=True):
        mobile = size[0] < 500
        self.browser.emulate(*size, mobile, scheme, motion)
        self.browser.open(self.path, "window.cfmmr && cfmmr.ready()", fragment)
        # Watching takes longer than drawing.
        if watch:
            self.value(WATCH % self.options.trials)

    def check_clean(self):
        """No error has been reported, no invalid estimate was drawn, nothing was requested."""
        assert not self.browser.wrong(), self.browser.wrong()
        assert len(self.browser.requests()) == 1, self.browser.requests()
        errors = self.value("cfmmr.errors()")
        assert not errors, errors
        assert not self.value("window.watch?.drawn"), f"an estimate that is not valid was drawn {self.value('watch.drawn')} times"

    def shot(self, name, whole=False):
        if self.shots:
            self.browser.screenshot(self.shots / f"{name}.png", whole)

    def state(self, name):
        return self.value(f"cfmmr.state('{name}')")

    def one(self, name):
        return self.state(name)[0]

    def time(self):
        return self.one("time_s")

    def text(self, name):
        return self.value(f"find('{name}').textContent")

    def until(self, expression, what):
        self.browser.until(lambda: self.value(expression), what)

    def during(self, seconds, expression, what):
        """Waits until an expression holds; it must within a simulated time."""
        end = self.time() + seconds
        result = lambda: self.value(f"({expression}) ? 1 : cfmmr.time() > {end} ? 2 : 0")
        found = []
        self.browser.until(lambda: found.append(result()) or found[-1], what)
        assert found[-1] == 1, f"{what}: not within {seconds} s of simulated time; {self.text('sentence')} {self.text('note')}"

    def go_on(self, seconds):
        self.during(seconds + 60, f"cfmmr.time() > {self.time() + seconds}", "time goes on")

    def pace(self, value):
        self.choose("pace", value)

    def middle(self, name):
        """Middle of an element, scrolled into the window."""
        return self.value(
            f"(() => {{ const e = find('{name}'); e.scrollIntoView({{ block: 'center' }});"
            " const b = e.getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]; })()"
        )

    def click(self, name):
        self.browser.click(*self.middle(name))

    def choose(self, name, value):
        self.value(f"(() => {{ const e = find('{name}'); e.value = {json.dumps(str(value))}; e.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()")

    def inject(self, fault):
        self.value(f"[...find('faults').children].find((b) => b.textContent === {json.dumps(fault)}).click()")
        self.until(f"[...find('faults').children].find((b) => b.textContent === {json.dumps(fault)}).getAttribute('aria-pressed') === 'true'", f"{fault}: pressed")

    def stop_time(self):
        if self.value("page.running"):
            self.click("play")
        # The answer to a call comes after the last epoch.
        self.value("page.robot.call('run', { on: false }).then(() => new Promise((done) => setTimeout(done, 50)))")

    def start_time(self):
        if not self.value("page.running"):
            self.click("play")

    def still_view(self):
        """Stops the camera, so that pixels of the floor stay."""
        self.choose("view", "all")
        self.camera_rests()
        self.choose("view", "free")

    def camera_rests(self):
        self.until("(dirty(), page.stage.wanted(page.history.latest).every((v, k) => Math.abs(v - page.stage.bounds[k]) < 0.01))", "the camera rests")

    def pixel(self, at):
        """Pixel in the window of a place on the floor, m."""
        return self.value(
            f"(() => {{ window.scrollTo(0, 0); const b = find('scene').getBoundingClientRect(), v = page.stage.view;"
            f" return [b.left + v.X({at[0]}), b.top + v.Y({at[1]})]; }})()"
        )

    def tip(self, at):
        return self.pixel(self.value(f"page.stage.tip(page.stage.view, {json.dumps(at)})"))

    def drag(self, start, *through):
        self.browser.drag([self.pixel(start), *map(self.pixel, through)])

    def pixels(self, color):
        self.value("new Promise((done) => { dirty(); requestAnimationFrame(() => requestAnimationFrame(done)); })")
        return self.value(PIXELS % color)

    def reaches(self, goal, what):
        """The robot comes to rest on a goal."""
        self.during(150, "cfmmr.state('done')[0] === 1", f"{what}: rest at the goal")
        truth = self.state("truth")
        assert math.dist(truth[:2], goal[:2]) <= TOLERANCE_M, (what, truth, goal)
        self.go_on(1.0)
        assert math.dist(truth[:2], self.state("truth")[:2]) < 0.002, f"{what}: the robot still moves"
        return truth

    def departs(self):
        """Time in which an order resets `done`. A fast simulation may have reached the goal before the next look."""
        self.go_on(0.5)

    def codes(self):
        """Codes that hold, from the numbers of the state."""
        numbers = [self.one("failed"), *self.state("reasons")]
        table = self.value("page.contract.codes")
        numbers += [code["code"] for code, holds in zip(table, self.state("notices")) if holds]
        return [code for code in table if code["code"] in numbers]

    def check_codes_named(self):
        """All codes that hold stand on the page, with the table's words and advice."""
        self.stop_time()
        codes = self.codes()
        items = lambda: self.value("[...find('codes').children].map((item) => item.textContent)")
        self.value("dirty()")
        self.browser.until(lambda: len(items()) == len(codes), f"codes {[code['name'] for code in codes]} on the page, not {items()}")
        for code in codes:
            assert any(item.startswith(code["name"]) and code["meaning"] in item and code["remedy"] in item for item in items()), (code, items())
        return [code["name"] for code in codes]


def wrap(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def to_line(point, line):
    """Distance from a point to a polyline."""
    def to_segment(a, b):
        length = math.dist(a, b)
        share = 0.0 if length == 0 else max(0.0, min(1.0, sum((p - q) * (r - q) for p, q, r in zip(point, a, b)) / length**2))
        return math.dist(point, [q + share * (r - q) for q, r in zip(a, b)])

    return min(to_segment(a, b) for a, b in zip(line, line[1:]))


def check_file(page):
    size = Path(page.path).stat().st_size
    assert size <= MAX_BYTES, f"{size} bytes: at most {MAX_BYTES}"
    page.open(watch=False)
    page.go_on(5.0)
    page.shot("desk")
    imports = page.value("WebAssembly.Module.imports(page.trials.module).length")
    assert imports == 0, f"{imports} imports of the WebAssembly module"
    assert page.value("page.robot.worker instanceof Worker"), "the simulation is not in a Worker"
    page.check_clean()
    return f"{size} bytes, ready after {page.value('readyMs'):.0f} ms, busy {page.value('cfmmr.busy()'):.1f} ms a frame at ×1 (p50)"


def check_goal(page):
    """A goal dragged and turned by the mouse."""
    page.open()
    page.pace(50)
    page.reaches(page.value("cfmmr.goal()"), "first goal")
    page.still_view()
    goal = page.value("cfmmr.goal()")
    wanted = [goal[0] - 0.6, goal[1] - 0.9]
    page.drag(goal, [goal[0] - 0.2, goal[1] - 0.5], wanted)
    page.departs()
    moved = page.value("cfmmr.goal()")
    assert math.dist(moved[:2], wanted) < 0.02 and moved[2] == goal[2], (moved, wanted)
    truth = page.reaches(moved, "dragged goal")
    page.browser.drag([page.tip(moved), page.pixel([moved[0] + 0.3, moved[1] + 0.3]), page.pixel([moved[0], moved[1] + 0.5])])
    page.departs()
    turned = page.value("cfmmr.goal()")
    assert turned[:2] == moved[:2] and abs(wrap(turned[2] - math.pi / 2)) < 0.05, turned
    truth = page.reaches(turned, "turned goal")
    assert abs(wrap(truth[2] - turned[2])) < 0.1, (truth, turned)
    page.shot("goal")
    page.check_clean()
    return f"true distance {100 * math.dist(truth[:2], turned[:2]):.1f} cm"


def check_robot(page):
    """The robot dragged and turned by the mouse."""
    page.open()
    page.go_on(1.0)
    page.stop_time()
    page.still_view()
    before, start = page.time(), page.state("truth")
    wanted = [start[0] + 0.3, start[1] + 0.7]
    page.drag(start, [start[0] + 0.1, start[1] + 0.5], wanted)
    page.until(f"Math.abs(cfmmr.state('truth')[1] - {wanted[1]}) < 0.05", "the robot stands where it was dragged")
    page.pace(1)
    page.start_time()
    page.during(2, "cfmmr.state('valid')[0] === 1", "an estimate")
    page.stop_time()
    truth, estimate = page.state("truth"), page.state("estimate")
    assert math.dist(truth[:2], wanted) < 0.05 and abs(wrap(truth[2] - start[2])) < 0.1, (truth, wanted)
    assert math.dist(estimate[:2], wanted) < 0.03, (estimate, wanted)
    assert page.time() >= before, "time begins again"
    page.browser.drag([page.tip(truth), page.pixel([truth[0] + 0.3, truth[1] - 0.2]), page.pixel([truth[0] + 0.3, truth[1] - 0.3])])
    page.until(f"Math.abs(cfmmr.state('truth')[2] + Math.PI / 4) < 0.1", "the robot is turned")
    page.pace(50)
    page.browser.click(*page.pixel(page.value("cfmmr.goal()")))
    page.departs()
    page.reaches(page.value("cfmmr.goal()"), "from another place")
    page.check_clean()


def draw(page, stroke):
    page.click("draw")
    assert page.value("find('draw').getAttribute('aria-pressed')") == "true"
    page.drag(*stroke)


def standing(page):
    """The robot of seed 1, at rest near its start."""
    page.open()
    page.click("halt")
    page.go_on(1.0)
    page.during(5, "Math.abs(cfmmr.state('speed')[0]) < 0.001", "stands still")
    page.pace(50)
    page.still_view()
    return page.state("truth")


def check_path(page):
    x, y, _ = standing(page)
    stroke = [[x + 0.05 * k, y + (max(0, k - 6) * 0.05) ** 2 / 2.2] for k in range(33)]
    draw(page, stroke)
    page.until("page.task === 'path'", "the path is accepted")
    planned = page.value("page.stage.planned")
    off = max(to_line(point, planned) for point in stroke)
    assert off < 0.05, f"the planned path is {off} m beside the drawn one"
    page.start_time()
    page.departs()
    truth = page.reaches(stroke[-1], "path")
    trail = page.value("page.stage.trails.truth.flat()")
    beside = max(to_line(point, stroke) for point in trail)
    assert beside < TOLERANCE_M, f"{beside} m beside the path"
    assert page.text("sentence") == "Rests at the end of the path.", page.text("sentence")
    page.shot("path")
    page.check_clean()
    return f"end {100 * math.dist(truth[:2], stroke[-1]):.1f} cm, beside the path {100 * beside:.1f} cm at most"


def check_zigzag(page):
    x, y, _ = standing(page)
    red = page.pixels("--failure")
    stroke = [[x, y]] + [[x + 0.3 + 0.12 * k, y + 1.4 * (k % 2)] for k in range(9)]
    draw(page, stroke)
    page.until("find('note').textContent.startsWith('Path refused')", "the zigzag is refused")
    reason = page.text("note")
    at = page.value("page.stage.refusal.at")
    assert f"x = " in reason and " m, y = " in reason and len(reason) > 60, reason
    assert to_line(at, stroke) < 0.4, (at, reason)
    assert page.pixels("--failure") > red + 50, "the place is not marked on the scene"
    assert page.value("page.stage.planned.length") == 0 and page.value("page.task") != "path"
    page.shot("zigzag")
    page.check_clean()
    return reason


def focus(page, name, most=120):
    """Tab to a control."""
    for _ in range(most):
        if page.value("document.activeElement.id") == name:
            return
        page.browser.key("Tab")
    raise AssertionError(f"{name} is not reached by Tab")


def check_tour(page):
    """Six steps by keys only."""
    page.open()
    page.browser.key("+", times=5)
    assert page.value("cfmmr.speed()") == 50, "the key + changes the pace"
    focus(page, "tour-open")
    page.browser.key("Enter")
    results = []
    steps = [tour_curve, tour_without, tour_with, tour_gauge, tour_slip, tour_paper]
    for number, step in enumerate(steps, 1):
        assert page.text("tour-title") == f"Tour, step {number} of {len(steps)}", page.text("tour-title")
        assert page.value("document.activeElement.id") == "tour-act", page.value("document.activeElement.id")
        text = page.text("tour-text")
        assert text.count(".") == 1 and text.endswith("."), f"one sentence: {text}"
        generation = page.value("page.generation")
        # The floor becomes slippery at a time: a slow simulation is still on its way then.
        page.pace(5 if step is tour_slip else 50)
        page.browser.key("Enter")
        if step is not tour_paper:
            page.until(f"page.generation > {generation} && page.history.length > 50", f"step {number}: begins again")
        results.append(step(page))
        page.shot(f"tour-{number}")
        focus(page, "tour-next")
        page.browser.key("Enter")
    assert page.value("find('tour').hidden && document.activeElement.id === 'tour-open'"), "the tour ends where it began"
    without, with_gauges = results[1], results[2]
    assert without > 1.5 * with_gauges, f"95 % limit {without} m without gauges, {with_gauges} m with gauges"
    page.check_clean()
    return f"95 % limit without gauges {100 * without:.1f} cm, with gauges {100 * with_gauges:.1f} cm; {results[4]}"


def limit_95(page):
    xx, xy, yy, _ = page.state("covariance")
    return 2.448 * math.sqrt((xx + yy) / 2 + math.hypot((xx - yy) / 2, xy))


def tour_curve(page):
    start = page.value("Array.from(page.layout.of(page.history.row(0), 'truth'))")
    assert page.value("find('view').value") == "robot"
    page.during(20, "cfmmr.time() > 6 && Math.abs(cfmmr.state('strain')[2]) > 1e-4", "the strip bends")
    page.during(20, "cfmmr.time() > 11", "the curve")
    truth = page.state("truth")
    assert abs(truth[2] - start[2]) > 0.8, (start, truth)
    page.go_on(1.0)
    assert math.dist(truth[:2], page.state("truth")[:2]) < 0.01, "the robot stops after the curve"


def innovations(page):
    """Number of epochs in which the gauges corrected the estimate."""
    return page.value("Array.from({ length: page.history.length }, (_, i) => page.layout.of(page.history.row(i), 'innovation')[0]).filter((d) => Math.abs(d) > 0).length")


def tour_without(page):
    assert not page.value("find('gauges').checked") and "gauges=false" in page.value("location.hash")
    page.during(150, "cfmmr.state('done')[0] === 1", "rest without gauges")
    assert innovations(page) == 0, "gauges are in use"
    return limit_95(page)


def tour_with(page):
    assert page.value("find('gauges').checked") and "gauges" not in page.value("location.hash")
    page.reaches(page.value("cfmmr.goal()"), "with gauges")
    assert innovations(page) > 100, "gauges are not in use"
    return limit_95(page)


def tour_gauge(page):
    page.during(20, "[...find('codes').children].some((item) => item.textContent.includes('gauge'))", "the broken gauge is named")
    page.reaches(page.value("cfmmr.goal()"), "with a broken gauge")


def tour_slip(page):
    page.during(60, "find('sentence').textContent.startsWith('Stopped')", "stops on a slippery floor")
    assert page.value("Number(find('friction').value)") < 0.2
    assert page.value("find('codes').children.length") > 0 and "Advice:" in page.text("codes")
    return page.text("sentence")


def tour_paper(page):
    rows = lambda: page.value("[...find('trials').rows].map((row) => [...row.cells].map((cell) => cell.textContent))")
    page.browser.until(lambda: [row[1] for row in rows()] == [str(page.options.trials)] * 2, "two rows of trials")
    assert page.value("watch.asked") == [100, 100], page.value("watch.asked")
    error = [float(row[2].split()[0]) for row in rows()]
    assert "without gauges" in rows()[0][0] and error[0] > error[1], rows()


def check_focus(page):
    """Every control is reached by Tab, shows the focus, and has a name for screen readers."""
    page.open()
    page.stop_time()
    page.click("tour-open")
    page.value("document.activeElement.blur(); window.scrollTo(0, 0)")
    page.value("[...document.querySelectorAll('details')].forEach((d) => { d.open = true; })")
    wanted = page.value(
        "(window.controls = [...document.querySelectorAll('button, select, input, summary, a[href], [tabindex]')]"
        ".filter((e) => !e.disabled && e.checkVisibility())).map((e) => e.id || e.textContent)"
    )
    reached, unseen = set(), []
    for _ in range(len(wanted) + 10):
        page.browser.key("Tab")
        index, name, shown = page.value(
            "(() => { const e = document.activeElement, s = getComputedStyle(e);"
            " return [controls.indexOf(e), e.id || e.textContent.slice(0, 20), s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2]; })()"
        )
        reached.add(index)
        if name and index >= 0 and not shown:
            unseen.append(name)
    missed = [name for number, name in enumerate(wanted) if number not in reached]
    assert not missed, f"not reached by Tab: {missed}"
    assert not unseen, f"focus without outline: {unseen}"
    page.browser.call("Accessibility.enable")
    nodes = page.browser.call("Accessibility.getFullAXTree")["nodes"]
    page.browser.call("Accessibility.disable")
    roles = {"button", "checkbox", "combobox", "slider", "textbox", "img", "application", "DisclosureTriangle", "MenuListPopup"}
    named = [n for n in nodes if not n.get("ignored") and n.get("role", {}).get("value") in roles - {"MenuListPopup"}]
    nameless = [n["role"]["value"] for n in named if not n.get("name", {}).get("value", "").strip()]
    assert len(named) >= 30 and not nameless, (len(named), nameless)
    page.check_clean()
    return f"{len(wanted)} controls, {len(named)} names"


def check_keys(page):
    """Goal, robot and driving by keys."""
    page.open()
    page.pace(50)
    page.reaches(page.value("cfmmr.goal()"), "first goal")
    page.value("window.scrollTo(0, 0); find('scene').focus()")
    goal = page.value("cfmmr.goal()")
    focus(page, "goal-handle")
    page.browser.key("ArrowLeft", times=8)
    page.browser.key("ArrowDown", times=4)
    page.browser.key("ArrowUp", SHIFT)
    page.browser.key("q", times=2)
    assert page.value("cfmmr.goal()") == goal, "the goal moves before Enter"
    page.browser.key("Enter")
    page.departs()
    moved, wanted = page.value("cfmmr.goal()"), [goal[0] - 0.4, goal[1] - 0.19, goal[2] + math.pi / 18]
    assert all(abs(a - b) < 1e-9 for a, b in zip(moved, wanted)), (moved, wanted)
    page.reaches(moved, "goal by keys")
    page.browser.key("ArrowUp", times=3)
    page.browser.key("Escape")
    page.browser.key("Tab")
    assert page.value("cfmmr.goal()") == moved, "Escape leaves the goal"
    page.value("find('scene').focus()")
    focus(page, "robot-handle")
    before, clock = page.state("truth"), page.time()
    page.browser.key("ArrowDown", times=10)
    page.browser.key("Enter")
    page.until(f"Math.abs(cfmmr.state('truth')[1] - {before[1] - 0.5}) < 0.05", "the robot placed by keys")
    assert page.time() >= clock
    page.pace(5)
    page.value("document.activeElement.blur()")
    drive_by_keys(page, "w", "s", "a")
    page.value("find('scene').focus()")
    drive_by_keys(page, "ArrowUp", "ArrowDown", "ArrowLeft")
    page.browser.key(" ")
    assert not page.value("page.running"), "Space pauses"
    page.stop_time()
    page.value("document.activeElement.blur()")
    clock = page.time()
    page.browser.key(".")
    page.until(f"cfmmr.time() > {clock}", "one epoch")
    page.value("new Promise((done) => setTimeout(done, 50))")
    assert abs(page.time() - clock - 0.01) < 1e-9, (page.time(), clock)
    pace = page.value("cfmmr.speed()")
    page.browser.key("-")
    assert page.value("cfmmr.speed()") < pace
    page.check_clean()


def drive_by_keys(page, ahead, back, left):
    for key, way in ((ahead, 1), (back, -1)):
        start = page.state("truth")
        page.browser.key_down(key)
        page.go_on(3.0)
        page.browser.key_up(key)
        page.during(20, "Math.abs(cfmmr.state('speed')[0]) < 0.005 && Math.abs(cfmmr.state('command')[0]) < 0.005", f"{key}: stops")
        truth = page.state("truth")
        along = (truth[0] - start[0]) * math.cos(start[2]) + (truth[1] - start[1]) * math.sin(start[2])
        assert way * along > 0.15, (key, start, truth)
    start = page.state("truth")
    page.browser.key_down(ahead)
    page.browser.key_down(left)
    page.go_on(3.0)
    page.browser.key_up(left)
    page.browser.key_up(ahead)
    turned = wrap(page.state("truth")[2] - start[2])
    assert turned > 0.1, (left, turned)
    page.during(20, "Math.abs(cfmmr.state('speed')[0]) < 0.005", "stops")


def check_touch(page):
    """Goal and pad by a finger."""
    page.open(size=TABLET)
    page.pace(50)
    page.reaches(page.value("cfmmr.goal()"), "first goal")
    page.still_view()
    page.middle("scene")
    goal = page.value("cfmmr.goal()")
    wanted = [goal[0] - 0.5, goal[1] - 0.6]
    scroll = page.value("window.scrollY")
    page.browser.touch("Start", page.pixel(goal))
    for share in (0.3, 0.6, 1.0):
        page.browser.touch("Move", page.pixel([a + share * (b - a) for a, b in zip(goal, wanted)]))
    page.browser.touch("End")
    page.departs()
    moved = page.value("cfmmr.goal()")
    assert math.dist(moved[:2], wanted) < 0.05, (moved, wanted)
    assert page.value("window.scrollY") == scroll, "the page scrolls under the finger"
    page.reaches(moved, "goal by a finger")
    page.pace(5)
    start, (x, y) = page.state("truth"), page.middle("pad")
    page.browser.touch("Start", (x, y))
    page.browser.touch("Move", (x, y - 30))
    page.go_on(3.0)
    page.browser.touch("End")
    page.during(20, "Math.abs(cfmmr.state('speed')[0]) < 0.005", "stops")
    assert math.dist(start[:2], page.state("truth")[:2]) > 0.15, "the pad does not drive"
    page.shot("touch")
    swipe(page)
    page.check_clean()


def swipe(page):
    """A finger swipes sideways beside the scene of a large touchscreen; the page stays."""
    page.open()
    page.browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    address, (_, y) = page.value("location.href"), page.middle("faults")
    for way in (1, -1):
        points = [(DESK[0] / 2 + way * x, y) for x in range(-600, 601, 60)]
        page.browser.touch("Start", points[0])
        for point in points[1:]:
            page.browser.touch("Move", point)
        page.browser.touch("End")
        # A navigation begins when the gesture of the browser is over.
        time.sleep(0.5)
        assert page.value("location.href") == address, "a swipe leaves the page"


def check_faults(page):
    """Several faults at once, then each by itself."""
    page.open()
    page.pace(5)
    page.go_on(1.0)
    for fault in ("gauge wire breaks", "encoder stuck", "bus loses frames"):
        page.inject(fault)
    page.during(20, "page.words.codesOf(page.history.latest).length > 1", "two codes")
    names = page.check_codes_named()
    assert len(names) > 1 and any("gauge" in name for name in names), names
    assert page.value("find('sentence').textContent.startsWith('Stopped') || page.words.codesOf(page.history.latest).every((c) => c.class === 'degraded' || c.class === 'info')"), page.text("sentence")
    page.shot("faults")
    page.value("find('repair').click()")
    page.start_time()
    page.pace(50)
    lines = []
    for fault in page.value("page.contract.faults.map((f) => f.name)"):
        page.click("defaults")
        page.until("cfmmr.time() < 5 && page.faults.size === 0", "begins again")
        page.start_time()
        page.inject(fault)
        page.go_on(12.0)
        names = page.check_codes_named()
        lines.append(f"{fault}: {', '.join(names) or '-'}")
    page.check_clean()
    return "; ".join(lines)


def check_at_once(page):
    """A fault or a path and a new robot in the same moment: the page shows what the robot has."""
    page.open()
    page.pace(5)
    page.go_on(1.0)
    for action in ("find('faults').children[0].click()", "followPath([[-1.3, -1.34], [-0.9, -1.34], [-0.3, -1.3]])"):
        generation = page.value("page.generation")
        page.value(f"{action}; find('again').click()")
        page.until(f"page.generation > {generation} && page.history.length > 0", "begins again")
        page.go_on(3.0)
        names = [code["name"] for code in page.codes()]
        pressed = page.value("find('faults').children[0].getAttribute('aria-pressed') === 'true'")
        assert pressed == ("gauge lost" in names), f"a gauge is broken on the page: {pressed}; codes of the robot: {names}"
        assert page.value("page.task") == "goal" and page.value("page.stage.planned.length") == 0, f"task of the robot: goal; on the page: {page.value('page.task')}"
    page.check_clean()


def check_invalid(page):
    """The rear board is off: there is no estimate, so there is none on the scene and none in the plots."""
    page.open()
    page.pace(5)
    page.go_on(2.0)
    page.choose("view", "robot")
    shown = page.pixels("--estimate")
    assert shown > 20, f"{shown} pixels of the estimate"
    assert page.value("watch.seen") > 0, "the watch sees nothing"
    page.inject("rear board off")
    page.during(10, "cfmmr.state('valid')[0] === 0", "the estimate is not valid")
    page.go_on(1.0)
    names = page.check_codes_named()
    assert names, "no code"
    # The line of earlier estimates stays; without it no pixel is left.
    page.value("page.stage.trails.estimate = []")
    left = page.pixels("--estimate")
    assert left == 0, f"{left} pixels of an estimate that is not valid"
    readings = page.value("page.plots.plots.slice(0, 2).flatMap((p) => p.shown.map((s) => s.textContent))")
    assert readings == ["–"] * 4, readings
    assert page.value("watch.invalid") > 0
    page.shot("invalid")
    page.check_clean()
    return f"{shown} pixels before, 0 after; {', '.join(names)}"


def check_no_gauges(page):
    """Without gauges there is no disagreement of beam and wheels: none in the plot."""
    page.open("#gauges=false")
    page.pace(20)
    page.go_on(3.0)
    readings = page.value("page.plots.plots.find((p) => p.title.startsWith('Disagreement')).shown.map((s) => s.textContent)")
    assert readings == ["–"] * 3, f"disagreement of a beam that is absent: {readings}"
    page.check_clean()


SETTINGS = {
    "gauges off": "find('gauges').click()", "gauges on": "find('gauges').click()",
    "imu": "find('imu').click()",
    "fusion odometry": ("fusion", "odometry"), "fusion intersection": ("fusion", "intersection-ipec"), "fusion joint": ("fusion", "joint"),
    "world ordinary": ("world", "ordinary"), "world ideal": ("world", "ideal"), "world careful": ("world", "careful"),
    "friction": "find('friction').value = '0.45'; find('friction').dispatchEvent(new Event('input'))",
    "drift": "find('drift').click()",
}


def check_settings(page):
    """Settings during a drive: time, robot and estimate go on."""
    page.open()
    page.pace(5)
    page.go_on(2.0)
    lines = []
    for name, action in SETTINGS.items():
        page.stop_time()
        before, truth, estimate = page.time(), page.state("truth"), page.state("estimate")
        if isinstance(action, tuple):
            page.choose(*action)
        else:
            page.value(action)
        page.value("page.robot.call('pace', { value: 5 }).then(() => new Promise((done) => setTimeout(done, 50)))")
        assert 0 <= page.time() - before < 0.05, f"{name}: time {before} s, then {page.time()} s"
        assert math.dist(truth[:2], page.state("truth")[:2]) < 0.005, f"{name}: the robot jumps"
        if page.one("valid"):
            assert math.dist(estimate[:2], page.state("estimate")[:2]) < 0.005, f"{name}: the estimate jumps"
        error = lambda: [a - b for a, b in zip(page.state("estimate")[:2], page.state("truth")[:2])]
        page.pace(1)
        page.start_time()
        page.go_on(0.1)
        jump = math.dist(error(), [a - b for a, b in zip(estimate[:2], truth[:2])])
        assert page.one("valid") and jump < 0.01, f"{name}: valid {page.one('valid')}, the error of the estimate changes by {jump} m"
        page.pace(5)
        page.go_on(1.5)
        off, before_off = math.dist(page.state("truth")[:2], page.state("estimate")[:2]), math.dist(truth[:2], estimate[:2])
        assert page.one("valid") and off < before_off + 0.08, f"{name}: valid {page.one('valid')}, estimate {off} m beside the robot, before {before_off} m"
        lines.append(f"{name} {1000 * off:.0f} mm")
    hash = page.value("location.hash")
    assert "friction=0.45" in hash and "imu=true" in hash and "world=careful" in hash, hash
    page.check_clean()
    return ", ".join(lines)


def check_axles(page):
    """Three to five axles: drawn, driven to a goal and along a drawn path, with faults of inner boards."""
    lines = []
    for count in (3, 5):
        page.open()
        page.pace(20)
        page.go_on(1.0)
        page.choose("axles", count)
        page.until(f"page.contract.axles.length === {count} && cfmmr.time() < 20", f"{count} axles")
        assert f"axles={count}" in page.value("location.hash"), page.value("location.hash")
        names = page.value("page.contract.axles.concat(page.contract.beams)")
        assert names[1] == "axle-2" and names[-1] == f"beam-{count - 1}", names
        for name in ("axles", "estimated_axles"):
            assert len(page.state(name)) == 3 * count, (name, page.state(name))
        page.shot(f"axles-{count}-start")
        goal = page.value("page.contract.mission.goal")
        page.departs()
        truth = page.reaches(goal, f"{count} axles")
        trails = page.value("page.stage.trails.axles.map((trail) => trail.flat().length)")
        assert len(trails) == count and min(trails) > 100, trails
        off = max(math.dist(a, b) for a, b in zip(triples(page.state("axles")), triples(page.state("estimated_axles"))))
        assert off < TOLERANCE_M, f"an axle is estimated {off} m beside the axle"
        page.shot(f"axles-{count}-goal", whole=True)
        # A grip of the last axle moves the whole robot.
        page.still_view()
        rear = page.state("axles")[-3:]
        page.drag(rear[:2], [rear[0] + 0.1, rear[1] - 0.1])
        page.until("find('note').textContent.startsWith('Robot placed')", "the robot is placed")
        page.start_time()
        page.go_on(1.0)
        x, y, heading = page.state("truth")
        ahead = lambda by: [x + by * math.cos(heading), y + by * math.sin(heading)]
        stroke = [ahead(0.1 * k) for k in range(int(10 * (0.185 * (count - 1) + 1.5)))]
        page.value(f"followPath({json.dumps(stroke)})")
        page.until("page.task === 'path'", "the path is accepted")
        page.start_time()
        page.departs()
        page.reaches(stroke[-1], f"path of {count} axles")
        page.click("again")
        page.go_on(3.0)
        page.inject("axle-2 board off")
        page.during(20, "find('sentence').textContent.startsWith('Stopped')", "stops")
        page.inject("beam-2 gauge wire breaks")
        names = page.check_codes_named()
        page.shot(f"axles-{count}-fault")
        # Without gauges a robot of more than two axles is refused, and the robot stays.
        page.click("gauges")
        page.until("find('note').classList.contains('bad')", "refused")
        assert page.value("find('gauges').checked") and page.value("page.contract.axles.length") == count
        lines.append(f"{count}: goal {100 * math.dist(truth[:2], goal[:2]):.1f} cm, {', '.join(names)}")
    page.choose("axles", 2)
    page.until("page.contract.axles.length === 2 && !location.hash.includes('axles')", "two axles again")
    page.open("#gauges=false")
    page.choose("axles", 3)
    page.until("find('note').classList.contains('bad')", "refused")
    assert page.value("find('axles').value") == "2" and "axles" not in page.value("location.hash")
    for size in (DESK, TABLET):
        for scheme in ("light", "dark"):
            page.open("#axles=4", size=size, scheme=scheme)
            page.pace(5)
            page.go_on(6.0)
            check_overflow(page, f"axles-{size[0]}-{scheme}", size[0])
            page.shot(f"axles-{size[0]}-{scheme}", whole=True)
    page.check_clean()
    return "; ".join(lines)


def triples(values):
    """Positions of postures that follow each other."""
    return [values[k : k + 2] for k in range(0, len(values), 3)]


def check_trials(page):
    page.open()
    page.click("trials-run")
    count = page.options.trials
    done = lambda n: page.until(f"find('trials').rows.length === {n} && find('trials').rows[{n - 1}].cells[1].textContent === '{count}'", f"row {n}")
    done(1)
    page.click("gauges")
    page.until("settings.gauges === false", "no gauges")
    page.click("trials-run")
    done(2)
    assert page.value("watch.asked") == [100, 100]
    rows = page.value("[...find('trials').rows].map((row) => [...row.cells].map((cell) => cell.textContent))")
    for row, points in zip(rows, page.value("page.stage.clouds.map((cloud) => cloud.points)")):
        assert len(points) == count, (row, points)
        mean = sum(math.dist(point, page.value("cfmmr.goal()")[:2]) for point in points) / count
        assert abs(float(row[2].split()[0]) - 100 * mean) < 0.06, (row, mean)
        assert row[3].endswith("°") and row[4].endswith(" %"), row
    assert "with gauges" in rows[0][0] and "without gauges" in rows[1][0], rows
    page.until("find('note').textContent.includes('trials')", "the result is announced")
    page.value("window.scrollTo(0, 0)")
    page.shot("trials", whole=True)
    page.click("trials-clear")
    assert page.value("find('trials').rows.length === 0 && page.stage.clouds.length === 0")
    page.check_clean()
    return "; ".join(f"{row[0][2:]} {row[2]}" for row in rows)


def row_at(page, seconds):
    """State at a time, with the target."""
    page.during(seconds + 20, f"cfmmr.time() > {seconds}", "time goes on")
    return page.value(f"Array.from(page.history.row(page.history.index({seconds - 0.001})), String)")


def check_panic(page):
    """The program ends with an error: the page reports it, and a new robot drives."""
    page.open("#seed=3&imu=true")
    page.pace(20)
    page.go_on(4.0)
    page.inject("gauge wire breaks")
    page.browser.in_worker("web = { ...web, advance() { throw new WebAssembly.RuntimeError('unreachable'); } }; 0")
    page.until("find('note').textContent.includes('ended with an error')", "the error on the page")
    errors = page.value("cfmmr.errors()")
    assert len(errors) == 1 and "unreachable" in errors[0], errors
    page.until("cfmmr.time() < 4 || page.history.length > 0", "a new robot")
    assert page.value("page.faults.size") == 0, "the new robot has no fault"
    assert page.value("location.hash") == "#seed=3&imu=true" and page.value("find('imu').checked"), page.value("location.hash")
    page.value("run(true)")
    page.click("again")
    page.go_on(2.0)
    page.reaches(page.value("cfmmr.goal()"), "after an error")
    page.value("cfmmr.errors().length = 0")
    page.check_clean()


def check_address(page):
    """Seed and scenario in the address give the same robot again."""
    def robot(fragment):
        page.open(fragment)
        page.pace(20)
        return row_at(page, 5.0)

    rows = {}
    for fragment in ("#seed=7&world=ordinary&gauges=false&goal=0.3,-0.2,0.5", "#seed=8&world=ordinary&gauges=false&goal=0.3,-0.2,0.5", "#seed=7&imu=true&friction=0.4"):
        rows[fragment] = robot(fragment)
        page.stop_time()
        assert page.value("location.hash") == fragment or set(page.value("location.hash")[1:].split("&")) == set(fragment[1:].split("&")), page.value("location.hash")
        assert robot(fragment) == rows[fragment], f"{fragment}: another robot after loading again"
        # Each call to the Worker comes late: nothing may depend on when it comes.
        page.value("(() => { const call = page.robot.call.bind(page.robot), late = () => new Promise((done) => setTimeout(done, 50));"
                   " page.robot.call = (...given) => late().then(() => call(...given)); })()")
        generation = page.value("page.generation")
        page.click("again")
        page.until(f"page.generation > {generation} && page.history.length > 0", "begins again")
        different = sum(a != b for a, b in zip(row_at(page, 5.0), rows[fragment]))
        assert different == 0, f"{fragment}: Begin again: {different} of {len(rows[fragment])} values differ after 5 s from those of the page loaded again"
    assert len(set(map(tuple, rows.values()))) == 3, "different addresses, the same robot"
    # An address with nonsense gives the robot of no settings, and each entry is named.
    nonsense = "seed=x&world=moon&friction=99&goal=a,b&start=1"
    page.open("#" + nonsense)
    named = page.text("note")
    assert all(entry in named for entry in nonsense.split("&")), named
    assert robot("#" + nonsense) == robot(""), "nonsense in the address"
    page.choose("seed", "seven")
    assert "seed" in page.text("note").lower() and page.value("find('seed').value") == "1"
    page.check_clean()


def png_pixels(data):
    """Width, height and number of different bytes of a picture."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        if kind == b"IHDR":
            width, height = struct.unpack(">II", data[at + 8 : at + 16])
        if kind == b"IDAT":
            packed += data[at + 8 : at + 8 + length]
        at += 12 + length
    return width, height, len(set(zlib.decompress(packed)))


def check_files(page):
    """The log as CSV and the scene as PNG."""
    with tempfile.TemporaryDirectory() as name:
        page.open()
        page.browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=name)
        page.pace(20)
        page.go_on(5.0)
        page.stop_time()
        files = {}
        for button, file in (("save-log", "cfmmr.csv"), ("save-picture", "cfmmr.png")):
            page.click(button)
            path = Path(name) / file
            page.browser.until(lambda: path.exists() and path.stat().st_size > 0 and not list(Path(name).glob("*.crdownload")), file)
            files[file] = path.read_bytes()
    head, *rows = csv.reader(files["cfmmr.csv"].decode().splitlines())
    counts = page.value("page.contract.state")
    assert head == [n if c == 1 else f"{n}_{i}" for n, c in counts for i in range(c)], head
    assert len(rows) == page.value("page.history.length") and {len(row) for row in rows} == {len(head)}
    latest = dict(zip(head, map(float, rows[-1])))
    assert abs(latest["time_s"] - page.time()) < 0.02 and [latest[f"truth_{i}"] for i in range(3)] == page.state("truth")
    times = [float(row[0]) for row in rows]
    assert all(0.009 < b - a < 0.011 for a, b in zip(times, times[1:])), "an epoch is missing"
    width, height, levels = png_pixels(files["cfmmr.png"])
    assert [width, height] == page.value("[find('scene').width, find('scene').height]") and levels > 16
    page.browser.call("Browser.setDownloadBehavior", behavior="deny")
    page.check_clean()
    return f"log {len(rows)} × {len(head)}, picture {width} × {height}"


def check_overflow(page, case, width):
    # A phone enlarges its window to what the page needs, so the width of the screen counts.
    wide = page.value("document.documentElement.scrollWidth")
    assert wide <= width, f"{case}: {wide} px wide"
    outside = page.value(
        "[...document.querySelectorAll('main *')].filter((e) => e.checkVisibility() && !e.closest('#faults, .handle')"
        f" && (e.getBoundingClientRect().right > {width} + 0.5 || e.getBoundingClientRect().left < -0.5)).map((e) => e.tagName + ' ' + e.id + ' ' + e.className)"
    )
    assert not outside, (case, outside)
    # Text that is cut off.
    cut = page.value("[...document.querySelectorAll('button, select, output, td, th, li, p, h2')].filter((e) => e.checkVisibility() && e.tagName !== 'SELECT' && !e.closest('.handle') && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline').map((e) => e.tagName + ' ' + e.id + ' ' + e.textContent.slice(0, 30))")
    assert not cut, (case, cut)


def brightness(page, what):
    return page.value(f"getComputedStyle(document.body).{what}.match(/[0-9.]+/g).slice(0, 3).reduce((a, b) => a + Number(b), 0) / 765")


def check_looks(page):
    """Narrow windows and both colour schemes, with much on the page."""
    for size in (DESK, TABLET, PHONE):
        for scheme in ("light", "dark"):
            case = f"{size[0]}-{scheme}"
            page.open("#world=ordinary&imu=true&friction=0.45", size=size, scheme=scheme)
            page.pace(20)
            page.go_on(8.0)
            check_overflow(page, case, size[0])
            page.value("[...document.querySelectorAll('details')].forEach((d) => { d.open = true; }); find('tour-open').click(); find('drift').click()")
            for fault in ("gauge wire breaks", "encoder stuck", "rear board off"):
                page.inject(fault)
            page.go_on(2.0)
            if size != DESK and scheme == "light":
                page.value("page.trials.run(2, settingsName(), { ...settings })")
            page.value("followPath([[0, 0], [9, 0], [0, 0.1], [9, 0.2]])")
            check_overflow(page, case, size[0])
            ground, ink = brightness(page, "backgroundColor"), brightness(page, "color")
            assert (ground > 0.85 and ink < 0.35) if scheme == "light" else (ground < 0.25 and ink > 0.7), (case, ground, ink)
            page.value("document.activeElement.blur(); find('tour-close').click(); window.scrollTo(0, 0)")
            page.shot(case, whole=True)
            page.check_clean()
    # The scheme changes while the page is open.
    page.open(size=PHONE, scheme="dark")
    page.go_on(1.0)
    page.stop_time()
    page.choose("view", "robot")
    page.camera_rests()
    before = page.pixels("--body")
    page.browser.emulate(*PHONE, True, "light")
    after = page.pixels("--body")
    assert before > 1000 and after > 0.8 * before, f"pixels in the colour of the robot: {before}, in the other scheme {after}"


def check_motion(page):
    """Reduced motion: nothing moves by itself."""
    page.open(motion="reduce")
    assert not page.value("page.running") and page.text("play") == "Play"
    clock = page.time()
    page.value("new Promise((done) => setTimeout(done, 200))")
    assert page.time() == clock, "the robot moves by itself"
    moving = page.value("document.getAnimations().length")
    assert moving == 0, moving
    page.click("play")
    page.pace(50)
    page.reaches(page.value("cfmmr.goal()"), "reduced motion")
    page.check_clean()


# Random action on a control of the page; `pick` chooses the control, `share` its value.
OPERATE = """((pick, share) => {
  const all = [...document.querySelectorAll("main button, main select, main input, main summary")].filter((e) => !e.disabled && e.checkVisibility());
  const e = all[Math.floor(pick * all.length)];
  if (e.tagName === "SELECT") { e.selectedIndex = Math.floor(share * e.options.length); e.dispatchEvent(new Event("change", { bubbles: true })); }
  else if (e.type === "range") { e.value = String(Number(e.min) + share * (e.max - e.min)); e.dispatchEvent(new Event("input", { bubbles: true })); }
  else if (e.type === "text") { e.value = share < 0.2 ? "x" : String(Math.floor(1e6 * share)); e.dispatchEvent(new Event("change", { bubbles: true })); }
  else { e.focus({ preventScroll: true }); e.click(); }
})(%r, %r)"""
FAULT = "(() => { const all = find('faults').children; all[Math.floor(%r * all.length)].click(); })()"
SETTING_IDS = ("gauges", "imu", "world", "fusion", "friction", "drift")
SETTING = """((name, share) => { const e = find(name);
  if (e.tagName === "SELECT") { e.selectedIndex = Math.floor(share * e.options.length); e.dispatchEvent(new Event("change")); }
  else if (e.type === "range") { e.value = String(Number(e.min) + share * (e.max - e.min)); e.dispatchEvent(new Event("input")); }
  else e.click(); })(%r, %r)"""
NAMES = ["Tab", "Enter", "Escape", " ", ".", "+", "-", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "w", "a", "s", "d", "q", "e", "PageDown", "Home"]
PLACES = """(() => { window.scrollTo(0, 0); const b = find("scene").getBoundingClientRect(), v = page.stage.view, goal = page.stage.goal, truth = state("truth");
  const at = (p) => [b.left + v.X(p[0]), b.top + v.Y(p[1])];
  const g = at(goal), r = at(truth);
  return { box: [b.left, b.top, b.width, b.height], goal: g, robot: r, goalTip: at(page.stage.tip(v, goal)), robotTip: at(page.stage.tip(v, truth)) }; })()"""
# Random actions between two checks.
CHUNK = 20


def random_drag(browser, luck, places):
    x, y, width, height = places["box"]
    anywhere = lambda: (x + luck.random() * width, y + luck.random() * height)
    start = luck.choice([places["goal"], places["robot"], places["goalTip"], places["robotTip"], anywhere()])
    points = [start] + [anywhere() for _ in range(luck.randint(1, 6))]
    if not all(math.isfinite(value) for point in points for value in point):
        return
    event = lambda kind, at, buttons: browser.post("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], button="left", buttons=buttons, clickCount=luck.choice((1, 1, 2)))
    event("mousePressed", points[0], 1)
    for point in points[1:]:
        event("mouseMoved", point, 1)
    if luck.random() < 0.1:
        browser.post("Input.dispatchKeyEvent", type="rawKeyDown", **browser.key_event("Escape")[0])
    event("mouseReleased", points[-1], 0)


def random_action(page, luck, places):
    browser = page.browser
    run = lambda text: browser.post("Runtime.evaluate", expression=text)
    kind = luck.choices(["control", "drag", "draw", "touch", "key", "wheel", "resize", "fault", "setting", "scheme"], [28, 18, 5, 5, 20, 4, 2, 8, 9, 1])[0]
    fingers = luck.choice((1, 1, 2))
    if kind == "control":
        run(OPERATE % (luck.random(), luck.random()))
    elif kind == "drag":
        random_drag(browser, luck, places)
    elif kind == "draw":
        run("setDrawing(true)")
        random_drag(browser, luck, places)
    elif kind == "touch":
        x, y, width, height = places["box"]
        finger = lambda n: {"x": x + luck.random() * width, "y": y + luck.random() * height, "id": n}
        for step in ["touchStart", "touchMove", "touchMove", luck.choice(["touchEnd", "touchCancel"])]:
            ends = step in ("touchEnd", "touchCancel")
            browser.post("Input.dispatchTouchEvent", type=step, touchPoints=[] if ends else [finger(n) for n in range(fingers)])
    elif kind == "key":
        name = luck.choice(NAMES)
        up, down = browser.key_event(name, luck.choice((0, 0, 0, SHIFT)))
        for _ in range(luck.randint(1, 4)):
            browser.post("Input.dispatchKeyEvent", type="keyDown" if "text" in down else "rawKeyDown", **down)
        if luck.random() < 0.9:
            browser.post("Input.dispatchKeyEvent", type="keyUp", **up)
    elif kind == "wheel":
        x, y, width, height = places["box"]
        browser.post("Input.dispatchMouseEvent", type="mouseWheel", x=x + luck.random() * width, y=y + luck.random() * height,
                     deltaX=0, deltaY=luck.uniform(-300, 300), modifiers=CONTROL)
    elif kind == "resize":
        size = luck.choice([DESK, TABLET, PHONE, (800, 600), (1600, 1000)])
        browser.post("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=luck.choice((1, 2)), mobile=False)
    elif kind == "fault":
        run(FAULT % luck.random())
    elif kind == "setting":
        run(SETTING % (luck.choice(SETTING_IDS), luck.random()))
    else:
        browser.post("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": luck.choice(("light", "dark"))}])


def random_run(page, seed):
    luck = random.Random(seed)
    page.open(f"#seed={seed}")
    page.browser.call("Browser.setDownloadBehavior", behavior="deny")
    page.browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    page.until("page.stage.view", "the first frame")
    # The page can change its pace; the fastest one comes back.
    for done in range(0, page.options.actions, CHUNK):
        page.value("setPace(50)")
        places = page.value(PLACES)
        for _ in range(min(CHUNK, page.options.actions - done)):
            random_action(page, luck, places)
        page.browser.settle()
        refused = [event["result"]["exceptionDetails"] for event in page.browser.events if "exceptionDetails" in event.get("result", {})]
        assert not refused, refused
        try:
            page.check_clean()
        except AssertionError as error:
            raise AssertionError(f"seed {seed}, actions {done} to {done + CHUNK}: {error}") from None
        page.browser.events = [event for event in page.browser.events if event.get("method") == "Network.requestWillBeSent"]
    # The page lives: the robot of no settings reaches its goal.
    page.browser.key_up("w")
    page.value("Promise.all([1, 2, 3, 4].map(() => page.robot.call('pace', { value: 50 })))")
    page.value("find('trials-clear').click(); find('defaults').click()")
    page.until("page.history.length > 0 && page.faults.size === 0 && settings.world === undefined && cfmmr.time() < 100", f"seed {seed}: begins again")
    page.value("setPace(50); run(true)")
    page.reaches(page.value("page.contract.mission.goal"), f"seed {seed}: after random actions")
    page.check_clean()
    return page.value("watch")


def check_random(page):
    lines = []
    for seed in page.options.seeds:
        begin = time.monotonic()
        watch = random_run(page, seed)
        lines.append(f"seed {seed}: {page.options.actions} actions in {time.monotonic() - begin:.0f} s, {watch['invalid']} frames without a valid estimate")
    return "; ".join(lines)


CHECKS = [
    check_file, check_goal, check_robot, check_path, check_zigzag, check_tour, check_focus, check_keys, check_touch, check_faults,
    check_at_once, check_invalid, check_no_gauges, check_settings, check_axles, check_trials, check_panic, check_address, check_files, check_looks, check_motion, check_random,
]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page")
    parser.add_argument("folder", nargs="?")
    parser.add_argument("--only", default="")
    parser.add_argument("--actions", type=int, default=200)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2, 3, 4, 5])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--keep-going", action="store_true", help="report all checks that fail")
    options = parser.parse_args()
    checks = [check for check in CHECKS if options.only in check.__name__]
    if not checks:
        parser.error(f"--only {options.only}: must be part of a name: {' '.join(check.__name__[6:] for check in CHECKS)}")
    failed = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        shots = Path(options.folder) if options.folder else None
        if shots:
            shots.mkdir(parents=True, exist_ok=True)
        browser = Browser(Path(name) / "profile")
        try:
            page = Page(browser, options.page, shots, options)
            for check in checks:
                begin = time.monotonic()
                try:
                    result = check(page)
                except AssertionError as error:
                    if not options.keep_going:
                        raise
                    failed.append(check.__name__)
                    result = f"FAILED: {error or traceback.format_exc().splitlines()[-2].strip()}"
                print(f"{check.__name__[6:]:9} {time.monotonic() - begin:5.1f} s  {result or ''}", flush=True)
        finally:
            browser.close()
    if failed:
        raise SystemExit(f"check_page.py: failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
