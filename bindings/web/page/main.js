// The page: puts its parts together, and carries out what the visitor asks.

const PACES = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];
// Length of a drift of the gauges.
const DRIFT = 20e-6;
// Shown before a visitor chooses; never written.
const DEFAULTS = { world: "careful", fusion: "joint" };
// Friction of the tour's slippery floor, and the time at which the robot comes to it, s.
const SLIPPERY = 0.08, SLIP_AT_S = 4;
// Frames of which the busy time is kept.
const BUSY_FRAMES = 300;

const page = {
  ready: false, running: true, generation: 0, robot: null, contract: null, layout: null, history: null, stage: null, plots: null,
  words: null, hands: null, trials: null, task: null, drawUntil: 0, drift: 0, faults: new Set(), busy: [], inbox: 0,
  pace: 1, rate: 0, mark: null,
};

const dirty = () => { page.drawUntil = performance.now() + 700; };
const state = (name) => page.layout.of(page.history.latest, name);

// Carries out a call; a refusal is shown with its reason.
async function ask(action, details) {
  const answer = await page.robot.call(action, details);
  if (!answer.ok) note(answer.message || "Refused.", true);
  dirty();
  return answer;
}

// ---- Robot ----

async function create() {
  page.generation += 1;
  note("");
  page.history.clear();
  page.stage.clear();
  page.stage.planned = []; page.stage.refusal = null;
  page.drift = 0; page.faults.clear();
  page.task = null;
  page.stage.goal = settings.goal || page.contract.mission.goal;
  showSettings();
  writeAddress();
  return ask("create", { seed: settings.seed, trial: "0", scenario: scenario(), generation: page.generation });
}

async function goTo(at) {
  page.stage.goal = at; page.stage.planned = []; page.stage.refusal = null;
  page.task = "goal";
  settings.goal = at;
  writeAddress();
  const answer = await ask("regulate", { at });
  if (answer.ok) note(`Goal: ${posture(at)}.`);
  run(true);
  return answer;
}

async function begin() {
  if ((await create()).ok) { page.task = "goal"; await ask("regulate", { at: page.stage.goal }); }
}

async function placeAt(at) {
  page.task = null;
  settings.start = at;
  writeAddress();
  page.stage.planned = []; page.faults.clear();
  if ((await ask("place", { at })).ok) note(`Robot placed: ${posture(at)}. Move or press the goal to drive.`);
  await restore();
  showFaults();
}

// Friction and drift that were set without interruption end with the simulation that had them.
async function restore() {
  if (settings.friction !== undefined) await ask("friction", { value: settings.friction });
  if (page.drift) await ask("drift", { strain: page.drift });
}

async function followPath(stroke) {
  setDrawing(false);
  if (stroke.length < 2) { page.stage.stroke = []; return; }
  const answer = await page.robot.call("follow", { points: Float64Array.from(stroke.flat()) });
  page.stage.stroke = answer.ok ? [] : stroke;
  if (answer.ok) {
    page.task = "path"; page.stage.planned = pairs(answer.path);
    note("The robot follows the path.");
    run(true);
  } else {
    const reason = answer.message.replace(/^path: /, "");
    note("Path refused: " + reason, true);
    page.stage.refusal = { at: placeIn(reason) || stroke[0], text: reason };
  }
  dirty();
}

const pairs = (flat) => Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i], flat[2 * i + 1]]);

// Place that a refusal names, m.
function placeIn(text) {
  const found = /x = (-?[0-9.]+) m, y = (-?[0-9.]+) m/.exec(text);
  return found && [Number(found[1]), Number(found[2])];
}

function drive(speed, curvature) {
  if (speed === null) { page.task = null; return ask("halt"); }
  page.task = "hand"; page.stage.planned = [];
  run(true);
  return ask("hold", { speed, curvature });
}

// A setting of the robot as it stands. The robot then continues to its goal.
async function change(name, value) {
  const before = settings[name];
  settings[name] = value;
  const answer = await ask("change", { scenario: scenario() });
  if (!answer.ok) settings[name] = before;
  page.faults.clear();
  if (answer.ok) await restore();
  showSettings();
  writeAddress();
  if (answer.ok && page.task === "goal") await ask("regulate", { at: page.stage.goal });
  else page.task = null;
}

async function inject(number) {
  const fault = page.contract.faults[number];
  if (!(await ask("fault", { number })).ok) return;
  page.faults.add(number);
  find("fault-text").textContent = `${fault.name}: ${fault.text}`;
  showFaults();
}

async function setFriction(value) {
  if (!(await ask("friction", { value })).ok) return;
  settings.friction = value;
  showSettings();
  writeAddress();
}

async function addDrift() {
  if (!(await ask("drift", { strain: DRIFT })).ok) return;
  page.drift += DRIFT;
  showSettings();
}

// ---- Orders of the tour ----

function resetSettings(changes) {
  const { seed } = settings;
  Object.keys(settings).forEach((name) => delete settings[name]);
  Object.assign(settings, { seed }, changes);
}

// The paper's drive with these settings and no others.
async function experiment(changes) {
  resetSettings(changes);
  showPart("all");
  run(true);
  await begin();
}

