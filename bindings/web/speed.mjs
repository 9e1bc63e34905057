// Work whose processor time is compared with that of the example `native`; see tools/scripts/web_speed.py.
//
//   node speed.mjs MODULE.wasm loop|plant N
import { readFileSync } from "node:fs";

const [path, what, count] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(readFileSync(path));
const { text, outcome, drive_plant } = instance.exports;
text(0);
if (what === "loop") {
  for (let trial = 0; trial < Number(count); trial++) outcome(1n, BigInt(trial));
} else {
  drive_plant(Number(count));
}
