// Curves over time, of the report page and of the browser page.

// Range with 0 and a margin around the values.
function chartRange(values) {
  let low = 0, high = 0;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (high - low < 1e-12) high = low + 1;
  const margin = 0.06 * (high - low);
  return [low < 0 ? low - margin : 0, high + margin];
}

// Draws `series` ({ look, data }) over `times`; values that are not finite are gaps. Gives the step of the vertical
// axis, and functions from pixels to times and back.
function drawChart(canvas, times, series, [low, high], [start, end]) {
  const { g, width, height } = surface(canvas);
  const box = { x: 46, y: 5, w: width - 54, h: height - 22 }, span = end - start || 1;
  const X = (t) => box.x + (t - start) / span * box.w, Y = (v) => box.y + box.h - (v - low) / (high - low) * box.h;
  g.strokeStyle = color("--grid"); g.fillStyle = color("--soft"); g.lineWidth = 1; g.textAlign = "right";
  const by = step(high - low, 4);
  for (let v = Math.ceil(low / by - 1e-9) * by; v <= high + 1e-9 * by; v += by) {
    g.beginPath(); g.moveTo(box.x, Y(v)); g.lineTo(box.x + box.w, Y(v)); g.stroke(); g.fillText(label(v, by), box.x - 5, Y(v) + 4);
  }
  const every = step(span, Math.max(2, box.w / 70)); g.textAlign = "center";
  for (let t = Math.ceil(start / every) * every; t <= start + span + 1e-9; t += every) {
    g.fillText(label(t, every) + (t + every > start + span ? " s" : ""), Math.min(X(t), width - 14), height - 4);
  }
  g.save(); g.beginPath(); g.rect(box.x, box.y, box.w, box.h); g.clip();
  for (const { look, data } of series) {
    g.beginPath(); let up = false;
    data.forEach((v, i) => {
      if (v === null || !Number.isFinite(v)) { up = false; return; }
      const x = X(times[i]), y = Y(v);
      if (up) g.lineTo(x, y); else g.moveTo(x, y);
      up = true;
    });
    g.strokeStyle = color(look); g.lineWidth = 1.4; g.setLineDash(dash(look)); g.stroke();
  }
  g.restore();
  const cursor = (t) => {
    g.strokeStyle = color("--accent"); g.lineWidth = 1;
    g.beginPath(); g.moveTo(X(t), box.y); g.lineTo(X(t), box.y + box.h); g.stroke();
  };
  const time = (px) => start + (px - box.x) / box.w * span;
  return { by, cursor, time };
}

function element(tag, content, parent) {
  const made = document.createElement(tag);
  made.textContent = content;
  parent.append(made);
  return made;
}

// A line as it is drawn, and its meaning. The colour follows the colour scheme.
function swatch(parent, look, name, pattern = dash(look)) {
  const item = element("span", "", parent);
  item.innerHTML = '<svg aria-hidden="true"><line x1="1" x2="25" y1="3" y2="3" stroke-width="2"/></svg>';
  const line = item.querySelector("line");
  line.style.stroke = `var(${look})`;
  line.setAttribute("stroke-dasharray", pattern.join(" "));
  item.append(name);
  return item;
}
