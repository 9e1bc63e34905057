// Settings that the visitor has changed. Only these are written into the scenario and into the address.

const settings = { seed: "1" };

// Key of the scenario of each setting: table, key, and value as TOML.
const KEYS = {
  world: ["", "world", JSON.stringify],
  axles: ["robot.geometry", "axles", String],
  gauges: ["mission", "rps", String],
  imu: ["sensors.gyro", "fitted", String],
  fusion: ["robot.lead.fusion", "mode", JSON.stringify],
  friction: ["plant", "friction", String],
  start: ["mission", "start", (at) => `[${at.map(real).join(", ")}]`],
  goal: ["mission", "goal", (at) => `[${at.map(real).join(", ")}]`],
};

const axleCount = () => settings.axles || 2;
const goal = () => settings.goal || page.contract.mission.goal;

// A TOML float needs a decimal point.
const real = (value) => (Math.round(value * 1e4) / 1e4).toFixed(4);

function scenario(of = settings) {
  const tables = new Map([["", []]]);
  const put = (table, line) => tables.set(table, (tables.get(table) || []).concat(line));
  for (const [name, [table, key, text]] of Object.entries(KEYS)) {
    if (of[name] === undefined) continue;
    put(table, `${key} = ${text(of[name])}`);
    if (name === "imu") put("sensors.accelerometer", `${key} = ${text(of[name])}`);
  }
  return [...tables].map(([table, lines]) => (table ? [`[${table}]`, ...lines] : lines).join("\n")).join("\n");
}

// The address keeps seed and scenario: `#seed=3&gauges=false&goal=1,0,0.5`.
function writeAddress() {
  const parts = ["seed", ...Object.keys(KEYS)].map((name) => [name, settings[name]]).filter(([, value]) => value !== undefined);
  const text = (value) => (Array.isArray(value) ? value.map((x) => Math.round(x * 1e4) / 1e4).join(",") : String(value));
  const hash = "#" + parts.map(([name, value]) => `${name}=${text(value)}`).join("&");
  if (hash !== window.location.hash) window.history.replaceState(null, "", hash);
}

// Reads the address, which a visitor may type; gives the entries that are unknown or out of range.
function readAddress(contract) {
  const given = new URLSearchParams(window.location.hash.slice(1)), found = { seed: "1" };
  const one = (name, list) => { if (list.includes(given.get(name))) found[name] = given.get(name); };
  const yes = (name) => { if (["true", "false"].includes(given.get(name))) found[name] = given.get(name) === "true"; };
  const posture = (name) => {
    const at = (given.get(name) || "").split(",").map(Number);
    if (given.get(name) && at.length === 3 && at.every((x) => Number.isFinite(x) && Math.abs(x) <= 50)) found[name] = at;
  };
  if (/^[0-9]{1,18}$/.test(given.get("seed") || "")) found.seed = given.get("seed");
  one("world", contract.worlds.map((world) => world.name));
  one("fusion", contract.fusions.map((fusion) => fusion.name));
  yes("gauges"); yes("imu");
  const axles = Number(given.get("axles"));
  if (given.has("axles") && Number.isInteger(axles) && axles >= 2 && axles <= contract.most_axles) found.axles = axles;
  const friction = Number(given.get("friction"));
  if (given.has("friction") && friction >= contract.limits.friction[0] && friction <= contract.limits.friction[1]) found.friction = friction;
  posture("start"); posture("goal");
  Object.keys(settings).forEach((name) => delete settings[name]);
  Object.assign(settings, found);
  const read = (name) => found[name] !== undefined && (name !== "seed" || found.seed === given.get("seed"));
  return [...given].filter(([name]) => !read(name)).map(([name, value]) => `${name}=${value}`);
}
