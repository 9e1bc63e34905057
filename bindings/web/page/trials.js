// Trials in Workers: a cloud of end points, and a table.

const TRIALS = 100, MOST_WORKERS = 8;
// Colours of clouds, and most clouds on the scene.
const CLOUD_LOOKS = ["--c0", "--c1", "--c2", "--c4"], CLOUDS = CLOUD_LOOKS.length;

class Trials {
  constructor(module, contract, stage, dirty) {
    Object.assign(this, { module, contract, stage, dirty });
    this.workers = [];
    // Batch in work; a Worker whose batch is another one takes no more trials.
    this.batch = null;
  }

  // Workers are made for a batch and end with it.
  async run(count, name, of) {
    this.stop();
    const batch = { name, ends: [], text: scenario(of), seed: of.seed, goal: of.goal || this.contract.mission.goal };
    this.batch = batch;
    batch.cloud = { points: [], look: CLOUD_LOOKS[find("trials").rows.length % CLOUD_LOOKS.length] };
    this.stage.clouds = this.stage.clouds.slice(1 - CLOUDS).concat([batch.cloud]);
    batch.row = this.newRow(batch);
    let next = 0;
    const work = async () => {
      const worker = new Simulation({});
      this.workers.push(worker);
      await worker.call("load", { module: this.module });
      while (next < count && this.batch === batch) {
        const trial = String(next);
        next += 1;
        this.take(batch, await worker.call("outcome", { scenario: batch.text, seed: batch.seed, trial }));
      }
    };
    const workers = Math.max(1, Math.min(navigator.hardwareConcurrency || 2, MOST_WORKERS));
    await Promise.all(Array.from({ length: workers }, work));
    if (this.batch === batch) { this.stop(); this.announce(batch); }
  }

  stop() {
    this.batch = null;
    this.workers.forEach((worker) => worker.end());
    this.workers = [];
  }

  take(batch, answer) {
    if (!answer.ok) return note("A trial was refused: " + answer.message, true);
    const [, x, y, phi, , , , e] = answer.outcome;
    const off = Math.abs(wrap(phi - batch.goal[2])), [position, heading] = this.contract.mission.tolerance;
    batch.ends.push({ e, off, within: e <= position && off <= heading });
    if (Number.isFinite(x)) batch.cloud.points.push([x, y]);
    this.showRow(batch);
    this.dirty();
  }

  newRow(batch) {
    const row = find("trials").insertRow();
    for (let n = 0; n < 5; n++) row.insertCell();
    element("span", "● ", row.cells[0]).style.color = `var(${batch.cloud.look})`;
    row.cells[0].append(batch.name);
    find("trials-table").hidden = false;
    return row;
  }

  summary({ ends }) {
    const mean = (value) => ends.reduce((sum, end) => sum + value(end), 0) / ends.length;
    return { error: mean((end) => end.e), off: mean((end) => end.off), within: mean((end) => (end.within ? 1 : 0)) };
  }

  showRow(batch) {
    const { error, off, within } = this.summary(batch);
    const texts = [String(batch.ends.length), label(100 * error, 0.1) + " cm", label(degrees(off), 0.1) + "°", Math.round(100 * within) + " %"];
    texts.forEach((text, n) => { batch.row.cells[n + 1].textContent = text; });
  }

  announce(batch) {
    if (!batch.ends.length) return;
    const { error, within } = this.summary(batch);
    note(`${batch.ends.length} trials, ${batch.name}: mean goal error ${label(100 * error, 0.1)} cm, ${Math.round(100 * within)} % within the tolerance.`);
  }

  clear() {
    this.stop();
    this.stage.clouds = [];
    find("trials").replaceChildren();
    find("trials-table").hidden = true;
    this.dirty();
  }
}
