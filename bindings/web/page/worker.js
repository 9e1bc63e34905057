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
// Number of axles of the robot on the scene, and of the planned path, and the place of the latter in a state.
let axles = 0, plans = 0, plansAt;
// Seed, trial and scenario of the robot on the scene; null for the Workers of the trials.
let setup = null;
// Orders that outlast a change of settings or a placement of the robot.
let friction, drifts, goal;
// Orders with a time, earliest first, and epochs since the robot was created.
let timed = [], epochs = 0;
// Speed and curvature that are commanded until the next order.
let held = null;
// Clock: epochs that are due, and time of the latest turn, ms.
let running = false, pace = 1, due = 0, last = 0;
// States that the page has not got yet.
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

// Description of a robot with a number of axles; its states have the places of this description.
function describe(count) {
  const contract = JSON.parse(read(web.describe(count))), place = contract.state.findIndex(([name]) => name === "plans");
  plansAt = contract.state.slice(0, place).reduce((sum, [, size]) => sum + size, 0);
  axles = count;
  return contract;
}

function create(wanted) {
  write(wanted.scenario);
  const answer = done(web.create(BigInt(wanted.seed), BigInt(wanted.trial)));
  if (!answer.ok) return answer;
  setup = wanted;
  const contract = wanted.axles === axles ? null : describe(wanted.axles);
  friction = undefined; drifts = []; goal = null; held = null;
  timed = []; epochs = 0;
  rows = []; plans = 0; due = 0; last = performance.now();
  postMessage({ event: "created", contract, row: contract && numbers(web.state()).slice() });
  observe();
  return answer;
}

// A change of settings or a placement begins another simulation of the robot, without friction, drift and goal.
function restore(resume) {
  held = null;
  if (friction !== undefined) web.friction(friction);
  for (const strain of drifts) web.gauge_drift(strain);
  if (!resume) goal = null;
  if (goal) web.regulate(...goal);
  observe();
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

function carryOut(order) {
  const answer = actions[order.action](order);
  if (answer.ok) postMessage({ event: "ordered", order });
  return answer;
}

function epoch() {
  while (timed.length && epochs * EPOCH_S >= timed[0].at_s) carryOut(timed.shift());
  if (held) {
    if (held.epochs % REPEAT_EPOCHS === 0) web.speed(held.speed, held.curvature);
    held.epochs += 1;
    if (held.epochs >= held.most) {
      held = null;
      web.halt();
      postMessage({ event: "released" });
    }
  }
  const ticks = web.advance(EPOCH_TICKS);
  if (ticks < EPOCH_TICKS) {
    running = false;
    postMessage({ event: "halted", message: message() });
  }
  epochs += 1;
  observe();
}

function turn() {
  const now = performance.now();
  if (running) {
    due += (now - last) / 1000 * pace / EPOCH_S;
    guarded(() => { while (running && due >= 1 && performance.now() < now + BUDGET_MS) { epoch(); due -= 1; } });
    // Epochs that this computer cannot compute in time are dropped: the page shows the pace that it reaches.
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
  postMessage({ event: "rows", count, all }, [all.buffer]);
}

// A panic ends the instance: another one begins with the same robot, and the page reports the panic.
function guarded(run) {
  try {
    return run();
  } catch (error) {
    if (!(error instanceof WebAssembly.RuntimeError)) {
      postMessage({ event: "error", message: String(error.message || error) });
      return { ok: false, message: "The page has an error." };
    }
    instance();
    if (setup) create(setup);
    postMessage({ event: "restarted", message: String(error.message || error) });
    return { ok: false, message: "The program ended with an error. A new robot stands at the start." };
  }
}

const actions = {
  load(details) {
    module = details.module;
    instance();
    return { ok: true, contract: describe(2) };
  },
  // `orders`: actions carried out before time goes on, or at the time `at_s`.
  create({ seed, trial, scenario, axles: count, orders }) {
    let answer = create({ seed, trial, scenario, axles: count });
    if (!answer.ok) return answer;
    timed = orders.filter((order) => order.at_s);
    for (const order of orders) if (answer.ok && !order.at_s) answer = carryOut(order);
    return answer;
  },
  change({ scenario }) {
    write(scenario);
    const answer = done(web.change());
    if (answer.ok) { setup.scenario = scenario; restore(true); }
    return answer;
  },
  place({ at }) {
    const answer = done(web.place(...at));
    if (answer.ok) restore(false);
    return answer;
  },
  regulate({ at }) {
    const answer = done(web.regulate(...at));
    if (answer.ok) { held = null; goal = at; }
    return answer;
  },
  follow({ points }) {
    numbers(points.length).set(points);
    const answer = done(web.follow(points.length / 2));
    if (answer.ok) { held = null; goal = null; observe(); }
    return answer;
  },
  hold({ speed, curvature, seconds = Infinity }) {
    const answer = done(web.speed(speed, curvature));
    if (answer.ok) { held = { speed, curvature, epochs: 0, most: seconds / EPOCH_S }; goal = null; }
    return answer;
  },
  halt() {
    held = null; goal = null;
    return done(web.halt());
  },
  clear() {
    held = null; goal = null;
    return done(web.clear());
  },
  fault: ({ number }) => done(web.fault(number)),
  friction({ value }) {
    const answer = done(web.friction(value));
    if (answer.ok) friction = value;
    return answer;
  },
  drift({ strain }) {
    const answer = done(web.gauge_drift(strain));
    if (answer.ok) drifts.push(strain);
    return answer;
  },
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
};

setInterval(turn, TURN_MS);
