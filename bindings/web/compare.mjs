// Compares every epoch of each case of cases.json between this machine and WebAssembly.
//
//   node compare.mjs MODULE.wasm NATIVE
//
// NATIVE is the output of the example `native`. Exit code 1 with the first epoch that differs.
import { readFileSync } from "node:fs";

const [path, native] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(readFileSync(path));
const { memory, text, trial, drive, hashes, message } = instance.exports;
const cases = JSON.parse(readFileSync(new URL("cases.json", import.meta.url), "utf8"));

function put(string) {
  const bytes = new TextEncoder().encode(string);
  const at = text(bytes.length);
  new Uint8Array(memory.buffer, at, bytes.length).set(bytes);
  return bytes.length;
}

function run(of, number) {
  const scenario = new TextEncoder().encode(of.scenario).length;
  put(of.scenario + (of.script ?? ""));
  const epochs = of.script === undefined ? trial(1n, BigInt(number)) : drive(scenario, 1n);
  if (epochs === 0) {
    const length = message();
    const at = text(length);
    throw new Error(`${of.name}: ${new TextDecoder().decode(new Uint8Array(memory.buffer, at, length))}`);
  }
  return [...new BigUint64Array(memory.buffer, hashes(), epochs)].map((hash) => hash.toString(16).padStart(16, "0"));
}

const lines = readFileSync(native, "utf8").trim().split("\n");
let [runs, epochs] = [0, 0];
for (const of of cases) {
  for (let number = 0; number < (of.trials ?? 1); number++) {
    const name = `${of.name}, trial ${number}`;
    const line = lines[runs] ?? "";
    const wanted = line.slice(name.length + 2).split(" ");
    const found = run(of, number);
    const length = Math.max(wanted.length, found.length);
    const at = Array.from({ length }, (_, k) => k).find((k) => wanted[k] !== found[k]);
    if (!line.startsWith(`${name}: `) || at !== undefined) {
      console.error(`compare: ${name}: epoch ${at} of ${wanted.length} differs: native ${wanted[at]}, WebAssembly ${found[at]}`);
      process.exit(1);
    }
    runs += 1;
    epochs += found.length;
  }
}
if (runs !== lines.length) {
  console.error(`compare: ${lines.length} native runs, ${runs} in WebAssembly`);
  process.exit(1);
}
console.log(`${runs} runs, ${epochs} epochs: equal in every bit between this machine and WebAssembly`);