// True when this robot has reached a time; false if another robot was made.
function reached(time) {
  const { generation } = page;
  return new Promise((resolve) => {
    const poll = () => {
      if (generation !== page.generation) resolve(false);
      else if (state("time_s")[0] >= time) resolve(true);
      else setTimeout(poll, 20);
    };
    poll();
  });
}

const tourOrders = {
  experiment,
  async curve() {
    resetSettings({});
    showPart("robot");
    run(true);
    await create();
    page.task = "hand";
    const { speed, curvature } = page.contract.limits;
    return ask("hold", { speed: 0.75 * speed, curvature: 0.7 * curvature, seconds: 9 });
  },
  async breakGauge() {
    await experiment({});
    await inject(page.contract.faults.findIndex((fault) => fault.name.startsWith("gauge")));
  },
  async slip() {
    await experiment({});
    if (await reached(SLIP_AT_S)) await setFriction(SLIPPERY);
  },
  async paper() {
    const seed = { seed: settings.seed };
    page.trials.clear();
    await page.trials.run(TRIALS, "without gauges", { ...seed, gauges: false });
    await page.trials.run(TRIALS, "with gauges", seed);
  },
};

// ---- What is shown ----

function run(on) {
  if (page.running !== on) { page.running = on; page.robot.call("run", { on }); page.mark = null; }
  find("play").textContent = on ? "Pause" : "Play";
  dirty();
}

// Part of the floor that the scene shows.
function showPart(name) {
  find("view").value = page.stage.follow = name;
  dirty();
}

function setPace(value) {
  page.pace = value; page.mark = null;
  find("pace").value = String(value);
  page.robot.call("pace", { value });
}

const say = (kind, at) => note(`${kind === "goal" ? "Goal" : "Robot"} to ${posture(at)}: Enter carries it out.`);

function setDrawing(on) {
  page.hands.drawing = on;
  find("draw").setAttribute("aria-pressed", String(on));
  if (on) note("Draw from the robot on.");
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
  find("gauges").checked = settings.gauges !== false;
  find("imu").checked = settings.imu === true;
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
  const key = { "--truth": "true path", "--estimate": "estimate, 95 % ellipse", "--reference": "planned path", "--goal": "goal, tolerance", "--frame": "strip", "--outside": "strains" };
  Object.entries(key).forEach(([look, name]) => (look === "--outside" ? swatch(find("key"), look, name, []) : swatch(find("key"), look, name)));
}

function showHandle(button, name, at) {
  const { view } = page.stage;
  button.hidden = !at || !Number.isFinite(at[0]);
  if (button.hidden) return;
  button.style.transform = `translate(${view.X(at[0]).toFixed(1)}px, ${view.Y(at[1]).toFixed(1)}px)`;
  const text = `${name}: ${posture(at)}`;
  // Screen readers need no update a frame.
  if (page.turn % 30 === 0 && button.getAttribute("aria-label") !== text) button.setAttribute("aria-label", text);
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

page.turn = 0;

function frame() {
  requestAnimationFrame(frame);
  const begin = performance.now();
  if (!page.history.latest || begin > page.drawUntil) return;
  page.turn += 1;
  page.stage.draw(page.history.latest, Boolean(page.hands.held));
  const ghost = page.stage.ghost, at = (kind, real) => (ghost && ghost.kind === kind ? ghost.at : real);
  showHandle(find("goal-handle"), "Goal", at("goal", page.stage.goal));
  showHandle(find("robot-handle"), "Robot", at("robot", state("truth")));
  page.plots.draw();
  if (page.turn % 2) drawStrip(find("strip"), page.contract, state("strain"), page.stage.scale || STRAIN_SCALES[0], settings.gauges !== false);
  if (page.turn % 6 === 0) page.words.show(page.history.latest, page.task);
  showClock();
  page.busy.push(performance.now() - begin + page.inbox);
  page.inbox = 0;
  if (page.busy.length > BUSY_FRAMES) page.busy.shift();
}

// ---- Messages of the Worker ----

function takeRows({ all, count, generation }) {
  if (generation !== page.generation) return;
  const begin = performance.now();
  page.history.add(all, count);
  const { width } = page.layout;
  for (let i = 0; i < count; i++) page.stage.add(all.subarray(i * width, (i + 1) * width));
  dirty();
  page.inbox += performance.now() - begin;
}

function halted({ message }) {
  run(false);
  note("The robot cannot go on: " + message, true);
}

function restarted({ message }) {
  errors.push("program: " + message);
  page.history.clear();
  page.stage.clear();
  page.faults.clear(); page.task = null;
  showSettings();
  note(`The program ended with an error (${message}). A new robot stands at the start.`, true);
}

// ---- Controls ----

const onClick = (id, act) => find(id).addEventListener("click", act);

function connect() {
  onClick("play", () => run(!page.running));
  onClick("epoch", () => { run(false); page.robot.call("step"); });
  onClick("draw", () => setDrawing(!page.hands.drawing));
  onClick("halt", () => { page.task = null; ask("halt"); });
  onClick("nearer", () => zoomBy(1.4));
  onClick("farther", () => zoomBy(1 / 1.4));
  onClick("drift", addDrift);
  onClick("again", begin);
  onClick("another", () => { settings.seed = String(BigInt(settings.seed) + 1n); begin(); });
  onClick("defaults", () => { page.trials.clear(); experiment({}); });
  onClick("clear", async () => { if ((await ask("clear")).ok) note("Codes cleared. Set a goal."); });
  onClick("repair", async () => { page.faults.clear(); page.task = null; await ask("change", { scenario: scenario() }); await restore(); showFaults(); });
  onClick("trials-run", () => page.trials.run(TRIALS, settingsName(), { ...settings }));
  onClick("trials-clear", () => page.trials.clear());
  onClick("save-log", () => saveLog(page.history));
  onClick("save-picture", () => savePicture(find("scene")));
  find("view").addEventListener("change", () => showPart(find("view").value));
  find("pace").addEventListener("change", () => setPace(Number(find("pace").value)));
  find("window").addEventListener("change", () => page.plots.drawAll());
  find("gauges").addEventListener("change", () => change("gauges", find("gauges").checked));
  find("imu").addEventListener("change", () => change("imu", find("imu").checked));
  find("world").addEventListener("change", () => change("world", find("world").value));
  find("fusion").addEventListener("change", () => change("fusion", find("fusion").value));
  find("friction").addEventListener("input", () => setFriction(Number(find("friction").value)));
  find("seed").addEventListener("change", () => {
    if (/^[0-9]{1,18}$/.test(find("seed").value)) { settings.seed = find("seed").value; begin(); }
    else { note("A seed is a whole number of at most 18 digits.", true); find("seed").value = settings.seed; }
  });
  document.addEventListener("keydown", key);
  window.addEventListener("resize", () => { dirty(); page.plots.drawAll(); });
  window.addEventListener("hashchange", () => { readAddress(page.contract); begin(); });
  // A hidden page needs no simulation.
  document.addEventListener("visibilitychange", () => { if (page.running) page.robot.call("run", { on: !document.hidden }); });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty(); page.plots.drawAll(); });
}

