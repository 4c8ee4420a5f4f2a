// True motion between two samples: cubic Hermite pieces, split where the sphere strikes a wall.

/**
 * Cubic Hermite interpolation.
 * @param {number} t0 @param {number} x0 @param {number} v0 begin: time, position, velocity
 * @param {number} t1 @param {number} x1 @param {number} v1 end
 * @param {number} t time within
 * @returns {number} position
 */
export function hermite(t0, x0, v0, t1, x1, v1, t) {
  const h = t1 - t0;
  if (h <= 0) return x1;
  const s = (t - t0) / h;
  const a = 1 - s;
  return a * a * (1 + 2 * s) * x0 + s * s * (3 - 2 * s) * x1 + h * s * a * (a * v0 - s * v1);
}

export const LONGEST_WINDOW_S = 11; // of the scope, with a margin

/** The last seconds of motion: states and impacts in time order. */
export class Motion {
  /** @param {number} [kept] seconds to keep */
  constructor(kept = 6) {
    this.kept = kept;
    this.clear();
  }

  /** Erase everything. */
  clear() {
    /** @type {Float64Array[]} time, x_b, x_1, x_2, v_b, v_1, v_2 */
    this.states = [];
    /** @type {Float64Array[]} time, wall, approach, separation, force */
    this.impacts = [];
  }

  /** @returns {number} time of the newest state, -Infinity without one */
  get newest() { return this.states.length ? this.states[this.states.length - 1][0] : -Infinity; }

  /** @returns {number} time of the oldest state */
  get oldest() { return this.states.length ? this.states[0][0] : Infinity; }

  /**
   * Add rows of states or impacts.
   * @param {"states" | "impacts"} what @param {{rows: number, columns: number, values: Float64Array}} table
   */
  add(what, table) {
    for (let row = 0; row < table.rows; row++) {
      const one = table.values.slice(row * table.columns, (row + 1) * table.columns);
      if (what === "states" && one[0] <= this.newest) {
        if (one[0] < this.oldest - 1) this.clear();
        continue;
      }
      this[what].push(one);
    }
    const limit = this.newest - (what === "impacts" ? LONGEST_WINDOW_S : this.kept); // the scope marks them in any window
    while (this[what].length > 1 && this[what][0][0] < limit) this[what].shift();
  }

  /**
   * Return the state at a time.
   * @param {number} t time [s] @param {number} gap total gap [m]
   * @returns {{base: number, structure: number, sphere: number} | null} positions [m], null outside of the data
   */
  at(t, gap) {
    const states = this.states;
    if (states.length < 2 || t < states[0][0] || t > this.newest) return null;
    let low = 0, high = states.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (states[middle][0] <= t) low = middle; else high = middle;
    }
    const a = states[low], b = states[high];
    const structure = (time) => hermite(a[0], a[2], a[5], b[0], b[2], b[5], time);
    return {
      base: hermite(a[0], a[1], a[4], b[0], b[1], b[4], t), structure: structure(t),
      sphere: this.sphere(a, b, t, gap, structure),
    };
  }

  /** @private */
  sphere(a, b, t, gap, structure) {
    let from = [a[0], a[3], a[6]];
    for (const [time, wall, approach, separation] of this.impacts) {
      if (time <= a[0] || time >= b[0]) continue;
      const x = structure(time) + wall * gap / 2;
      const h = Math.min(time - a[0], b[0] - time, 1e-4);
      const v = h > 0 ? (structure(time + h) - structure(time - h)) / (2 * h) : a[5];
      if (t < time) return hermite(from[0], from[1], from[2], time, x, v + wall * approach, t);
      from = [time, x, v - wall * separation];
    }
    return hermite(from[0], from[1], from[2], b[0], b[3], b[6], t);
  }

  /**
   * Return the newest impact on a wall shortly before a time.
   * @param {number} t time [s] @param {number} wall -1 or 1 @param {number} memory longest age of an impact [s]
   * @returns {{force: number, age: number} | null} peak force [N] and age [s], null without an impact
   */
  flash(t, wall, memory) {
    let found = null;
    for (const [time, side, , , force] of this.impacts) {
      if (side === wall && time <= t && t - time < memory && (!found || time > t - found.age)) found = { force, age: t - time };
    }
    return found;
  }
}

/** A clock that advances at a steady pace, a little behind the newest data. */
export class Clock {
  /** @param {number} delay time behind the newest data at real-time speed [s] */
  constructor(delay) {
    this.delay = delay;
    this.time = NaN;
  }

  /**
   * Advance the clock.
   * @param {number} dt wall time since the last call [s] @param {number} newest newest data [s]
   * @param {number} speed rig seconds per second
   * @returns {number} the time to draw [s]
   */
  advance(dt, newest, speed) {
    const lag = this.delay * Math.max(1, speed);
    const target = newest - lag;
    const error = target - this.time;
    if (!Number.isFinite(error) || Math.abs(error) > 4 * lag + 0.2) this.time = target;
    else this.time += dt * speed + Math.min(1, 2 * dt) * error * 0.5;
    this.time = Math.min(this.time, newest);
    return this.time;
  }
}
