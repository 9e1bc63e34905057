// Plots over time, and the strip with its strains.

// Most points of a curve: more are not visible, and cost time.
const MOST_POINTS = 240;
const NORMAL_95 = 1.96;

// Plots: `values` gives the value of each curve for a state.
function plotTable(contract, layout) {
  const chain = contract.axles.length > 2;
  const wheels = contract.axles.flatMap((axle) => [axle + " left", axle + " right"]);
  const torques = (row, n) => layout.of(row, "torque").subarray(2 * n, 2 * n + 2);
  // The curves of many wheels in one plot could not be told apart.
  const torquePlots = chain
    ? contract.axles.map((axle, n) => ({ title: `Wheel torques of ${axle}`, unit: "N m", series: ["left", "right"], values: (row) => torques(row, n) }))
    : [{ title: "Wheel torques", unit: "N m", series: wheels, values: (row) => layout.of(row, "torque") }];
  const valid = (row) => layout.of(row, "valid")[0] === 1;
  const position = (row) => {
    if (!valid(row)) return [NaN, NaN];
    const [xx, xy, yy] = layout.of(row, "covariance"), largest = (xx + yy) / 2 + Math.hypot((xx - yy) / 2, xy);
    return [1e3 * apart(layout.of(row, "estimate"), layout.of(row, "truth")), 1e3 * SIGMAS_95 * Math.sqrt(Math.max(0, largest))];
  };
  const heading = (row) => {
    if (!valid(row)) return [NaN, NaN];
    const off = Math.abs(wrap(layout.of(row, "estimate")[2] - layout.of(row, "truth")[2]));
    return [degrees(off), NORMAL_95 * degrees(Math.sqrt(Math.max(0, layout.of(row, "covariance")[3])))];
  };
  return [
    { title: "Position error of the estimate", unit: "mm", series: ["true error", "95 % limit by the robot"], looks: ["--c0", "--estimate"], values: position },
    { title: "Heading error of the estimate", unit: "°", series: ["true error", "95 % limit by the robot"], looks: ["--c0", "--estimate"], values: heading },
    { title: chain ? "Largest disagreement of a beam and its wheels" : "Disagreement of beam and wheels", unit: "mm, mrad", series: ["along", "across", "heading"], values: (row) => Array.from(layout.of(row, "innovation"), (value) => 1e3 * value) },
    ...torquePlots,
  ];
}

class Plots {
  constructor(parent, contract, history) {
    this.history = history;
    this.plots = plotTable(contract, history.layout).map((plot) => this.made(plot, parent));
    this.next = 0;
  }

  made(plot, parent) {
    const card = element("div", "", parent); card.className = "card plot";
    element("h2", `${plot.title} (${plot.unit})`, card);
    const legend = element("div", "", card); legend.className = "legend";
    const looks = plot.looks || plot.series.map((_, n) => `--c${n}`);
    const values = plot.series.map((name, n) => element("b", "", swatch(legend, looks[n], name + " ")));
    const canvas = element("canvas", "", card);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${plot.title} over time`);
    return { ...plot, looks, shown: values, canvas };
  }

  // One plot a frame, so that a frame stays short.
  draw() {
    this.drawOne(this.plots[this.next % this.plots.length]);
    this.next += 1;
  }

  drawAll() {
    this.plots.forEach((plot) => this.drawOne(plot));
  }

  drawOne(plot) {
    const { history } = this, span = Number(find("window").value), end = history.layout.of(history.latest, "time_s")[0];
    const start = Math.max(0, end - span), first = history.index(start), count = history.length - first;
    const stride = Math.max(1, Math.ceil(count / MOST_POINTS)), times = [], series = plot.looks.map((look) => ({ look, data: [] }));
    // Multiples of the stride, so that a curve does not flicker as it moves.
    for (let i = Math.ceil(first / stride) * stride; i < history.length; i += stride) {
      const values = plot.values(history.row(i));
      times.push(history.time(i));
      series.forEach((one, n) => one.data.push(values[n]));
    }
    const range = chartRange(series.flatMap((one) => one.data));
    const chart = drawChart(plot.canvas, times, series, range, [start, Math.max(end, start + 1)]);
    const now = plot.values(history.latest);
    plot.shown.forEach((shown, n) => { shown.textContent = Number.isFinite(now[n]) ? label(now[n], chart.by / 20) : "–"; });
  }
}

// Height of the picture of the strips, CSS pixels.
const stripHeight = ({ beams }) => (beams.length > 1 ? 100 * beams.length : 130);

// The strips, straightened and below each other from the front, with the strain of each gauge as a bar at its place.
function drawStrips(canvas, contract, strains, scale, fitted) {
  const view = surface(canvas), count = contract.beams.length;
  contract.beams.forEach((_, n) => drawStrip(view, contract, n, strainsOf(strains, count, n), scale, fitted));
}

function drawStrip({ g, width, height: whole }, contract, frame, strains, scale, fitted) {
  const count = contract.beams.length, height = whole / count, top = frame * height;
  const left = 40, right = width - 40, middle = top + height / 2;
  const X = (place) => left + place / contract.strip_m * (right - left), most = height / 2 - 20;
  g.fillStyle = color("--soft"); g.textAlign = "center";
  g.fillText(contract.axles[frame + 1], left - 20, middle + 4); g.fillText(contract.axles[frame], right + 20, middle + 4);
  g.strokeStyle = color("--frame"); g.lineWidth = 5; g.beginPath(); g.moveTo(left, middle); g.lineTo(right, middle); g.stroke();
  if (!fitted) return g.fillText("no gauges", width / 2, middle - 12);
  g.textAlign = "left";
  if (count > 1) g.fillText(contract.beams[frame], 4, top + 14);
  if (frame + 1 === count) g.fillText(`full bar: ${label(1e6 * scale, 1)} µm/m`, 4, whole - 4);
  g.textAlign = "center";
  contract.gauges_m.forEach((place, n) => {
    const strain = strains[n], tall = Math.max(-1, Math.min(1, strain / scale)) * most;
    g.fillStyle = color("--outside");
    if (Number.isFinite(tall)) g.fillRect(X(place) - 6, middle - Math.max(0, tall), 12, Math.abs(tall));
    g.fillStyle = color("--ink");
    g.fillText(Number.isFinite(strain) ? label(1e6 * strain, 1) : "–", X(place), tall < 0 ? middle - tall + 14 : middle - tall - 6);
  });
}
