// The scene: shown part of the floor, and drawing.

// Half axes of the 95 % ellipse of two normal variables, in standard deviations.
const SIGMAS_95 = 2.448;
// Distance between points of the driven path, m, and most points of it.
const TRAIL_M = 0.004, TRAIL_POINTS = 3000;
// Distance between two epochs that means a placement, m, and most lines of the driven path.
const JUMP_M = 0.03, MOST_LINES = 20;
// Length of a full bar of strain, m.
const BAR_M = 0.1;
// Strains of a full bar.
const STRAIN_SCALES = [1e-4, 2e-4, 5e-4, 1e-3, 1.5e-3];

// Strain of a full bar. It changes with hysteresis, so that the bars do not flicker.
function strainScale(strains, before = STRAIN_SCALES[0]) {
  const most = strains.reduce((a, b) => Math.max(a, Math.abs(b) || 0), 0);
  if (most <= before && (most > 0.3 * before || before === STRAIN_SCALES[0])) return before;
  return STRAIN_SCALES.find((scale) => most <= scale) || STRAIN_SCALES[STRAIN_SCALES.length - 1];
}

// Strains of a frame, 0 at the front, out of those of all frames.
const strainsOf = (strains, frames, n) => strains.subarray(n * strains.length / frames, (n + 1) * strains.length / frames);

