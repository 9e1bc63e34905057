// A tour in six steps: a sentence and an action each. `act` gets the orders of the tour.
const TOUR = [
  {
    text: "A thin steel strip joins two axles; if the axles turn against each other, the strip bends into an arc, and the robot drives along this arc.",
    action: "Drive a curve", act: (orders) => orders.curve(),
  },
  {
    text: "The bent strip pulls at the tyres and they creep; the wheels do not turn by it, so without gauges the estimate (dashed) drifts away from the robot.",
    action: "Drive without gauges", act: (orders) => orders.experiment({ gauges: false }),
  },
  {
    text: "Five strain gauges measure how far the strip is bent, so the robot knows the angle between its axles, and the drift becomes small.",
    action: "Drive with gauges", act: (orders) => orders.experiment({}),
  },
  {
    text: "If a gauge breaks, the robot notices it and computes the bend from the gauges that are left.",
    action: "Break a gauge", act: (orders) => orders.breakGauge(),
  },
  {
    text: "On a slippery floor the wheels slip and the strip contradicts them: the robot notices this, stops, and shows its code and advice.",
    action: "Make the floor slippery", act: (orders) => orders.slip(),
  },
  {
    text: "The paper's experiment drives many robots, each a little different, from one start to one goal, first without and then with gauges: compare the two clouds.",
    action: "Drive 100 robots twice", act: (orders) => orders.paper(),
  },
];

class Tour {
  constructor(orders) {
    this.orders = orders;
    this.step = 0;
    find("tour-open").addEventListener("click", () => this.open());
    find("tour-close").addEventListener("click", () => this.close());
    find("tour-back").addEventListener("click", () => this.go(this.step - 1));
    find("tour-next").addEventListener("click", () => (this.step + 1 < TOUR.length ? this.go(this.step + 1) : this.close()));
    find("tour-act").addEventListener("click", () => TOUR[this.step].act(this.orders));
    find("tour").addEventListener("keydown", (event) => { if (event.key === "Escape") this.close(); });
  }

  open() {
    find("tour").hidden = false;
    this.go(this.step);
  }

  close() {
    find("tour").hidden = true;
    this.step = 0;
    find("tour-open").focus();
  }

  // The focus goes to the action: Enter starts it, Tab reaches the next step.
  go(step) {
    this.step = Math.max(0, Math.min(TOUR.length - 1, step));
    const { text, action } = TOUR[this.step];
    find("tour-title").textContent = `Tour, step ${this.step + 1} of ${TOUR.length}`;
    find("tour-text").textContent = text;
    find("tour-act").textContent = action;
    find("tour-back").disabled = this.step === 0;
    find("tour-next").textContent = this.step + 1 < TOUR.length ? "Next" : "End";
    find("tour-act").focus({ preventScroll: true });
    find("tour").scrollIntoView({ block: "nearest" });
  }
}
