// The transmissibility over frequency: points with error bars, other gaps in grey. Lines show the rig without sphere and
// the prediction with sphere, dashed where that motion is unstable.

import { axis, clipped, colour, stacked, stroke } from "./paper.js";

/* global uPlot */

/**
 * @typedef {{lines: [boolean, [number, number][]][], words: string}} Prediction whether each line is stable, frequency and DT
 * @typedef {{f: number, dt: number, u: number, gap: number | null, settled: boolean, t: number} & Record<string, any>} Row
 */

export class CurveView {
  /**
   * @param {HTMLElement} place
   * @param {(row: Row) => void} onPick a point was clicked @param {(row: Row) => void} onRemove with Shift
   */
  constructor(place, onPick, onRemove) {
    this.place = place;
    this.onRemove = onRemove;
    this.onPick = onPick;
    /** @type {Row[]} */ this.rows = [];
    /** @type {Row[]} */ this.others = [];
    /** @type {number[][]} */ this.closed = [];
    /** @type {Prediction["lines"]} */ this.predicted = [];
    this.gap = null;
    /** @type {Set<string>} removed points */
    this.removed = new Set();
    this.make();
    new ResizeObserver(() => this.plot.setSize({ width: place.clientWidth, height: Math.max(100, place.clientHeight) })).observe(place);
    place.addEventListener("click", (event) => this.pick(event));
  }

  /** Create the plot in the colours of the theme. */
  make() {
    this.place.replaceChildren();
    this.plot = new uPlot({
      width: Math.max(50, this.place.clientWidth), height: Math.max(100, this.place.clientHeight), legend: { show: false },
      padding: [8, 16, 0, 0], cursor: { drag: { x: false, y: false }, points: { show: false } },
      scales: { x: { time: false, range: () => this.frequencies() }, y: { distr: 3, range: () => [1, 200] } },
      axes: [{ ...axis(), size: 24, values: (_, all) => all.map((v) => `${v} Hz`) }, { ...axis(), size: 34 }],
      series: [{}, { stroke: colour("soft"), width: 1, points: { show: false } }],
      hooks: { draw: [(plot) => this.theory(plot), (plot) => this.points(plot)] },
    }, [[1], [null]], this.place);
    this.redraw();
  }

  frequencies() {
    const found = this.rows.concat(this.others).map((row) => row.f);
    return [Math.min(7.5, ...found) - 0.2, Math.max(10.5, ...found) + 0.2];
  }

  /**
   * @param {Row[]} rows @param {number[][]} closed @param {Prediction["lines"]} predicted
   * @param {number | null} gap of now @param {Row[]} [others] of a second run
   */
  show(rows, closed, predicted, gap, others = []) {
    this.rows = rows.filter((row) => !this.removed.has(key(row)));
    this.closed = closed;
    this.predicted = predicted;
    this.gap = gap;
    this.others = others;
    this.redraw();
  }

  /** Remove a point from the curve; it stays in the recording. @param {Row | undefined} row */
  remove(row) {
    if (!row) return;
    this.removed.add(key(row));
    this.rows = this.rows.filter((one) => one !== row);
    this.redraw();
  }

  /** Show every point again. @param {Row[]} rows */
  restore(rows) {
    this.removed.clear();
    this.rows = rows;
    this.redraw();
  }

  /** @returns {string} the points as a table, SI units */
  csv() {
    const names = ["time_s", "frequency_hz", "transmissibility", "standard_uncertainty", "phase_deg", "gap_m",
      "impacts_per_cycle", "superior_m", "base_m", "current_a", "settled", "regime", "status"];
    const lines = this.rows.map((r) => [r.t, r.f, r.dt, r.u, r.phase, r.gap, r.ipc, r.x1, r.xb, r.i, r.settled ? 1 : 0, r.regime, r.status || "ok"]);
    return [names, ...lines].map((line) => line.map((one) => one ?? "").join(",")).join("\n") + "\n";
  }

  /** @returns {HTMLCanvasElement} the curve as a picture */
  picture() { return stacked([this.plot.ctx.canvas]); }

  redraw() {
    const x = this.closed.length ? this.closed.map((p) => p[0]) : [7, 11];
    this.plot.setData([x, this.closed.length ? this.closed.map((p) => p[1]) : [null, null]]);
  }

  /** Draw the predictions, with a legend in the corner. @private */
  theory(plot) {
    const g = clipped(plot), ratio = devicePixelRatio || 1, { left, top } = plot.bbox;
    g.strokeStyle = colour("drive");
    g.lineWidth = 1.6 * ratio;
    for (const [lasts, points] of this.predicted) {
      g.setLineDash(lasts ? [] : [4 * ratio, 3 * ratio]);
      stroke(g, points.map(([f, dt]) => [plot.valToPos(f, "x", true), plot.valToPos(dt, "y", true)]));
    }
    const kinds = [["without sphere", "soft", 1, [], this.closed.length > 0],
      ["predicted", "drive", 1.6, [], this.predicted.some(([lasts]) => lasts)],
      ["not stable", "drive", 1.6, [4, 3], this.predicted.some(([lasts]) => !lasts)]];
    g.font = `${10.5 * ratio}px system-ui`;
    [g.textBaseline, g.textAlign] = ["middle", "left"];
    kinds.filter((kind) => kind[4]).forEach(([words, ink, wide, dash], row) => {
      const x = left + 6 * ratio, y = top + (8 + 13 * row) * ratio;
      g.strokeStyle = colour(ink);
      g.lineWidth = wide * ratio;
      g.setLineDash(dash.map((one) => one * ratio));
      stroke(g, [[x, y], [x + 18 * ratio, y]]);
      g.fillStyle = colour("ink");
      g.fillText(words, x + 23 * ratio, y);
    });
    g.restore();
  }

  /** @private */
  points(plot) {
    const g = plot.ctx, ratio = devicePixelRatio || 1;
    const draw = (row, ink, square) => {
      if (!(row.dt > 0)) return;
      const x = plot.valToPos(row.f, "x", true), y = plot.valToPos(row.dt, "y", true);
      g.strokeStyle = g.fillStyle = ink;
      g.lineWidth = ratio;
      if (row.u > 0) {
        const high = plot.valToPos(row.dt + 2 * row.u, "y", true), low = plot.valToPos(Math.max(1, row.dt - 2 * row.u), "y", true);
        stroke(g, [[x, high], [x, low]]);
      }
      g.beginPath();
      if (square) g.rect(x - 3 * ratio, y - 3 * ratio, 6 * ratio, 6 * ratio);
      else g.arc(x, y, 3.2 * ratio, 0, 2 * Math.PI);
      if (row.settled) g.fill(); else g.stroke();
    };
    for (const row of this.rows) if (row.gap !== this.gap) draw(row, colour("grey"), false);
    for (const row of this.others) draw(row, colour("trace-b"), true);
    for (const row of this.rows) if (row.gap === this.gap) draw(row, colour("accent"), false);
  }

  /** @private */
  pick(event) {
    const box = this.plot.over.getBoundingClientRect();
    let best = null, nearest = 18;
    for (const row of this.rows) {
      const x = this.plot.valToPos(row.f, "x") - (event.clientX - box.left), y = this.plot.valToPos(row.dt, "y") - (event.clientY - box.top);
      const distance = Math.hypot(x, y);
      if (distance < nearest) { nearest = distance; best = row; }
    }
    if (best && event.shiftKey) this.onRemove(best);
    else if (best) this.onPick(best);
  }
}

/** Key of a point. @param {Row} row */
function key(row) { return `${row.t} ${row.f}`; }
