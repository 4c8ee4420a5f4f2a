// Amplitude spectrum of one channel, harmonics of the drive marked.

import { decibel, engineering, limits } from "./format.js";
import { axis, colour } from "./paper.js";

/* global uPlot */
const UNITS = ["m/s²", "m", "m", "A"];

export class SpectrumView {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.place = place;
    this.db = true;
    this.top = 100;
    this.drive = 0;
    this.channel = 0;
    this.range = null;
    this.make();
    new ResizeObserver(() => this.plot.setSize({ width: place.clientWidth, height: Math.max(50, place.clientHeight) })).observe(place);
  }

  make() {
    this.place.replaceChildren();
    this.range = null;
    const value = (v) => (this.db ? `${v}` : engineering(v, UNITS[this.channel]));
    this.plot = new uPlot({
      width: Math.max(50, this.place.clientWidth), height: Math.max(50, this.place.clientHeight), legend: { show: false },
      padding: [6, 22, 0, 0], cursor: { drag: { x: false, y: false }, points: { show: false } },
      scales: { x: { time: false, range: () => [0, this.top] }, y: { range: () => this.range ?? [0, 1] } },
      axes: [{ ...axis(), size: 22, values: (_, all) => all.map((v) => `${v} Hz`) }, { ...axis(), size: 58, values: (_, all) => all.map(value), space: 24 }],
      series: [{}, { stroke: colour("trace"), width: 1, points: { show: false } }],
      hooks: { draw: [(plot) => this.marks(plot)] },
    }, [[0, 1], [null, null]], this.place);
  }

  /** @param {{resolution: number, channel: number, amplitudes: Float32Array}} spectrum */
  show(spectrum) {
    if (spectrum.channel !== this.channel) this.range = null;
    this.channel = spectrum.channel;
    const x = Array.from(spectrum.amplitudes, (_, i) => i * spectrum.resolution);
    const y = Array.from(spectrum.amplitudes, (a) => (this.db ? decibel(a) : a));
    const inside = y.slice(2);
    const high = Math.max(...inside);
    this.range = limits(this.range, this.db ? Math.max(Math.min(...inside), high - 90) : 0, high);
    this.plot.setData([x, y]);
  }

  /** @private */
  marks(plot) {
    if (!(this.drive > 0)) return;
    const g = plot.ctx, ratio = devicePixelRatio || 1;
    g.save();
    g.fillStyle = colour("drive");
    g.font = `${10 * ratio}px system-ui`;
    g.textAlign = "center";
    for (let n = 1; n * this.drive < this.top && n <= 12; n++) {
      const x = plot.valToPos(n * this.drive, "x", true);
      g.fillRect(x - ratio / 2, plot.bbox.top, ratio, 5 * ratio);
      g.fillText(n === 1 ? "f" : `${n}f`, x, plot.bbox.top + 15 * ratio);
    }
    g.restore();
  }
}
