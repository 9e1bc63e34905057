// Goal and robot by keys: a button above the scene that arrow keys move.

// Distance and angle of a key press; a fifth with Shift.
const NUDGE_M = 0.05, NUDGE_RAD = Math.PI / 36;
const NUDGES = {
  ArrowLeft: [-NUDGE_M, 0, 0], ArrowRight: [NUDGE_M, 0, 0], ArrowUp: [0, NUDGE_M, 0], ArrowDown: [0, -NUDGE_M, 0],
  q: [0, 0, NUDGE_RAD], e: [0, 0, -NUDGE_RAD],
};

class Handle {
  // `real` gives the posture of the goal or robot; `order` sets the posture.
  constructor(button, kind, hands, real, order) {
    Object.assign(this, { kind, hands, stage: hands.stage, real, order });
    button.addEventListener("keydown", (event) => this.key(event));
    // Leaving the handle confirms the moved posture.
    button.addEventListener("blur", () => this.finish());
  }

  ghost() {
    const { ghost } = this.stage;
    return ghost && ghost.kind === this.kind && !this.hands.held ? ghost : null;
  }

  show(at) {
    this.stage.ghost = at && { kind: this.kind, at };
    this.hands.orders.dirty();
  }

  key(event) {
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key, ghost = this.ghost(), real = this.real();
    const at = ghost ? ghost.at : real && Array.from(real);
    if (!at || this.hands.held) return;
    if (NUDGES[name]) this.nudge(at, NUDGES[name], event.shiftKey ? 0.2 : 1);
    else if (name === "Enter" || name === " ") this.press(at);
    else if (name === "Escape") this.show(null);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  nudge(at, by, share) {
    const moved = at.map((value, k) => value + share * by[k]);
    this.show(moved);
    this.hands.orders.announce(this.kind, moved);
  }

  // Pressed without a move, the goal is ordered again.
  press(at) {
    if (this.ghost()) this.finish();
    else if (this.kind === "goal") this.order(at);
  }

  finish() {
    const ghost = this.ghost();
    if (!ghost) return;
    this.show(null);
    this.order(ghost.at);
  }
}
