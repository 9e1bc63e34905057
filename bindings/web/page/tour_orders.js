// Actions of the tour.

// Friction of the tour's slippery floor, and the time at which the robot comes to it, s.
const SLIPPERY = 0.08, SLIP_AT_S = 4;

function resetSettings(changes) {
  const { seed } = settings;
  Object.keys(settings).forEach((name) => delete settings[name]);
  Object.assign(settings, { seed }, changes);
}

// The paper's drive with these settings and no others, and with these faults.
function experiment(changes, faults) {
  resetSettings(changes);
  showPart("all");
  run(true);
  return begin(faults);
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
    const { speed, curvature } = page.contract.limits;
    const task = { action: "hold", speed: 0.75 * speed, curvature: 0.7 * curvature, seconds: 9 };
    if ((await create([task])).ok) page.task = "hand";
  },
  breakGauge() {
    return experiment({}, [page.contract.faults.findIndex((fault) => fault.name.startsWith("gauge"))]);
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
