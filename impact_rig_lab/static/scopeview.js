// Four traces above one time axis; every column of the picture is a minimum and a maximum.
// The length of the axis is chosen in index.html (`span`); scope.py limits it.

import { engineering, limits, line } from "./format.js";
import { axis, clipped, colour, stacked } from "./paper.js";

/* global uPlot */
const CHANNELS = [["accelerometer", "m/s²"], ["laser", "m"], ["base", "m"], ["current", "A"]];
const CURRENT = 3, COMMANDED = 4; // the row after the channels, for a rig driven by a stream of samples

export class ScopeView {
  /** @param {HTMLElement} place @param {HTMLElement} readout */
  constructor(place, readout) {
    this.place = place;
    this.readout = readout;
    this.drawn = 0;
    this.ranges = [null, null, null, null];
    /** @type {import("./frames.js").Trace | null} */
    this.trace = null;
    this.other = null;
    /** @type {number | null} the fixed cursor: a column of the window */
    this.mark = null;
    /** @type {number[][]} truth, detected: times [s] */
    this.impacts = [[], []];
    this.make();
    new ResizeObserver(() => this.fit()).observe(place);
  }

  /** Create the plots in the colours of the theme. */
  make() {
    this.place.replaceChildren();
    this.ranges = [null, null, null, null];
    this.plots = CHANNELS.map(([name, unit], number) => {
      const box = this.place.appendChild(document.createElement("div"));
      const made = new uPlot({
        width: Math.max(50, box.clientWidth), height: Math.max(40, box.clientHeight), pxAlign: false, legend: { show: false },
        padding: [6, 22, 0, 0],
        cursor: { sync: { key: "scope" }, drag: { x: false, y: false }, points: { show: false } },
        scales: { x: { time: false, range: () => [0, this.span()] }, y: { range: () => this.ranges[number] ?? [-1, 1] } },
        axes: [
          { ...axis(), size: number === 3 ? 22 : 4, values: (_, all) => all.map((v) => (number === 3 ? engineering(v, "s") : "")) },
          { ...axis(), size: 66, values: (_, all) => all.map((v) => engineering(v, unit)), space: 26 },
        ],
        series: [
          {}, { stroke: colour("trace"), width: 1, points: { show: false }, label: name },
          { stroke: colour("trace-b"), width: 1, points: { show: false }, label: `${name} B` },
          ...(number === CURRENT ? [{ stroke: colour("drive"), width: 1, points: { show: false }, label: "commanded" }] : []),
        ],
        hooks: {
          draw: [(plot) => this.marks(plot, number)],
          setCursor: [(plot) => { if (number === 0) this.read(plot); }],
        },
      }, [[0, 1], ...Array(number === CURRENT ? 3 : 2).fill([null, null])], box);
      made.over.addEventListener("click", () => this.hold(made.cursor.idx));
      made.over.addEventListener("dblclick", () => this.hold(null));
      return made;
    });
  }

  /** @private fix the cursor at the present position, or remove it */
  hold(index) {
    this.mark = index === null || index === undefined ? null : index >> 1;
    for (const plot of this.plots) plot.redraw(false);
  }

  span() { return this.trace ? this.trace.column * this.trace.low[0].length : 1; }

  /** Fit the plots to their element. */
  fit() {
    for (const plot of this.plots) {
      const box = plot.root.parentElement;
      if (box.clientWidth > 20) plot.setSize({ width: box.clientWidth, height: Math.max(40, box.clientHeight) });
    }
  }

  /**
   * Draw a window.
   * @param {import("./frames.js").Trace} trace @param {import("./frames.js").Trace | null} other of a second run
   */
  draw(trace, other) {
    this.trace = trace;
    this.other = other;
    this.drawn++;
    for (let number = 0; number < 4; number++) {
      let low = Infinity, high = -Infinity;
      for (const one of other ? [trace, other] : [trace]) {
        for (const v of one.low[number]) if (v < low) low = v;
        for (const v of one.high[number]) if (v > high) high = v;
      }
      this.ranges[number] = limits(this.ranges[number], low, high);
      const [x, y] = line(trace.low[number], trace.high[number], trace.column);
      const none = new Array(x.length).fill(null), commanded = trace.low[COMMANDED];
      const rows = [x, y, other ? fitted(line(other.low[number], other.high[number], other.column), x) : none];
      if (number === CURRENT) rows.push(commanded ? line(commanded, trace.high[COMMANDED], trace.column)[1] : none);
      this.plots[number].setData(rows);
    }
  }

