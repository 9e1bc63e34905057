// States of the run. Above MOST_ROWS every second state is dropped.

const MOST_ROWS = 20000;

class History {
  constructor(layout) {
    this.layout = layout;
    // State of the latest epoch.
    this.latest = null;
    this.clear();
  }

  clear() {
    this.rows = new Float64Array(1024 * this.layout.width);
    this.length = 0;
    this.stride = 1;
    this.seen = 0;
  }

  add(all, count) {
    const { width } = this.layout;
    for (let i = 0; i < count; i++) {
      this.latest = all.subarray(i * width, (i + 1) * width);
      if (this.seen % this.stride === 0) this.keep(this.latest);
      this.seen += 1;
    }
  }

  keep(row) {
    const { width } = this.layout;
    if (this.length === MOST_ROWS) this.thin();
    if ((this.length + 1) * width > this.rows.length) {
      const larger = new Float64Array(Math.min(2 * this.rows.length, MOST_ROWS * width));
      larger.set(this.rows);
      this.rows = larger;
    }
    this.rows.set(row, this.length * width);
    this.length += 1;
  }

  thin() {
    const { width } = this.layout;
    for (let i = 0; 2 * i < this.length; i++) this.rows.copyWithin(i * width, 2 * i * width, (2 * i + 1) * width);
    this.length = Math.ceil(this.length / 2);
    this.stride *= 2;
  }

  row(i) {
    return this.rows.subarray(i * this.layout.width, (i + 1) * this.layout.width);
  }

  time(i) {
    return this.rows[i * this.layout.width + this.layout.place("time_s")];
  }

  // Index of the first row at or after a time.
  index(time) {
    let low = 0, high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1; else high = middle;
    }
    return low;
  }
}
