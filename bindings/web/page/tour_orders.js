// Actions of the tour.

// Friction of the tour's slippery floor, and the time at which the robot comes to it, s.
const SLIPPERY = 0.08, SLIP_AT_S = 4;

function resetSettings(changes) {
  const { seed } = settings;
  Object.keys(settings).forEach((name) => delete settings[name]);
  Object.assign(settings, { seed }, changes);
}

// The paper's drive with these settings and no others, and with these orders.
function experiment(changes, orders) {
  resetSettings(changes);
  showPart("all");
  run(true);
  return begin(orders);
}

const tourOrders = {
  experiment,
  curve() {
    resetSettings({});
    showPart("robot");
    run(true);
    const { speed, curvature } = page.contract.limits;
    return create([{ action: "hold", speed: 0.75 * speed, curvature: 0.7 * curvature, seconds: 9 }]);
  },
  breakGauge() {
    const number = page.contract.faults.findIndex((fault) => fault.name.startsWith("gauge"));
    return experiment({}, [{ action: "fault", number }]);
  },
  slip() {
    return experiment({}, [{ action: "friction", value: SLIPPERY, at_s: SLIP_AT_S }]);
  },
  async paper() {
    const seed = { seed: settings.seed };
    page.trials.clear();
    await page.trials.run(TRIALS, "without gauges", { ...seed, gauges: false });
    await page.trials.run(TRIALS, "with gauges", seed);
  },
};
