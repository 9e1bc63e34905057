// Hands on the scene: drag the goal, the robot or the floor, and draw a path.

// Radius of a grip, CSS pixels; larger for fingers.
const GRIP = { mouse: 16, touch: 26 };
// Distance between points of a drawn path, m.
const STROKE_M = 0.01;

class Hands {
  // `orders` has goal(at), place(at), path(points), announce(kind, at) and dirty().
  constructor(stage, orders, truth, axles) {
    this.stage = stage;
    this.orders = orders;
    this.truth = truth;
    // Postures of the axles, one after the other.
    this.axles = axles;
    this.drawing = false;
    this.held = null;
    this.pointers = new Map();
    const canvas = stage.canvas;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => { this.pointers.delete(event.pointerId); this.cancel(); });
    canvas.addEventListener("dblclick", (event) => this.goalHere(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") this.cancel(); });
    new Handle(find("goal-handle"), "goal", this, () => stage.goal, (at) => orders.goal(at));
    new Handle(find("robot-handle"), "robot", this, truth, (at) => orders.place(at));
  }

  pixel(event) {
    const box = this.stage.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  // Part of the scene below a pixel.
  under(pixel, type) {
    const { view, goal } = this.stage, grip = GRIP[type] || GRIP.touch, truth = this.truth();
    const near = (at, by) => apart([view.X(at[0]), view.Y(at[1])], pixel) < by;
    if (goal && near(this.stage.tip(view, goal), grip)) return { kind: "goal", turn: true, at: goal };
    if (goal && near(goal, grip)) return { kind: "goal", at: goal };
    if (near(this.stage.tip(view, truth), grip)) return { kind: "robot", turn: true, at: truth };
    if (near(truth, Math.max(grip, 0.2 * view.scale)) || this.onChain(near, 0.2 * view.scale)) return { kind: "robot", at: truth };
    return { kind: "floor" };
  }

  // True near an axle of a robot of more than two axles.
  onChain(near, by) {
    const axles = this.axles(), count = axles.length / 3;
    return count > 2 && Array.from({ length: count }, (_, n) => axles.subarray(3 * n, 3 * n + 2)).some((at) => near(at, by));
  }

  down(event) {
    if (!this.stage.view) return;
    event.preventDefault();
    this.stage.canvas.focus();
    this.stage.canvas.setPointerCapture(event.pointerId);
    const pixel = this.pixel(event), ground = this.stage.view.ground(...pixel);
    this.pointers.set(event.pointerId, pixel);
    this.stage.refusal = null;
    this.stage.stroke = [];
    if (this.pointers.size === 2) return this.cancel();
    if (this.pointers.size > 2) return;
    if (this.drawing) {
      this.held = { kind: "path" };
      this.stage.stroke = [ground];
      return;
    }
    const part = this.under(pixel, event.pointerType);
    this.held = { ...part, from: ground, start: part.at && Array.from(part.at) };
    if (part.at) this.stage.ghost = { kind: part.kind, at: Array.from(part.at) };
    this.orders.dirty();
  }

  move(event) {
    const { stage } = this, pixel = this.pixel(event);
    if (!stage.view) return;
    if (this.pointers.size === 2 && this.pointers.has(event.pointerId)) return this.pinch(event.pointerId, pixel);
    if (!this.held) {
      stage.canvas.style.cursor = this.drawing ? "crosshair" : this.under(pixel, event.pointerType).kind === "floor" ? "default" : "grab";
      return;
    }
    this.pointers.set(event.pointerId, pixel);
    const ground = stage.view.ground(...pixel);
    if (this.held.kind === "path") {
      if (apart(stage.stroke[stage.stroke.length - 1], ground) >= STROKE_M) stage.stroke.push(ground);
    } else if (this.held.kind === "floor") {
      stage.pan(ground[0] - this.held.from[0], ground[1] - this.held.from[1]);
      find("view").value = "free";
    } else {
      stage.ghost.at = this.moved(ground);
    }
    this.orders.dirty();
  }

  moved([x, y]) {
    const { start, from, turn } = this.held;
    if (turn) return [start[0], start[1], Math.atan2(y - start[1], x - start[0])];
    return [start[0] + x - from[0], start[1] + y - from[1], start[2]];
  }

  pinch(id, pixel) {
    const other = [...this.pointers].find(([key]) => key !== id)[1], before = this.pointers.get(id), { stage } = this;
    const middle = stage.view.ground((pixel[0] + other[0]) / 2, (pixel[1] + other[1]) / 2);
    if (apart(before, other) > 10) stage.zoom(apart(pixel, other) / apart(before, other), middle);
    this.pointers.set(id, pixel);
    find("view").value = "free";
    this.orders.dirty();
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    const { held, stage } = this;
    if (!held) return;
    this.held = null;
    const ghost = stage.ghost, stroke = stage.stroke;
    stage.ghost = null;
    const still = ghost && apart(ghost.at, held.start) < 1e-6 && ghost.at[2] === held.start[2];
    if (held.kind === "path") this.orders.path(stroke);
    else if (held.kind === "goal") this.orders.goal(ghost.at);
    else if (held.kind === "robot" && !still) this.orders.place(ghost.at);
    this.orders.dirty();
  }

  cancel() {
    this.held = null;
    this.stage.ghost = null;
    this.stage.stroke = [];
    this.orders.dirty();
  }

  goalHere(event) {
    if (this.drawing || !this.stage.view || this.under(this.pixel(event), "mouse").kind !== "floor") return;
    const [x, y] = this.stage.view.ground(...this.pixel(event));
    this.orders.goal([x, y, this.stage.goal ? this.stage.goal[2] : 0]);
  }

  // The wheel without Ctrl scrolls the page.
  wheel(event) {
    if (!event.ctrlKey || !this.stage.view) return;
    event.preventDefault();
    this.stage.zoom(Math.exp(-0.01 * event.deltaY), this.stage.view.ground(...this.pixel(event)));
    find("view").value = "free";
    this.orders.dirty();
  }
}
