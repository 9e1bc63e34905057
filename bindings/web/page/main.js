// Messages of the Worker, and the start of the page.

function takeRows({ all, count }) {
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
  note(`The program ended with an error (${message}). A new robot stands at the start.`, true);
}

// Makes the parts of the page that depend on the robot's axles and frames.
function describeRobot(contract) {
  page.contract = contract;
  page.layout = new Layout(contract.state);
  page.history = new History(page.layout);
  page.stage.describe(contract, page.layout);
  page.words = new Words(contract, page.layout);
  find("plots").replaceChildren();
  page.plots = new Plots(find("plots"), contract, page.history);
  find("faults").replaceChildren();
  contract.faults.forEach((fault, n) => {
    const button = element("button", fault.name, find("faults"));
    button.type = "button"; button.title = fault.text;
    button.addEventListener("click", () => inject(n));
  });
  find("fault-text").textContent = "";
  const strips = contract.beams.length > 1 ? "The strips, straightened" : "The strip, straightened";
  find("strip-title").textContent = `${strips}: strain at each gauge (µm/m)`;
  find("strip").style.height = `${stripHeight(contract)}px`;
  showKey();
}

async function start() {
  if (typeof WebAssembly === "undefined" || typeof DecompressionStream === "undefined") {
    find("loading").textContent = "This page needs a browser of 2023 or later.";
    return;
  }
  const module = await unpack();
  const error = ({ message }) => report("Worker: " + message);
  page.robot = new Simulation({ rows: takeRows, created, ordered, planned, released, halted, restarted, error });
  const { contract } = await page.robot.call("load", { module });
  page.stage = new Stage(find("scene"));
  describeRobot(contract);
  page.trials = new Trials(module, contract, page.stage, dirty);
  page.hands = new Hands(page.stage, { goal: goTo, place: placeAt, path: followPath, announce, dirty }, () => state("truth"), () => state("axles"));
  new Drive(contract.limits, drive);
  new Tour(tourOrders);
  options("world", contract.worlds);
  options("fusion", contract.fusions);
  options("pace", PACES.map((value) => ({ name: String(value) })));
  [...find("pace").options].forEach((option) => { option.textContent = "×" + option.value; option.selected = option.value === "1"; });
  options("axles", Array.from({ length: contract.most_axles - 1 }, (_, n) => ({ name: String(n + 2) })));
  [find("friction").min, find("friction").max] = contract.limits.friction.map(String);
  find("version").textContent = contract.version;
  connect();
  await beginByAddress();
  run(!reducedMotion.matches);
  find("loading").hidden = true;
  page.ready = true;
  requestAnimationFrame(frame);
}

// For tests.
window.cfmmr = {
  ready: () => page.ready && page.frames > 0,
  time: () => state("time_s")[0],
  state: (name) => Array.from(state(name)),
  goal: () => page.stage.goal,
  speed: () => page.pace,
  rate: () => page.rate,
  busy: () => [...page.busy].sort((a, b) => a - b)[page.busy.length >> 1] || 0,
  errors: () => errors,
};

start();
