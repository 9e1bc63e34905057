// State, codes and refusals in words.

const cm = (length) => (length < 1e-3 ? "less than 0.1 cm" : label(100 * length, 0.1) + " cm");

// Place that a refusal names, m.
function placeIn(text) {
  const found = /x = (-?[0-9.]+) m, y = (-?[0-9.]+) m/.exec(text);
  return found && [Number(found[1]), Number(found[2])];
}

// Reason of a refused path without the waypoints, which the visitor does not see. Curvatures become radii.
function pathReason(message) {
  const text = message.replace(/^path: /, "").replace(/s = [0-9.]+ m, /, "").replace(/ \(near waypoint [0-9]+\)/, "").replace(/= -/g, "= −");
  const found = /^curvature (-?[0-9.]+) 1\/m at (.*): the frame allows at most ([0-9.]+) 1\/m/.exec(text);
  if (!found) return text;
  const radius = (curvature) => cm(1 / Math.abs(Number(curvature)));
  return `the path bends with a radius of ${radius(found[1])} at ${found[2]}: the frame allows ${radius(found[3])} at least.`;
}

// Sentences for the phases of a drive to a goal, and for the modes of a robot without a task.
const PHASES = {
  stop: "Comes to rest.", plan: "At rest. Looks for a path to the goal.", steer: "Bends the strip for the next arc.",
  segment: "Drives an arc of its plan.", approach: "Drives to the goal.", hold: "At the goal. Checks its place.",
  done: "Rests at the goal.", gaveup: "Gave up. Rests beside the goal.",
};
const MODES = { idle: "Motors off. Waits for a task.", clear: "Motors off. Clears its codes.", hold: "Stands still.", active: "Comes to rest." };

const bare = (name) => String(name || "").toLowerCase().replace(/[^a-z]/g, "");

class Words {
  constructor(contract, layout) {
    this.contract = contract;
    this.layout = layout;
    this.codes = new Map(contract.codes.map((code) => [code.code, code]));
    this.shown = "";
  }

  one(row, name) {
    return this.layout.of(row, name)[0];
  }

  // `task`: goal, path, hand or null.
  sentence(row, task) {
    const stopped = this.stopCode(row);
    if (stopped) return `Stopped: ${stopped.name}.`;
    const name = (list, index) => bare(this.contract[list][this.one(row, index)]), mode = name("modes", "mode");
    const done = this.one(row, "done") === 1;
    if (mode === "clear" || mode === "idle" && !done) return MODES[mode];
    if (task === "goal") return PHASES[done ? "done" : name("phases", "phase")] || "Drives to the goal.";
    if (task === "path") return done ? "Rests at the end of the path." : "Follows the path.";
    if (task === "hand") return "You drive.";
    return MODES[mode] || `Mode ${mode}.`;
  }

  // Code that stopped the robot; a cause before its consequence in another node.
  stopCode(row) {
    const failed = this.codes.get(this.one(row, "failed"));
    if (failed) return failed;
    const stops = this.codesOf(row).filter((code) => code.class === "stop" || code.class === "cut");
    return stops.find((code) => code.name !== "neighbour stopped") || stops[0];
  }

  // Active codes, without repetition: the failure, then reasons of the nodes, then notices.
  codesOf(row) {
    const numbers = [this.one(row, "failed"), ...this.layout.of(row, "reasons")];
    this.layout.of(row, "notices").forEach((holds, n) => { if (holds) numbers.push(this.contract.codes[n].code); });
    return [...new Set(numbers)].map((number) => this.codes.get(number)).filter(Boolean);
  }

  show(row, task) {
    const sentence = this.sentence(row, task), codes = this.codesOf(row), valid = this.one(row, "valid") === 1;
    const key = [sentence, valid, ...codes.map((code) => code.code)].join();
    if (key === this.shown) return;
    this.shown = key;
    find("sentence").textContent = sentence;
    find("no-estimate").textContent = valid ? "" : "The robot has no valid estimate of its posture, so the page shows none.";
    find("codes").replaceChildren();
    for (const code of codes) {
      const item = element("li", "", find("codes"));
      item.className = code.class;
      element("b", code.name, item);
      item.append(` (${code.class}, 0x${code.code.toString(16).padStart(2, "0")}): ${code.meaning}. `);
      element("span", `Advice: ${code.remedy}.`, item).className = "soft";
    }
    find("no-codes").hidden = codes.length > 0;
  }
}
