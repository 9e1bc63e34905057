// Parts and state of the page.

const page = {
  ready: false, running: false, generation: 0, robot: null, contract: null, layout: null, history: null, stage: null, plots: null,
  words: null, hands: null, trials: null, task: null, drawUntil: 0, drift: 0, faults: new Set(), busy: [], inbox: 0,
  pace: 1, rate: 0, mark: null, frames: 0,
};

const dirty = () => { page.drawUntil = performance.now() + 700; };
const state = (name) => page.layout.of(page.history.latest, name);

// Carries out a call; a refusal is shown with its reason.
async function ask(action, details) {
  const answer = await page.robot.call(action, details);
  if (!answer.ok) note(answer.message || "Refused.", true);
  dirty();
  return answer;
}
