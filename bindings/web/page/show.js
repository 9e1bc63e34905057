// Display of settings, faults, handles and clock, and the frame loop.

// Frames of which the busy time is kept.
const BUSY_FRAMES = 300;

function run(on) {
  if (page.running !== on) { page.running = on; page.robot.call("run", { on }); page.mark = null; page.rate = 0; }
  find("play").textContent = on ? "Pause" : "Play";
  dirty();
}

// Part of the floor that the scene shows.
function showPart(name) {
  find("view").value = page.stage.follow = name;
  dirty();
}

function setPace(value) {
  page.pace = value; page.mark = null; page.rate = 0;
  find("pace").value = String(value);
  page.robot.call("pace", { value });
}

// Posture of the goal or robot while keys move it.
const announce = (kind, at) => note(`${kind === "goal" ? "Goal" : "Robot"} to ${posture(at)}: press Enter to confirm.`);

function setDrawing(on) {
  page.hands.drawing = on;
  find("draw").setAttribute("aria-pressed", String(on));
  if (on) note("Draw a path that begins at the robot.");
}

function options(id, list) {
  find(id).replaceChildren();
  for (const { name, text } of list) {
    const option = element("option", name, find(id));
    option.value = name; option.title = text || "";
  }
}

function showSettings() {
  const { contract } = page, world = settings.world || contract.world, fusion = settings.fusion || contract.fusion;
  page.stage.goal = goal();
  find("gauges").checked = settings.gauges !== false;
  find("imu").checked = settings.imu === true;
  find("axles").value = String(axleCount());
  find("world").value = world;
  find("fusion").value = fusion;
  find("friction").value = String(settings.friction === undefined ? contract.friction : settings.friction);
  find("friction-text").textContent = settings.friction === undefined ? "of the world" : label(settings.friction, 0.01);
  find("drift-text").textContent = page.drift ? `drifted by ${label(1e6 * page.drift, 1)} µm/m` : "";
  find("seed").value = settings.seed;
  const text = (list, name) => { const one = list.find((entry) => entry.name === name); return one && one.text ? `${name}: ${one.text} ` : ""; };
  find("settings-text").textContent = text(contract.worlds, world) + text(contract.fusions, fusion);
  showFaults();
}

function showFaults() {
  [...find("faults").children].forEach((button, n) => button.setAttribute("aria-pressed", String(page.faults.has(n))));
}

function showKey() {
  find("key").replaceChildren();
  const chain = page.contract.axles.length > 2, axles = chain ? { "--others": "true paths of the axles" } : {};
  const key = { "--truth": chain ? "true path of the midpoint" : "true path", ...axles, "--estimate": "estimate, 95 % ellipse", "--reference": "planned path", "--goal": "goal, tolerance", "--frame": chain ? "strips" : "strip", "--outside": "strains" };
  Object.entries(key).forEach(([look, name]) => (look === "--outside" ? swatch(find("key"), look, name, []) : swatch(find("key"), look, name)));
}

function showHandle(button, name, at) {
  const { view } = page.stage;
  button.hidden = !at || !Number.isFinite(at[0]);
  if (button.hidden) return;
  button.style.transform = `translate(${view.X(at[0]).toFixed(1)}px, ${view.Y(at[1]).toFixed(1)}px)`;
  const text = `${name}: ${posture(at)}`;
  // Screen readers need no update a frame.
  if (page.frames % 30 === 0 && button.getAttribute("aria-label") !== text) button.setAttribute("aria-label", text);
}

// Pace that this computer reaches, over the last second.
function measurePace(time) {
  const now = performance.now();
  if (!page.mark || time < page.mark.time) page.mark = { now, time };
  if (now - page.mark.now < 1000) return;
  page.rate = (time - page.mark.time) / (now - page.mark.now) * 1000;
  page.mark = { now, time };
}

function showClock() {
  const time = state("time_s")[0];
  if (page.running) measurePace(time);
  const slow = page.running && page.rate > 0 && page.rate < 0.8 * page.pace ? ` (reaches ×${label(page.rate, 0.1)})` : "";
  const text = `${time.toFixed(2)} s${slow}`;
  if (find("clock").textContent !== text) find("clock").textContent = text;
}

function frame() {
  requestAnimationFrame(frame);
  const begin = performance.now();
  if (!page.history.latest || begin > page.drawUntil) return;
  page.frames += 1;
  page.stage.draw(page.history.latest, Boolean(page.hands.held));
  const ghost = page.stage.ghost, at = (kind, real) => (ghost && ghost.kind === kind ? ghost.at : real);
  showHandle(find("goal-handle"), "Goal", at("goal", page.stage.goal));
  showHandle(find("robot-handle"), "Robot", at("robot", state("truth")));
  page.plots.draw();
  if (page.frames % 2) drawStrips(find("strip"), page.contract, state("strain"), page.stage.scale || STRAIN_SCALES[0], settings.gauges !== false);
  if (page.frames % 6 === 0) page.words.show(page.history.latest, page.task);
  showClock();
  page.busy.push(performance.now() - begin + page.inbox);
  page.inbox = 0;
  if (page.busy.length > BUSY_FRAMES) page.busy.shift();
}
