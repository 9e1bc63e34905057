// Driving by hand: keys (arrows on the scene, W A S D anywhere) and a pad for fingers.

// Share of the limits of speed and curvature that keys command.
const KEY_SHARE = 0.8;
const DRIVE_KEYS = { w: "ahead", s: "back", a: "left", d: "right", ArrowUp: "ahead", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right" };

class Drive {
  // `order(speed, curvature)` drives; `order(null)` stops.
  constructor(limits, order) {
    this.limits = limits;
    this.order = order;
    this.down = new Set();
    document.addEventListener("keydown", (event) => this.key(event, true));
    document.addEventListener("keyup", (event) => this.key(event, false));
    window.addEventListener("blur", () => this.release());
    this.pad(find("pad"));
  }

  key(event, down) {
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key, direction = DRIVE_KEYS[name];
    if (!direction || event.ctrlKey || event.altKey || event.metaKey) return;
    const target = event.target, arrow = name.startsWith("Arrow");
    if (down && (target.closest("input, select, textarea, .handle") || arrow && target.id !== "scene")) return;
    if (down) event.preventDefault();
    if (down === this.down.has(direction)) return;
    if (down) this.down.add(direction); else this.down.delete(direction);
    this.send();
  }

  send() {
    if (!this.down.size) return this.order(null);
    const side = (a, b) => (this.down.has(a) ? 1 : 0) - (this.down.has(b) ? 1 : 0);
    this.order(KEY_SHARE * this.limits.speed * side("ahead", "back"), KEY_SHARE * this.limits.curvature * side("left", "right"));
  }

  release() {
    if (!this.down.size) return;
    this.down.clear();
    this.order(null);
  }

  pad(pad) {
    const knob = pad.firstElementChild;
    let held = null;
    const show = (x, y) => { knob.style.transform = `translate(${x}px, ${y}px)`; };
    const move = (event) => {
      if (held !== event.pointerId) return;
      const box = pad.getBoundingClientRect(), radius = box.width / 2;
      let x = event.clientX - box.left - radius, y = event.clientY - box.top - radius;
      const far = Math.hypot(x, y) / (radius - 14);
      if (far > 1) { x /= far; y /= far; }
      show(x, y);
      this.order(-this.limits.speed * y / (radius - 14), -KEY_SHARE * this.limits.curvature * x / (radius - 14));
    };
    const end = (event) => {
      if (held !== event.pointerId) return;
      held = null;
      show(0, 0);
      this.order(null);
    };
    pad.addEventListener("pointerdown", (event) => { event.preventDefault(); held = event.pointerId; pad.setPointerCapture(held); move(event); });
    pad.addEventListener("pointermove", move);
    pad.addEventListener("pointerup", end);
    pad.addEventListener("pointercancel", end);
  }
}
