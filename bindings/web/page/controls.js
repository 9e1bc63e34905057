// Buttons, fields and keys of the page.

const PACES = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];

const onClick = (id, act) => find(id).addEventListener("click", act);

function connect() {
  onClick("play", () => run(!page.running));
  onClick("epoch", () => { run(false); page.robot.call("step"); });
  onClick("draw", () => setDrawing(!page.hands.drawing));
  onClick("halt", halt);
  onClick("nearer", () => zoomBy(1.4));
  onClick("farther", () => zoomBy(1 / 1.4));
  onClick("drift", addDrift);
  onClick("again", () => begin());
  onClick("another", () => { settings.seed = String(BigInt(settings.seed) + 1n); begin(); });
  onClick("defaults", () => { page.trials.clear(); experiment({}); });
  onClick("clear", clearCodes);
  onClick("repair", repair);
  onClick("trials-run", () => page.trials.run(TRIALS, settingsName(), { ...settings }));
  onClick("trials-clear", () => page.trials.clear());
  onClick("save-log", () => saveLog(page.history));
  onClick("save-picture", () => savePicture(find("scene")));
  find("view").addEventListener("change", () => showPart(find("view").value));
  find("pace").addEventListener("change", () => setPace(Number(find("pace").value)));
  find("window").addEventListener("change", () => page.plots.drawAll());
  find("gauges").addEventListener("change", () => change("gauges", find("gauges").checked));
  find("imu").addEventListener("change", () => change("imu", find("imu").checked));
  find("axles").addEventListener("change", () => setAxles(Number(find("axles").value)));
  find("world").addEventListener("change", () => change("world", find("world").value));
  find("fusion").addEventListener("change", () => change("fusion", find("fusion").value));
  find("friction").addEventListener("input", () => setFriction(Number(find("friction").value)));
  find("seed").addEventListener("change", () => {
    if (/^[0-9]{1,18}$/.test(find("seed").value)) { settings.seed = find("seed").value; begin(); }
    else { note("A seed is a whole number of at most 18 digits.", true); find("seed").value = settings.seed; }
  });
  document.addEventListener("keydown", key);
  window.addEventListener("resize", () => { dirty(); page.plots.drawAll(); });
  window.addEventListener("hashchange", beginByAddress);
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
  const parts = [settings.world || page.contract.world];
  if (settings.axles) parts.push(`${settings.axles} axles`);
  parts.push(settings.gauges === false ? "without gauges" : "with gauges");
  if (settings.imu) parts.push("IMU");
  if (settings.fusion) parts.push(settings.fusion);
  if (settings.friction !== undefined) parts.push("friction " + label(settings.friction, 0.01));
  return parts.join(", ");
}
