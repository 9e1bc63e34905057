// State and codes in words.

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

  // `task`: what the visitor has asked for.
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

  // Code that stopped the robot: rather a cause than its consequence in another node.
  stopCode(row) {
    const failed = this.codes.get(this.one(row, "failed"));
    if (failed) return failed;
    const stops = this.codesOf(row).filter((code) => code.class === "stop" || code.class === "cut");
    return stops.find((code) => code.name !== "neighbour stopped") || stops[0];
  }

  // Codes that hold, without repetition: first the failure, then reasons of the nodes, then notices.
  codesOf(row) {
    const numbers = [this.one(row, "failed"), ...this.layout.of(row, "reasons")];
    this.layout.of(row, "notices").forEach((holds, n) => { if (holds) numbers.push(this.contract.codes[n].code); });
    return [...new Set(numbers)].map((number) => this.codes.get(number)).filter(Boolean);
  }

  show(row, task) {
    const sentence = this.sentence(row, task), codes = this.codesOf(row), key = sentence + codes.map((code) => code.code).join(",");
    if (key === this.shown) return;
    this.shown = key;
    find("sentence").textContent = sentence;
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