function zoomBy(by) {
  page.stage.zoom(by, Array.from(state("truth")));
  find("view").value = "free";
  dirty();
}

// Keys of the whole page, if no control has the focus.
function key(event) {
  if (event.target !== document.body && event.target.id !== "scene" || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = {
    " ": () => run(!page.running), ".": () => find("epoch").click(), "+": () => nextPace(1), "-": () => nextPace(-1),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
}

function nextPace(by) {
  setPace(PACES[Math.max(0, Math.min(PACES.length - 1, PACES.indexOf(page.pace) + by))]);
}

function settingsName() {
  const parts = [settings.world || page.contract.world, settings.gauges === false ? "without gauges" : "with gauges"];
  if (settings.imu) parts.push("IMU");
  if (settings.fusion) parts.push(settings.fusion);
  if (settings.friction !== undefined) parts.push("friction " + label(settings.friction, 0.01));
  return parts.filter(Boolean).join(", ");
}

// ---- Start ----

async function start() {
  const module = await unpack();
  page.robot = new Simulation({ rows: takeRows, halted, restarted, error: ({ message }) => report("Worker: " + message) });
  const { contract: given } = await page.robot.call("load", { module });
  const contract = page.contract = { ...DEFAULTS, ...given };
  readAddress(contract);
  page.layout = new Layout(contract.state);
  page.history = new History(page.layout);
  page.stage = new Stage(find("scene"), page.contract, page.layout);
  page.words = new Words(contract, page.layout);
  page.plots = new Plots(find("plots"), contract, page.history);
  page.trials = new Trials(module, page.contract, page.stage, dirty);
  page.hands = new Hands(page.stage, { goal: goTo, place: placeAt, path: followPath, say, dirty }, () => state("truth"));
  new Drive(contract.limits, drive);
  new Tour(tourOrders);
  options("world", contract.worlds);
  options("fusion", contract.fusions);
  options("pace", PACES.map((value) => ({ name: String(value) })));
  [...find("pace").options].forEach((option) => { option.textContent = "×" + option.value; option.selected = option.value === "1"; });
  contract.faults.forEach((fault, n) => {
    const button = element("button", fault.name, find("faults"));
    button.type = "button"; button.title = fault.text;
    button.addEventListener("click", () => inject(n));
  });
  [find("friction").min, find("friction").max] = contract.limits.friction.map(String);
  find("version").textContent = contract.version;
  showKey();
  connect();
  await begin();
  page.running = false;
  run(!calm.matches);
  find("loading").hidden = true;
  page.ready = true;
  requestAnimationFrame(frame);
}

// For tests.
window.cfmmr = {
  ready: () => page.ready && Boolean(page.history.latest),
  time: () => state("time_s")[0],
  state: (name) => Array.from(state(name)),
  goal: () => page.stage.goal,
  speed: () => page.pace,
  rate: () => page.rate,
  busy: () => [...page.busy].sort((a, b) => a - b)[page.busy.length >> 1] || 0,
  errors: () => errors,
};

start();
