// Trials in Workers: a cloud of end points, and a table.

const TRIALS = 100, MOST_WORKERS = 8, CLOUDS = 4;

class Trials {
  constructor(module, contract, stage, dirty) {
    Object.assign(this, { module, contract, stage, dirty });
    this.workers = [];
    this.batch = 0;
  }

  // Workers are made for a batch and end with it.
  async run(count, name, of) {
    this.stop();
    const batch = this.batch, total = { name, ends: [], count, text: scenario(of), seed: settings.seed, goal: of.goal || this.contract.mission.goal };
    total.cloud = { points: [], look: `--c${[0, 1, 2, 4][find("trials").rows.length % 4]}` };
    this.stage.clouds = this.stage.clouds.slice(1 - CLOUDS).concat([total.cloud]);
    total.row = this.newRow(total);
    let next = 0;
    const work = async () => {
      const worker = new Simulation({});
      this.workers.push(worker);
      await worker.call("load", { module: this.module });
      while (next < count && batch === this.batch) {
        const trial = String(next);
        next += 1;
        this.take(total, await worker.call("outcome", { scenario: total.text, seed: total.seed, trial }));
      }
    };
    const workers = Math.max(1, Math.min(navigator.hardwareConcurrency || 2, MOST_WORKERS));
    await Promise.all(Array.from({ length: workers }, work));
    if (batch === this.batch) { this.stop(); this.announce(total); }
  }

  stop() {
    this.batch += 1;
    this.workers.forEach((worker) => worker.end());
    this.workers = [];
  }

  take(total, answer) {
    if (!answer.ok) return note("A trial was refused: " + answer.message, true);
    const [end, x, y, phi, , , , e, claim, duration] = answer.outcome;
    const off = Math.abs(wrap(phi - total.goal[2])), [position, heading] = this.contract.mission.tolerance;
    total.ends.push({ end, e, off, claim, duration, within: e <= position && off <= heading });
    if (Number.isFinite(x)) total.cloud.points.push([x, y]);
    this.showRow(total);
    this.dirty();
  }

  newRow(total) {
    const row = find("trials").insertRow();
    for (let n = 0; n < 5; n++) row.insertCell();
    element("span", "● ", row.cells[0]).style.color = `var(${total.cloud.look})`;
    row.cells[0].append(total.name);
    find("trials-table").hidden = false;
    return row;
  }

  summary({ ends }) {
    const mean = (value) => ends.reduce((sum, end) => sum + value(end), 0) / ends.length;
    return { error: mean((end) => end.e), off: mean((end) => end.off), within: mean((end) => (end.within ? 1 : 0)) };
  }

  showRow(total) {
    const { error, off, within } = this.summary(total), texts = [null, String(total.ends.length), label(100 * error, 0.1) + " cm", label(degrees(off), 0.1) + "°", Math.round(100 * within) + " %"];
    texts.forEach((text, n) => { if (text) total.row.cells[n].textContent = text; });
  }

  announce(total) {
    if (!total.ends.length) return;
    const { error, within } = this.summary(total);
    note(`${total.ends.length} trials, ${total.name}: mean goal error ${label(100 * error, 0.1)} cm, ${Math.round(100 * within)} % within the tolerance.`);
  }

  clear() {
    this.stop();
    this.stage.clouds = [];
    find("trials").replaceChildren();
    find("trials-table").hidden = true;
    this.dirty();
  }
}
