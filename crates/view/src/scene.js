// Drawing of the robot from above, of the report page and of the browser page. Colours and dashes are CSS variables.

const palette = new Map();

function variable(name) {
  if (!palette.has(name)) palette.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return palette.get(name);
}

const color = variable;

// Alternating lengths of dash and gap.
const dash = (name) => variable(name + "-dash").split(" ").filter(Boolean).map(Number);

window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => palette.clear());

// The whole of the canvas in CSS pixels, cleared.
function surface(canvas) {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const g = canvas.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  g.font = "11px system-ui, sans-serif";
  return { g, width, height };
}

// A step of 1, 2 or 5 times a power of ten.
function step(span, count) {
  const raw = span / count, power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= raw);
}

// Number with the decimal places that a step of `by` needs.
function label(value, by) {
  const text = value.toFixed(Math.max(0, -Math.floor(Math.log10(by) + 1e-9)));
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

// Canvas that shows at least `bounds` (x0, y0, x1, y1; m), with y up. X and Y give pixels.
function sceneView(canvas, [x0, y0, x1, y1]) {
  const { g, width, height } = surface(canvas);
  const scale = Math.min(width / (x1 - x0), height / (y1 - y0)), cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
  const X = (x) => width / 2 + (x - cx) * scale, Y = (y) => height / 2 - (y - cy) * scale;
  const ground = (px, py) => [cx + (px - width / 2) / scale, cy - (py - height / 2) / scale];
  return { g, width, height, scale, X, Y, ground, left: cx - width / 2 / scale, bottom: cy - height / 2 / scale };
}

function trace({ g, X, Y }, points) {
  g.beginPath();
  points.forEach((p, i) => (i ? g.lineTo(X(p[0]), Y(p[1])) : g.moveTo(X(p[0]), Y(p[1]))));
}

function drawLine(view, points, style, thick, pattern = []) {
  const { g } = view;
  trace(view, points);
  g.strokeStyle = style; g.lineWidth = thick; g.setLineDash(pattern); g.lineJoin = "round"; g.stroke(); g.setLineDash([]);
}

function drawCircle({ g, X, Y }, at, radius, style, thick, pattern = []) {
  g.beginPath(); g.arc(X(at[0]), Y(at[1]), radius, 0, 7);
  g.strokeStyle = style; g.lineWidth = thick; g.setLineDash(pattern); g.stroke(); g.setLineDash([]);
}

// Grid with metres.
function drawGrid({ g, width, height, scale, X, Y, left, bottom }) {
  const by = step(Math.min(width, height) / scale, 5);
  g.fillStyle = color("--soft"); g.strokeStyle = color("--grid"); g.lineWidth = 1;
  g.textAlign = "center";
  for (let x = Math.ceil(left / by) * by; X(x) < width; x += by) {
    g.beginPath(); g.moveTo(X(x), 0); g.lineTo(X(x), height); g.stroke();
    if (X(x) > 44 && X(x) < width - 24) g.fillText(label(x, by), X(x), height - 4);
  }
  g.textAlign = "left";
  for (let y = Math.ceil(bottom / by) * by; Y(y) > 0; y += by) {
    g.beginPath(); g.moveTo(0, Y(y)); g.lineTo(width, Y(y)); g.stroke();
    if (Y(y) < height - 20 && Y(y) > 10) g.fillText(label(y, by) + (Y(y - by) > height - 20 ? " m" : ""), 4, Y(y) - 3);
  }
}

// Posture as a cross with a longer arm ahead.
function drawCross(view, at, style, size) {
  const [c, s] = [Math.cos(at[2]) * size, Math.sin(at[2]) * size];
  drawLine(view, [at, [at[0] + 1.6 * c, at[1] + 1.6 * s]], style, 2);
  drawLine(view, [[at[0] + s, at[1] - c], [at[0] - s, at[1] + c]], style, 2);
}

// Goal with its tolerance: a circle of positions and a sector of headings.
function drawGoal(view, goal, [radius, angle]) {
  const { g, scale, X, Y } = view, [x, y, phi] = goal, alpha = g.globalAlpha;
  drawCircle(view, goal, radius * scale, color("--goal"), 1.2, [4, 3]);
  g.beginPath(); g.moveTo(X(x), Y(y)); g.arc(X(x), Y(y), Math.max(radius, 0.16) * scale, -phi - angle, -phi + angle); g.closePath();
  g.globalAlpha = 0.25 * alpha; g.fillStyle = color("--goal"); g.fill(); g.globalAlpha = alpha;
  drawCross(view, goal, color("--goal"), 0.1);
}

// Axles with their wheels, and the frames as they are bent. `axles`: postures; `frame`: points of all frames from the
// rear end on, global.
function drawRobot(view, body, axles, frame) {
  const { g, scale } = view, { half_track: d, wheel_radius: r, wheel_width: w } = body;
  for (const [x, y, phi] of axles) {
    const [c, s] = [Math.cos(phi), Math.sin(phi)];
    const at = (u, v) => [x + u * c - v * s, y + u * s + v * c];
    drawLine(view, [at(0, -d), at(0, d)], color("--body"), Math.max(2, 0.012 * scale));
    for (const side of [d, -d]) {
      trace(view, [at(-r, side - w / 2), at(r, side - w / 2), at(r, side + w / 2), at(-r, side + w / 2)]);
      g.closePath(); g.fillStyle = color("--body"); g.fill();
    }
  }
  drawLine(view, frame, color("--frame"), Math.max(3, 0.014 * scale));
}

// Ellipse of a covariance [xx, xy, yy, phi phi], with half axes of `sigmas` standard deviations, around a pixel.
function drawEllipse(g, x, y, scale, [a, b, c], sigmas) {
  const mean = (a + c) / 2, half = Math.hypot((a - c) / 2, b), axis = (variance) => sigmas * Math.sqrt(Math.max(0, variance)) * scale;
  g.beginPath();
  g.ellipse(x, y, axis(mean + half), axis(mean - half), -0.5 * Math.atan2(2 * b, a - c), 0, 7);
  g.strokeStyle = color("--estimate"); g.lineWidth = 1.5; g.setLineDash(dash("--estimate")); g.stroke(); g.setLineDash([]);
}

// Estimate with the ellipse of its uncertainty.
function drawEstimate(view, estimate, covariance, sigmas) {
  drawCross(view, estimate, color("--estimate"), 0.045);
  drawEllipse(view.g, view.X(estimate[0]), view.Y(estimate[1]), view.scale, covariance, sigmas);
}

// Square of an inset.
const insetSize = ({ width }) => Math.min(150, width * 0.34);

// Corners for an inset, in order of preference: top right, top left, bottom right, bottom left.
function insetCorners(view) {
  const { width, height } = view, size = insetSize(view);
  return [[width - size - 8, 8], [48, 8], [width - size - 8, height - size - 22], [48, height - size - 22]];
}

// True if a point, m, is below an inset at a corner or within `by` pixels of it.
function underInset(view, [x, y], point, by) {
  const u = view.X(point[0]), v = view.Y(point[1]), size = insetSize(view);
  return u > x - by && u < x + size + by && v > y - by && v < y + size + by;
}

// The corner that hides the fewest of the points, and rather these than the robot, which is given by some points.
function bestCorner(view, corners, points, robot) {
  const count = (corner, of, by) => of.filter((point) => underInset(view, corner, point, by)).length;
  const hidden = (corner) => count(corner, points, 20) + 1e6 * count(corner, robot, 40);
  return corners.reduce((best, corner) => (hidden(corner) < hidden(best) ? corner : best));
}

// The estimate around the truth, magnified: `spread`, m, is half the shown width.
function drawInset(view, [x, y], { truth, estimate, covariance, spread, sigmas, name }) {
  const { g } = view, size = insetSize(view), scale = (size / 2 - 14) / spread, cx = x + size / 2, cy = y + size / 2 + 4;
  g.save();
  g.fillStyle = color("--card"); g.strokeStyle = color("--line"); g.lineWidth = 1;
  g.beginPath(); g.rect(x, y, size, size); g.fill(); g.stroke(); g.clip();
  g.fillStyle = color("--soft"); g.textAlign = "left";
  const titles = [`estimate around truth, ${name}`, `estimate, ${name}`];
  g.fillText(titles.find((title) => g.measureText(title).width < size - 8) || name, x + 5, y + 12);
  const bar = step(2 * spread, 3);
  g.fillRect(x + 6, y + size - 7, bar * scale, 2); g.fillText(label(1e3 * bar, 1e3 * bar) + " mm", x + 6, y + size - 11);
  g.strokeStyle = color("--truth"); g.lineWidth = 1.5; g.beginPath();
  g.moveTo(cx - 6, cy); g.lineTo(cx + 6, cy); g.moveTo(cx, cy - 6); g.lineTo(cx, cy + 6); g.stroke();
  const ex = cx + (estimate[0] - truth[0]) * scale, ey = cy - (estimate[1] - truth[1]) * scale;
  g.fillStyle = color("--estimate"); g.beginPath(); g.arc(ex, ey, 3, 0, 7); g.fill();
  drawEllipse(g, ex, ey, scale, covariance, sigmas);
  g.restore();
}