class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    this.follow = "all";
    this.bounds = null;
    this.view = null;
    this.goal = null;
    this.planned = [];
    this.stroke = [];
    this.refusal = null;
    this.ghost = null;
    this.clouds = [];
  }

  // Another robot, with other axles and frames.
  describe(contract, layout) {
    this.contract = contract;
    this.layout = layout;
    this.scale = undefined;
    this.clear();
  }

  clear() {
    this.trails = { truth: [[]], estimate: [[]], axles: this.further ? this.contract.axles.map(() => [[]]) : [] };
  }

  // Number of axles beyond two.
  get further() {
    return this.contract.axles.length - 2;
  }

  // Distance between neighbouring axles of a straight robot, m.
  get spacing() {
    return this.contract.strip_m + 2 * this.contract.rigid_m;
  }

  // Posture of an axle in a state.
  axle(row, n) {
    return this.layout.of(row, "axles").subarray(3 * n, 3 * n + 3);
  }

  add(row) {
    this.extend(this.trails.truth, this.layout.of(row, "truth"));
    this.trails.axles.forEach((trail, n) => this.extend(trail, this.axle(row, n)));
    const estimate = this.layout.of(row, "estimate");
    if (this.valid(row)) this.extend(this.trails.estimate, estimate);
    else if (this.trails.estimate[this.trails.estimate.length - 1].length) this.lift(this.trails.estimate);
  }

  valid(row) {
    return this.layout.of(row, "valid")[0] === 1;
  }

  extend(trail, at) {
    const line = trail[trail.length - 1], end = line[line.length - 1];
    if (end && apart(end, at) < TRAIL_M) return;
    // The robot was placed, or the estimate was set: another line begins.
    if (end && apart(end, at) > JUMP_M) return this.lift(trail, at);
    line.push([at[0], at[1]]);
    if (line.length > TRAIL_POINTS) trail[trail.length - 1] = line.filter((_, i) => i % 2 === 0);
  }

  lift(trail, at) {
    trail.push(at ? [[at[0], at[1]]] : []);
    if (trail.length > MOST_LINES) trail.shift();
  }

  // Part of the floor that the view asks for.
  wanted(row) {
    const truth = this.layout.of(row, "truth");
    const longer = this.further * this.spacing / 2, half = 0.5 + longer;
    if (this.follow === "robot") return [truth[0] - half, truth[1] - half, truth[0] + half, truth[1] + half];
    const points = [truth, ...this.trails.truth.flat(), ...this.planned, ...this.clouds.flatMap((cloud) => cloud.points)];
    if (this.goal) points.push(this.goal);
    if (this.refusal) points.push(this.refusal.at);
    const margin = 0.4 + longer;
    let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of points) {
      x0 = Math.min(x0, x); y0 = Math.min(y0, y); x1 = Math.max(x1, x); y1 = Math.max(y1, y);
    }
    return [x0 - margin, y0 - margin, x1 + margin, y1 + margin];
  }

  aim(row) {
    if (this.follow === "free" && this.bounds) return;
    const wanted = this.wanted(row);
    if (!wanted.every(Number.isFinite)) return;
    if (!this.bounds || reducedMotion.matches) this.bounds = wanted;
    this.bounds = this.bounds.map((value, k) => value + 0.12 * (wanted[k] - value));
  }

  // Magnifies the floor around a point, m.
  zoom(by, around) {
    this.bounds = this.bounds.map((value, k) => around[k % 2] + (value - around[k % 2]) / by);
    this.follow = "free";
  }

  pan(dx, dy) {
    this.bounds = this.bounds.map((value, k) => value - (k % 2 ? dy : dx));
    this.follow = "free";
  }

  draw(row, held) {
    if (!held) this.aim(row);
    if (!this.bounds) return;
    const view = this.view = sceneView(this.canvas, this.bounds), { layout } = this;
    const truth = layout.of(row, "truth"), target = layout.of(row, "target");
    drawGrid(view);
    if (this.planned.length) drawLine(view, this.planned, color("--reference"), 1.5, dash("--reference"));
    this.trails.axles.forEach((trail) => trail.forEach((line) => drawLine(view, line, color("--others"), 1.2)));
    this.trails.truth.forEach((line) => drawLine(view, line, color("--truth"), 2));
    this.trails.estimate.forEach((line) => drawLine(view, line, color("--estimate"), 1, dash("--estimate")));
    if (this.goal) {
      // Faint unless the robot drives to the goal.
      view.g.globalAlpha = page.task === "goal" ? 1 : 0.4;
      drawGoal(view, this.goal, this.contract.mission.tolerance);
      this.drawTip(view, this.goal, color("--goal"));
      view.g.globalAlpha = 1;
    }
    if (Number.isFinite(target[0])) drawCircle(view, target, 5, color("--goal"), 2);
    this.drawBody(view, row);
    if (Number.isFinite(truth[0])) this.drawTip(view, truth, color("--body"));
    this.clouds.forEach((cloud) => this.drawCloud(view, cloud));
    if (this.valid(row)) {
      if (this.further) this.drawEstimatedAxles(view, layout.of(row, "estimated_axles"));
      drawEstimate(view, layout.of(row, "estimate"), layout.of(row, "covariance"), SIGMAS_95);
    }
    this.drawInset(view, row);
    if (this.stroke.length) drawLine(view, this.stroke, color("--accent"), 2.5);
    if (this.ghost) this.drawGhost(view);
    if (this.refusal) this.drawRefusal(view);
  }

  drawBody(view, row) {
    const { layout } = this, flat = layout.of(row, "frame"), points = [];
    for (let k = 0; k < flat.length; k += 2) points.push([flat[k], flat[k + 1]]);
    drawRobot(view, this.contract.body, this.contract.axles.map((_, n) => this.axle(row, n)), points);
    if (settings.gauges === false) return;
    const strains = layout.of(row, "strain"), count = this.contract.beams.length, length = points.length / count;
    this.scale = strainScale(strains, this.scale);
    // Points begin at the rear frame, strains at the front one.
    this.contract.beams.forEach((_, n) => this.drawStrains(view, points.slice((count - 1 - n) * length, (count - n) * length), strainsOf(strains, count, n)));
  }

  drawEstimatedAxles(view, axles) {
    for (let k = 0; k < axles.length; k += 3) if (Number.isFinite(axles[k])) drawCross(view, axles.subarray(k, k + 3), color("--estimate"), 0.03);
  }

  // Strains as bars across the frame, at the places of the gauges.
  drawStrains(view, frame, strains) {
    const { gauges_m: places, strip_m: strip, rigid_m: rigid } = this.contract;
    places.forEach((place, n) => {
      const at = Math.min(frame.length - 1.001, (rigid + place) / (strip + 2 * rigid) * (frame.length - 1));
      const i = Math.floor(at), [a, b] = [frame[i], frame[i + 1]], share = at - i, length = apart(a, b) || 1;
      const foot = [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
      const by = Math.max(-2, Math.min(2, strains[n] / this.scale)) * BAR_M / length;
      if (!Number.isFinite(by)) return;
      drawLine(view, [foot, [foot[0] - by * (b[1] - a[1]), foot[1] + by * (b[0] - a[0])]], color("--outside"), Math.max(2, 0.008 * view.scale));
    });
  }

  // The estimate, magnified. Its corner stays until the robot or the goal comes below it.
  drawInset(view, row) {
    const { layout } = this, truth = layout.of(row, "truth"), estimate = layout.of(row, "estimate"), covariance = layout.of(row, "covariance");
    if (!this.valid(row) || !Number.isFinite(truth[0])) return;
    const corners = insetCorners(view), axles = this.further ? this.contract.axles.map((_, n) => this.axle(row, n)) : [];
    const robot = [truth].concat(axles), points = robot.concat(this.goal ? [this.goal] : []);
    const covered = this.corner === undefined || points.some((point) => underInset(view, corners[this.corner], point, 30));
    // The bottom right corner has the pad.
    if (covered) this.corner = corners.indexOf(bestCorner(view, [corners[0], corners[1], corners[3]], points.concat(this.trails.truth.flat()), robot));
    const reach = apart(truth, estimate) + SIGMAS_95 * Math.sqrt(Math.max(covariance[0], covariance[2]));
    // Scales of 1, 2 and 5 with hysteresis, so that the inset does not flicker.
    if (!(reach < this.spread && reach > 0.3 * this.spread)) this.spread = step(Math.max(1e-3, 1.3 * reach), 1);
    drawInset(view, corners[this.corner], { truth, estimate, covariance, spread: this.spread, sigmas: SIGMAS_95, name: "95 %" });
  }

  // Handle that turns a posture: a ring ahead of it.
  drawTip(view, at, style) {
    const tip = this.tip(view, at);
    drawLine(view, [at, tip], style, 1);
    drawCircle(view, tip, 6, style, 2);
  }

  tip(view, [x, y, phi]) {
    const length = Math.max(0.34 + this.further * this.spacing / 2, 40 / view.scale);
    return [x + length * Math.cos(phi), y + length * Math.sin(phi)];
  }

  drawGhost(view) {
    const { at, kind } = this.ghost, [x, y, phi] = at;
    view.g.globalAlpha = 0.55;
    if (kind === "goal") {
      drawGoal(view, at, this.contract.mission.tolerance);
    } else {
      const last = this.contract.axles.length - 1, by = this.further ? this.spacing : this.contract.strip_m;
      const axles = this.contract.axles.map((_, n) => (last / 2 - n) * by).map((ahead) => [x + ahead * Math.cos(phi), y + ahead * Math.sin(phi), phi]);
      drawRobot(view, this.contract.body, axles, [axles[last], axles[0]]);
    }
    this.drawTip(view, at, color(kind === "goal" ? "--goal" : "--body"));
    view.g.globalAlpha = 1;
  }

  drawRefusal(view) {
    const { at, text } = this.refusal, { g, width, height } = view;
    const x = view.X(at[0]), y = view.Y(at[1]), style = color("--failure");
    g.font = "600 12px system-ui, sans-serif"; g.textAlign = "left";
    const lines = broken(g, text, Math.min(260, width - 24)), wide = Math.max(...lines.map((line) => g.measureText(line).width)) + 12;
    const left = Math.min(Math.max(4, x - wide / 2), width - wide - 4), tall = 16 * lines.length + 8, above = y > tall + 20 ? y - tall - 14 : y + 14;
    const top = Math.min(Math.max(4, above), height - tall - 4);
    // The line leads to the place, also if the place is outside the scene.
    g.strokeStyle = style; g.lineWidth = 2;
    g.beginPath(); g.moveTo(left + wide / 2, top + tall / 2); g.lineTo(x, y); g.stroke();
    drawCircle(view, at, 9, style, 3);
    g.fillStyle = color("--card"); g.lineWidth = 1;
    g.beginPath(); g.rect(left, top, wide, tall); g.fill(); g.stroke();
    g.fillStyle = color("--ink");
    lines.forEach((line, n) => g.fillText(line, left + 6, top + 16 * (n + 1)));
  }

  drawCloud({ g, X, Y }, { points, look }) {
    g.fillStyle = color(look); g.globalAlpha = 0.75;
    for (const [x, y] of points) { g.beginPath(); g.arc(X(x), Y(y), 2.5, 0, 7); g.fill(); }
    g.globalAlpha = 1;
  }
}

// Text in lines of at most `width` pixels.
function broken(g, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = (lines[lines.length - 1] + " " + word).trim();
    if (g.measureText(longer).width <= width || !lines[lines.length - 1]) lines[lines.length - 1] = longer; else lines.push(word);
  }
  return lines;
}
