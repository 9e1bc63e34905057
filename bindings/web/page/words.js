// State and codes in words.

// Sentences for what the robot is doing, by the name of its phase or mode.
const SENTENCES = {
  stop: "Comes to rest.", plan: "At rest. Looks for a path to the goal.", steer: "Bends the strip for the next arc.",
  segment: "Drives an arc of its plan.", approach: "Drives to the goal.", hold: "At the goal. Checks its place.",
  done: "Rests at the goal.", gaveup: "Gave up: rests beside the goal.",
  idle: "Motors off. Waits for a task.", follow: "Follows the path.", track: "Follows the path.", speed: "You drive.",
  regulate: "Drives to the goal.", clear: "Clears its faults.",
};

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

  sentence(row) {
    const failed = this.codes.get(this.one(row, "failed"));
    if (failed) return `Stopped: ${failed.name}.`;
    const mode = bare(this.contract.modes[this.one(row, "mode")]), phase = bare((this.contract.phases || [])[this.one(row, "phase")]);
    if (mode === "regulate") return SENTENCES[this.one(row, "done") ? "done" : phase] || SENTENCES[mode];
    if (this.one(row, "done")) return "Task done. Rests.";
    return SENTENCES[mode] || `Mode ${this.contract.modes[this.one(row, "mode")]}.`;
  }

  // Codes that hold, without repetition: first the failure, then reasons of the nodes, then notices.
  codesOf(row) {
    const numbers = [this.one(row, "failed"), ...this.layout.of(row, "reasons")];
    this.layout.of(row, "notices").forEach((holds, n) => { if (holds) numbers.push(this.contract.codes[n].code); });
    return [...new Set(numbers)].map((number) => this.codes.get(number)).filter(Boolean);
  }

  show(row) {
    const sentence = this.sentence(row), codes = this.codesOf(row), key = sentence + codes.map((code) => code.code).join(",");
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