  /** @returns {HTMLCanvasElement} the traces as one picture */
  picture() { return stacked(this.plots.map((plot) => plot.ctx.canvas)); }

  /** @private */
  marks(plot, number) {
    if (!this.trace) return;
    const g = clipped(plot), { left, top, width, height } = plot.bbox;
    const ratio = devicePixelRatio || 1;
    const at = (time) => left + (time - this.trace.begin) / this.span() * width;
    g.fillStyle = colour("hot"); // over range: a bar at the lower edge, and a word
    let over = false;
    this.trace.status.forEach((bits, i) => {
      if (!(bits >> number & 1)) return;
      over = true;
      g.fillRect(left + i / this.trace.status.length * width, top + height - 4 * ratio, Math.max(ratio, width / this.trace.status.length), 4 * ratio);
    });
    g.font = `${11 * ratio}px system-ui`;
    g.textAlign = "left";
    if (over) g.fillText("over range", left + 6 * ratio, top + height - 8 * ratio);
    g.fillStyle = colour("soft");
    g.fillText(CHANNELS[number][0], left + 6 * ratio, top + 12 * ratio);
    if (number === CURRENT && this.trace.low[COMMANDED]) {
      const at = left + 12 * ratio + g.measureText(CHANNELS[number][0]).width;
      g.fillStyle = colour("drive");
      g.fillText("commanded", at, top + 12 * ratio);
      g.fillStyle = colour("soft");
    }
    if (this.mark !== null) g.fillRect(left + (this.mark + 0.5) / this.trace.low[0].length * width, top, ratio, height);
    if (number === 0) {
      g.fillStyle = colour("sphere");
      for (const time of this.impacts[0]) triangle(g, at(time), top, 5 * ratio);
      g.fillStyle = colour("drive");
      for (const time of this.impacts[1]) g.fillRect(at(time) - 2 * ratio, top + height - 5 * ratio, 4 * ratio, 5 * ratio);
    }
    g.restore();
  }

  /** @private the values under the cursor */
  read(plot) {
    const i = plot.cursor.idx;
    if (i === null || i === undefined || !this.trace) { this.readout.textContent = ""; return; }
    const column = i >> 1, mark = this.mark;
    const shown = this.trace.low[COMMANDED] ? [...CHANNELS, ["commanded", "A"]] : CHANNELS;
    const parts = shown.map(([name, unit], number) => {
      const value = this.value(number, column) - (mark === null ? 0 : this.value(number, mark));
      return `${name} ${engineering(value, unit)}`;
    });
    const time = mark === null ? (column + 0.5) * this.trace.column : Math.abs(column - mark) * this.trace.column;
    const rate = mark === null || mark === column ? "" : ` (${engineering(1 / time, "Hz")})`;
    this.readout.textContent = `${mark === null ? "" : "Δ "}${engineering(time, "s")}${rate}: ${parts.join(" · ")}`;
  }

  /** @private the extreme of a column that is further from zero */
  value(number, column) {
    const low = this.trace.low[number][column] ?? NaN, high = this.trace.high[number][column] ?? NaN;
    return Math.abs(high) >= Math.abs(low) ? high : low;
  }
}

/** Return the ordinates of a line at other abscissas: runs of another rate have columns of another length. */
function fitted([from, values], x) {
  if (from.length === x.length && from[1] === x[1]) return values;
  const step = from[1] - from[0];
  return x.map((at) => values[Math.round((at - from[0]) / step)] ?? null);
}

function triangle(g, x, y, size) {
  g.beginPath();
  g.moveTo(x - size * 0.7, y);
  g.lineTo(x + size * 0.7, y);
  g.lineTo(x, y + size * 1.3);
  g.fill();
}
