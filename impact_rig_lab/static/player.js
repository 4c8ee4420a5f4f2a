// Playback: time slider with marks for commands, impacts, faults and trips.

import { clock } from "./format.js";
import { byId } from "./page.js";
import { colour, paper } from "./paper.js";

const INK = { command: "drive", parameter: "drive", trip: "hot", stop: "hot", fault: "warn", note: "soft" };

export class Player {
  /** @param {(what: string, values: object) => void} ask */
  constructor(ask) {
    this.ask = ask;
    /** @type {{begin: number, end: number, playing: boolean, speed: number, now: number, read: number} | null} */
    this.state = null;
    this.dragging = false;
    /** @type {any[]} */
    this.journal = [];
    const slider = byId("position");
    slider.addEventListener("input", () => { this.dragging = true; ask("seek", { value: slider.valueAsNumber }); });
    slider.addEventListener("change", () => { this.dragging = false; });
    byId("play").addEventListener("click", () => this.toggle());
    byId("play-speed").addEventListener("change", () => ask("speed", { value: Number(byId("play-speed").value) }));
    byId("align").addEventListener("change", () => this.align());
    byId("align-change").addEventListener("change", () => this.align());
    byId("next-impact").addEventListener("click", () => ask("next_impact", { value: 1 }));
    byId("previous-impact").addEventListener("click", () => ask("next_impact", { value: -1 }));
  }

  toggle() { if (this.state) this.ask("play", { value: !this.state.playing }); }

  /** Align the second run with the first. @private */
  align() {
    const by = byId("align").value, chosen = byId("align-change");
    chosen.hidden = by !== "change";
    if (by === "change") {
      const lines = this.journal.filter(([time]) => time >= this.state.begin);
      if (chosen.options.length !== lines.length) {
        chosen.replaceChildren(...lines.map(([time, ...words]) => new Option(`${clock(time)} ${words.join(" ")}`, time)));
      }
      if (!lines.length) return;
    }
    this.ask("align", { by, value: by === "change" ? Number(chosen.value) : 0 });
  }

  /** @param {number} seconds */
  jump(seconds) { if (this.state) this.ask("seek", { value: this.state.now + seconds }); }

  /** @param {any} state part `playback` of the snapshot @param {any[]} journal @param {number[]} impacts number of impacts in each of many equal parts of the run */
  show(state, journal, impacts) {
    this.state = state;
    this.journal = journal ?? [];
    byId("align-box").hidden = state.names.length < 2;
    byId("player").hidden = false;
    const slider = byId("position");
    slider.min = state.begin;
    slider.max = state.end;
    slider.step = Math.max(0.001, (state.end - state.begin) / 1e6);
    if (!this.dragging) slider.value = state.now;
    byId("play").textContent = state.playing ? "❚❚ Pause" : "▶ Play";
    byId("play").setAttribute("aria-pressed", String(state.playing));
    byId("play-speed").value = String(state.speed);
    byId("position-text").textContent = `${clock(state.now)} of ${clock(state.end)}`;
    slider.setAttribute("aria-valuetext", clock(state.now));
    this.marks(journal ?? [], impacts ?? []);
  }

  /** @private */
  marks(journal, impacts) {
    const { g, w, h } = paper(byId("marks"));
    const { begin, end } = this.state;
    const at = (time) => 8 + (time - begin) / Math.max(1e-9, end - begin) * (w - 16);
    g.fillStyle = colour("grey"); // number of impacts in each part of the run, as the height of a bar
    const most = Math.max(1, ...impacts);
    impacts.forEach((count, i) => {
      if (!count) return;
      const high = 2 + 5 * count / most;
      g.fillRect(8 + i / impacts.length * (w - 16), h - high, Math.max(1, (w - 16) / impacts.length), high);
    });
    for (const [time, kind] of journal) {
      if (!INK[kind] || time < begin) continue;
      g.fillStyle = colour(INK[kind]);
      g.fillRect(at(time) - 1, 0, 2, 7);
    }
  }
}
