// Orders of the visitor to the robot.
//
// Each order is one message to the Worker, and answers come in the order of the messages. Task, faults and planned path
// on the page change with the answer: so they are those of the robot, even if another order is on its way.

// Drift of the gauges by one press of the button.
const DRIFT = 20e-6;

// A new robot, and its first orders; `ordered` shows their effects.
function create(orders) {
  note("");
  showSettings();
  writeAddress();
  return ask("create", { seed: settings.seed, trial: "0", scenario: scenario(), axles: axleCount(), orders });
}

// A new robot drives to the goal.
const begin = (orders = []) => create([{ action: "regulate", at: goal() }, ...orders]);

// A new robot with the settings of the address. Without settings, if they are refused together.
async function beginByAddress() {
  const ignored = readAddress(page.contract);
  await begin();
  if (page.history.latest && !ignored.length) return;
  const refusal = find("note").textContent;
  if (!page.history.latest) { resetSettings({}); await begin(); }
  note(ignored.length ? `The page ignores these entries of the address: ${ignored.join(", ")}.` : refusal, true);
}

// A new robot of another number of axles; the present robot stays if the number is refused.
async function setAxles(count) {
  const before = settings.axles;
  settings.axles = count === 2 ? undefined : count;
  if ((await begin()).ok) return;
  settings.axles = before;
  showSettings();
  writeAddress();
}

// The Worker has a new robot. `contract` and `row`: its description and state, if it has another number of axles than the
// one before.
function created({ contract, row }) {
  if (contract) { describeRobot(contract); page.history.latest = row; }
  // Number of robots so far, for tests.
  page.generation += 1;
  page.history.clear();
  page.stage.clear();
  page.drift = 0; page.faults.clear();
  setTask(null);
  showSettings();
}

// The Worker has carried out an order of a new robot.
function ordered({ order }) {
  const effects = {
    regulate: () => setTask("goal"), hold: () => setTask("hand"), fault: () => showInjected(order.number),
    friction: () => { settings.friction = order.value; showSettings(); writeAddress(); },
  };
  effects[order.action]();
}

// Task of the robot. A planned path belongs to the task before.
function setTask(task) {
  page.task = task;
  page.stage.planned = []; page.stage.refusal = null;
}

// An order that changes a setting. The setting holds at once, since a new robot would have it; a refusal undoes it.
async function askWith(name, value, action, details) {
  const before = settings[name], show = () => { showSettings(); writeAddress(); };
  settings[name] = value;
  show();
  const answer = await ask(action, details());
  if (answer.ok) return true;
  if (settings[name] === value) settings[name] = before;
  show();
  return false;
}

async function goTo(at) {
  if (!(await askWith("goal", at, "regulate", () => ({ at })))) return;
  setTask("goal");
  note(`Goal: ${posture(at)}.`);
  run(true);
}

async function placeAt(at) {
  if (!(await askWith("start", at, "place", () => ({ at })))) return;
  setTask(null);
  page.faults.clear();
  showFaults();
  note(`Robot placed: ${posture(at)}. Move or press the goal to drive.`);
}

async function followPath(stroke) {
  setDrawing(false);
  const { stage } = page;
  stage.stroke = stroke.length > 1 ? stroke : [];
  if (!stage.stroke.length) return;
  const answer = await page.robot.call("follow", { points: Float64Array.from(stroke.flat()) });
  if (answer.ok) {
    if (stage.stroke === stroke) stage.stroke = [];
    stage.refusal = null;
    page.task = "path";
    note(`Path accepted: ${label(lengthOf(stage.planned), 0.1)} m. The robot begins it at rest.`);
    run(true);
  } else {
    refuse(answer.message, stroke[0]);
  }
  dirty();
}

// Shows the reason why a path is refused, at its place on the floor.
function refuse(message, place) {
  const text = pathReason(message);
  note("Path refused: " + text, true);
  page.stage.refusal = { at: placeIn(message) || place, text };
}

// The path as the robot has planned it, or the reason why it could not begin it.
function planned({ path, message }) {
  page.stage.planned = pairs(path);
  if (message) { page.task = null; refuse(message, Array.from(state("truth"))); }
  dirty();
}

const lengthOf = (line) => line.slice(1).reduce((sum, at, i) => sum + apart(line[i], at), 0);
const pairs = (flat) => Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i], flat[2 * i + 1]]);

// `order(speed, curvature)` drives by hand; `order(null)` stops.
async function drive(speed, curvature) {
  if (speed === null) return halt();
  run(true);
  if ((await ask("hold", { speed, curvature })).ok) setTask("hand");
}

async function halt() {
  if ((await ask("halt")).ok) setTask(null);
}

// The time of a drive by hand is over.
function released() {
  if (page.task === "hand") page.task = null;
}

async function clearCodes() {
  if (!(await ask("clear")).ok) return;
  setTask(null);
  note("Codes cleared. Set a goal.");
}

// A setting of the robot as it stands.
async function change(name, value) {
  if (await askWith(name, value, "change", () => ({ scenario: scenario() }))) changed();
}

async function repair() {
  if ((await ask("change", { scenario: scenario() })).ok) changed();
}

// With new settings the robot has no faults, and continues to its goal.
function changed() {
  setTask(page.task === "goal" ? "goal" : null);
  page.faults.clear();
  showFaults();
}

async function inject(number) {
  if ((await ask("fault", { number })).ok) showInjected(number);
}

function showInjected(number) {
  const fault = page.contract.faults[number];
  page.faults.add(number);
  find("fault-text").textContent = `${fault.name}: ${fault.text}`;
  showFaults();
}

const setFriction = (value) => askWith("friction", value, "friction", () => ({ value }));

async function addDrift() {
  if (!(await ask("drift", { strain: DRIFT })).ok) return;
  page.drift += DRIFT;
  showSettings();
}
