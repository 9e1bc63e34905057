// Helpers for all parts of the page.

const find = (id) => document.getElementById(id);

// Errors of the page, for tests and for the visitor.
const errors = [];

function report(text) {
  errors.push(text);
  note("The page has an error: " + text, true);
}

window.addEventListener("error", (event) => report(event.message));
window.addEventListener("unhandledrejection", (event) => report(String(event.reason && event.reason.message || event.reason)));

// Message below the scene. Screen readers read it.
function note(text, bad = false) {
  find("note").textContent = text;
  find("note").classList.toggle("bad", bad);
}

const reducedMotion = window.matchMedia("(prefers-reduced-motion: reduce)");
const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
const degrees = (angle) => angle * 180 / Math.PI;
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const posture = ([x, y, phi]) => `x ${label(x, 0.01)} m, y ${label(y, 0.01)} m, heading ${label(degrees(wrap(phi)), 1)}°`;
