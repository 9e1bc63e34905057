// The page's side of the Workers, and the layout of a state.

// Script of the Workers: a Blob, so that nothing is loaded.
const workerAddress = URL.createObjectURL(new Blob([find("worker").textContent], { type: "text/javascript" }));

// A Worker that answers calls. `events` maps the names of its other messages to functions.
class Simulation {
  constructor(events) {
    this.waiting = new Map();
    this.number = 0;
    this.worker = new Worker(workerAddress);
    this.worker.onerror = (event) => report("Worker: " + event.message);
    this.worker.onmessage = ({ data }) => {
      if (data.event !== "answer") return events[data.event] && events[data.event](data);
      this.waiting.get(data.id)(data.answer);
      this.waiting.delete(data.id);
    };
  }

  call(action, details = {}) {
    this.number += 1;
    const id = this.number;
    this.worker.postMessage({ action, id, ...details });
    return new Promise((resolve) => this.waiting.set(id, resolve));
  }

  end() {
    this.worker.terminate();
  }
}

// Bytes of a text with 13 bits in two of 91 characters: # to ~ without <, see `packed` in bindings/web/build.
function bytesOf(text) {
  const bytes = new Uint8Array(Math.floor(text.length / 2 * 13 / 8));
  const digit = (i) => { const code = text.charCodeAt(i); return code - (code > 60 ? 36 : 35); };
  let bits = 0, count = 0, at = 0;
  for (let i = 0; i < text.length; i += 2) {
    bits |= (digit(i) + 91 * digit(i + 1)) << count;
    for (count += 13; count >= 8; count -= 8) { bytes[at] = bits & 255; at += 1; bits >>>= 8; }
  }
  return bytes;
}

async function unpack() {
  const [size, text] = find("program").textContent.trim().split(" ");
  const stream = new Blob([bytesOf(text).subarray(0, Number(size))]).stream().pipeThrough(new DecompressionStream("gzip"));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}

// Places of the values of a state, by the list of names and counts that the program gives.
class Layout {
  constructor(state) {
    this.places = new Map();
    this.width = 0;
    for (const [name, count] of state) {
      this.places.set(name, [this.width, this.width + count]);
      this.width += count;
    }
  }

  place(name) {
    return this.places.get(name)[0];
  }

  of(row, name) {
    const [begin, end] = this.places.get(name);
    return row.subarray(begin, end);
  }

  // Names of all columns of a log.
  columns() {
    const columns = [];
    this.places.forEach(([begin, end], name) => {
      for (let i = begin; i < end; i++) columns.push(end - begin > 1 ? `${name}_${i - begin}` : name);
    });
    return columns;
  }
}
