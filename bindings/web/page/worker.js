// The simulation in a Worker: WebAssembly, its buffers, and the clock of the run. One script for the robot on the
// scene and for the Workers of the trials.
"use strict";

// Ticks of an epoch, and its length in seconds.
const EPOCH_TICKS = 10, EPOCH_S = 0.01;
// Time between two turns of the loop, and the longest computation in a turn, ms.
const TURN_MS = 8, BUDGET_MS = 14;
// Epochs after which a held speed is sent again: the robot stops 200 ms after the last one.
const REPEAT_EPOCHS = 5;

let module, web, width = 0;
// Number of the planned path, and its place in a state.
let plans = 0, plansAt;
let setup = { seed: "1", trial: "0", scenario: "" };
let running = false, pace = 1, due = 0, last = 0, held = null;
let rows = [];

const encoder = new TextEncoder(), decoder = new TextDecoder();

// Memory may grow in a call, so each view is made after the call that gives its pointer.
function write(text) {
  const bytes = encoder.encode(text), at = web.text(bytes.length);
  new Uint8Array(web.memory.buffer, at, bytes.length).set(bytes);
}

function read(length) {
  const at = web.text(length);
  return decoder.decode(new Uint8Array(web.memory.buffer, at, length));
}

function numbers(count) {
  const at = web.numbers(count);
  return new Float64Array(web.memory.buffer, at, count);
}

function message() {
  const length = web.message();
  return length ? read(length) : "";
}

const done = (result) => (result ? { ok: true } : { ok: false, message: message() });

function instance() {
  web = new WebAssembly.Instance(module, {}).exports;
}

function create() {
  write(setup.scenario);
  held = null; due = 0; rows = []; plans = 0;
  const answer = done(web.create(BigInt(setup.seed), BigInt(setup.trial)));
  if (answer.ok) observe();
  return answer;
}

// Keeps the state of the latest epoch for the page, and the planned path if it has changed.
function observe() {
  width = web.state();
  const row = numbers(width).slice();
  rows.push(row);
  if (row[plansAt] === plans) return;
  plans = row[plansAt];
  const count = web.planned(), refusal = count ? "" : message();
  postMessage({ event: "planned", path: numbers(2 * count).slice(), message: refusal });
}

function epoch() {
  if (held) {
    if (held.epochs % REPEAT_EPOCHS === 0) web.speed(held.speed, held.curvature);
    held.epochs += 1;
    if (held.epochs >= held.most) { held = null; web.halt(); }
  }
  const ticks = web.advance(EPOCH_TICKS);
  if (ticks < EPOCH_TICKS) {
    running = false;
    postMessage({ event: "halted", message: message() });
  }
  observe();
}

function turn() {
  const now = performance.now();
  if (running) {
    due += (now - last) / 1000 * pace / EPOCH_S;
    guarded(() => { while (running && due >= 1 && performance.now() < now + BUDGET_MS) { epoch(); due -= 1; } });
    // What this computer cannot do in time is left out: the page shows the pace that it reaches.
    due = Math.min(due, 1 + 0.05 * pace / EPOCH_S);
  }
  last = now;
  send();
}

function send() {
  if (!rows.length) return;
  const all = new Float64Array(width * rows.length);
  rows.forEach((row, i) => all.set(row, width * i));
  const count = rows.length;
  rows = [];
  postMessage({ event: "rows", count, all, generation: setup.generation }, [all.buffer]);
}

// A panic ends the instance: a new one begins with the same robot, and the page reports it.
function guarded(run) {
  try {
    return run();
  } catch (error) {
    if (!(error instanceof WebAssembly.RuntimeError)) {
      postMessage({ event: "error", message: String(error.message || error) });
      return { ok: false, message: "The page has an error." };
    }
    rows = []; held = null;
    instance();
    const again = setup.created ? create() : { ok: true };
    postMessage({ event: "restarted", message: String(error.message || error), ok: again.ok });
    return { ok: false, message: "The program ended with an error. A new robot stands at the start." };
  }
}

const actions = {
  load(details) {
    module = details.module;
    instance();
    const contract = JSON.parse(read(web.describe())), place = contract.state.findIndex(([name]) => name === "plans");
    plansAt = contract.state.slice(0, place).reduce((sum, [, count]) => sum + count, 0);
    return { ok: true, contract };
  },
  create(details) {
    setup = { ...details, created: true };
    return create();
  },
  change({ scenario }) {
    held = null;
    write(scenario);
    const answer = done(web.change());
    if (answer.ok) { setup.scenario = scenario; observe(); }
    return answer;
  },
  place({ at }) {
    held = null;
    const answer = done(web.place(...at));
    if (answer.ok) observe();
    return answer;
  },
  regulate({ at }) {
    held = null;
    return done(web.regulate(...at));
  },
  follow({ points }) {
    held = null;
    numbers(points.length).set(points);
    const answer = done(web.follow(points.length / 2));
    if (answer.ok) observe();
    return answer;
  },
  hold({ speed, curvature, seconds = Infinity }) {
    const answer = done(web.speed(speed, curvature));
    held = answer.ok ? { speed, curvature, epochs: 0, most: seconds / EPOCH_S } : null;
    return answer;
  },
  halt() {
    held = null;
    return done(web.halt());
  },
  clear: () => done(web.clear()),
  fault: ({ number }) => done(web.fault(number)),
  friction: ({ value }) => done(web.friction(value)),
  drift: ({ strain }) => done(web.gauge_drift(strain)),
  run({ on }) {
    running = on; due = 0; last = performance.now();
    return { ok: true };
  },
  pace({ value }) {
    pace = value;
    return { ok: true };
  },
  step() {
    epoch();
    return { ok: true };
  },
  outcome({ scenario, seed, trial }) {
    write(scenario);
    const count = web.outcome(BigInt(seed), BigInt(trial));
    return count ? { ok: true, outcome: Array.from(numbers(count)) } : { ok: false, message: message() };
  },
};

onmessage = ({ data }) => {
  const answer = guarded(() => actions[data.action](data));
  send();
  postMessage({ event: "answer", id: data.id, answer });
  if (data.action === "create") { last = performance.now(); }
};

setInterval(turn, TURN_MS);
