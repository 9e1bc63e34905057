// What the visitor can ask of the robot.

// Length of a drift of the gauges.
const DRIFT = 20e-6;

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
    page.task = "path";
    note("The robot follows the path. It begins at rest.");
    run(true);
  } else {
    refuse(answer.message, stroke[0]);
  }
  dirty();
}

function refuse(message, place) {
  const reason = message.replace(/^path: /, "");
  note("Path refused: " + reason, true);
  page.stage.refusal = { at: placeIn(reason) || place, text: reason };
}

// The path as the robot has planned it, or the reason why it could not begin it.
function planned({ path, message }) {
  page.stage.planned = pairs(path);
  if (message) { page.task = null; refuse(message, Array.from(state("truth"))); }
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
