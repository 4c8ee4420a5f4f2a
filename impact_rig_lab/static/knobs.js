// The knobs: slider, number field, keys. They are pending until the rig confirms; a rejection is shown next to the knob.

import { steps } from "./format.js";
import { byId, element } from "./page.js";
import { Knobs } from "./store.js";

const PAPER_GAPS_MM = [0, 2, 4, 6, 8, 10];

/**
 * @typedef {object} Knob
 * @property {string} name request, and id of its field
 * @property {string} label
 * @property {string} [unit]
 * @property {number} [min] @property {number} [max] of the slider @property {number} [step] @property {number} [fine]
 * @property {number} [factor] field = factor × value in SI
 * @property {string[]} [choices]
 * @property {[string, number][]} [marks] values of the paper
 */

/** @type {Knob[]} */
export const KNOBS = [
  { name: "frequency", label: "Frequency", unit: "Hz", min: 7, max: 11, step: 0.1, fine: 0.01, factor: 1, marks: [["9.1 Hz", 9.1]] },
  { name: "current", label: "Current", unit: "A", min: 0, max: 1, step: 0.02, fine: 0.002, factor: 1, marks: [["0.52 A", 0.52]] },
  { name: "gap", label: "Gap", unit: "mm", min: 0, max: 20, step: 1, fine: 0.1, factor: 1e3,
    marks: PAPER_GAPS_MM.map((gap) => [gap ? String(gap) : "none", gap]) },
  { name: "start", label: "Sphere at", choices: [] },
  { name: "law", label: "Law", choices: [] },
  { name: "restitution", label: "Restitution", unit: "", min: 0.05, max: 1, step: 0.05, fine: 0.01, factor: 1 },
];

export class KnobPanel {
  /**
   * @param {HTMLElement} place
   * @param {(what: string, values: object) => {id: number, answer: Promise<{ok: boolean, text: string}>}} ask
   */
  constructor(place, ask) {
    this.place = place;
    this.ask = ask;
    this.knobs = new Knobs();
    /** @type {Record<string, number | string | null>} */
    this.values = {};
    this.readOnly = false;
    this.boxes = Object.fromEntries(KNOBS.map((knob) => [knob.name, this.make(knob)]));
    place.addEventListener("submit", (event) => event.preventDefault());
  }

  /** @private */
  make(knob) {
    const id = `knob-${knob.name}`;
    const label = element("label", { textContent: knob.label, htmlFor: id });
    label.dataset.help = knob.label.toLowerCase();
    const words = element("p", { className: "words" });
    words.setAttribute("role", "status");
    if (knob.choices) {
      const select = element("select", { id });
      select.addEventListener("change", () => this.turn(knob, select.value));
      const box = element("div", { className: "knob" }, label, select, words);
      this.place.append(box);
      return { box, field: select, slider: null, words };
    }
    const field = element("input", { type: "number", id, step: "any", required: true });
    const slider = element("input", { type: "range", min: knob.min, max: knob.max, step: knob.fine });
    slider.setAttribute("aria-label", `${knob.label} slider`);
    field.addEventListener("input", () => { field.dataset.written = "yes"; this.forgive(); });
    const written = () => { // once, by Enter or by leaving the field
      if (!field.dataset.written) return;
      delete field.dataset.written;
      this.turn(knob, field.valueAsNumber);
    };
    field.addEventListener("change", written);
    field.addEventListener("keydown", (event) => {
      if (event.key === "Enter") { event.preventDefault(); written(); }
      if (event.key !== "ArrowUp" && event.key !== "ArrowDown") return;
      event.preventDefault();
      this.nudge(knob.name, (event.key === "ArrowUp" ? 1 : -1) * (event.shiftKey ? 0.1 : 1));
    });
    slider.addEventListener("input", () => { field.value = slider.value; });
    slider.addEventListener("change", () => this.turn(knob, slider.valueAsNumber));
    const box = element("div", { className: "knob" }, label, field,
      element("span", { className: "unit", textContent: knob.unit ?? "" }), slider);
    if (knob.marks) {
      const marks = element("div", { className: "marks" });
      marks.setAttribute("role", "group");
      marks.setAttribute("aria-label", `${knob.label}: values of the paper`);
      for (const [text, value] of knob.marks) {
        const button = element("button", { type: "button", textContent: text, title: "value of the paper" });
        button.dataset.mark = `${knob.name}-${value}`;
        button.addEventListener("click", () => this.turn(knob, value));
        marks.append(button);
      }
      box.append(marks);
    }
    box.append(words);
    this.place.append(box);
    return { box, field, slider, words };
  }

  /** Change a knob by so many coarse steps. @param {string} name @param {number} count */
  nudge(name, count) {
    const knob = /** @type {Knob} */ (KNOBS.find((one) => one.name === name));
    const step = Math.abs(count) < 1 ? knob.fine * Math.sign(count) : knob.step * count;
    const now = Number(this.boxes[name].field.value) || 0;
    this.turn(knob, Number((now + step).toFixed(6)));
  }

  /** Hide rejections whose cause may have disappeared. */
  forgive() {
    this.knobs.forgive();
    this.refresh();
  }

  /**
   * Ask the rig for a value.
   * @param {Knob | string} which @param {number | string} shown as in the field
   * @returns {Promise<boolean>} whether it is active
   */
  async turn(which, shown) {
    const knob = typeof which === "string" ? /** @type {Knob} */ (KNOBS.find((one) => one.name === which)) : which;
    if (this.readOnly || (typeof shown === "number" && !Number.isFinite(shown))) { this.refresh(); return false; }
    const value = typeof shown === "number" ? Number((shown / (knob.factor ?? 1)).toPrecision(12)) : shown;
    const { id, answer } = this.ask(knob.name, { value });
    this.knobs.ask(knob.name, id);
    const field = this.boxes[knob.name].field;
    delete field.dataset.written;
    field.value = String(shown);
    this.refresh();
    const { ok, text } = await answer;
    if (ok) this.values[knob.name] = value; // the last report of the rig may be older than the answer
    this.knobs.answer(knob.name, id, ok, text);
    this.refresh();
    return ok;
  }

  /** @param {{law: string[], start: string[]}} choices */
  choose(choices) {
    for (const name of ["law", "start"]) {
      const select = this.boxes[name].field;
      select.replaceChildren(...choices[name].map((word) => new Option(word.replaceAll("_", " "), word)));
    }
    this.refresh();
  }

  /** Show the active values. @param {Record<string, number | string | null>} values in SI, by name */
  show(values) {
    Object.assign(this.values, values);
    this.refresh();
  }

  refresh() {
    for (const knob of KNOBS) {
      const { box, field, slider, words } = this.boxes[knob.name];
      const state = this.knobs.state(knob.name);
      box.classList.toggle("pending", state === "pending");
      box.classList.toggle("refused", state === "refused");
      words.textContent = this.knobs.words(knob.name);
      field.setAttribute("aria-invalid", String(state === "refused"));
      field.disabled = this.readOnly;
      if (slider) slider.disabled = this.readOnly;
      for (const button of box.querySelectorAll("button")) button.disabled = this.readOnly;
      const value = this.values[knob.name];
      const isKnown = value !== null && value !== undefined;
      slider?.classList.toggle("untold", !isKnown);
      if (!this.knobs.follows(knob.name) || field.dataset.written) continue;
      if (!isKnown) { // the value belongs to another rig
        if (field.dataset.shown !== undefined) field.value = "";
        delete field.dataset.shown;
        continue;
      }
      const shown = typeof value === "number" ? String(Number((value * (knob.factor ?? 1)).toPrecision(6))) : value;
      const focused = document.activeElement === field;
      if (!focused || field.dataset.shown !== shown) field.value = shown;
      if (focused && slider && field.dataset.shown !== shown) field.select(); // typing replaces it: 4 and 6 must not become 46
      field.dataset.shown = shown;
      if (slider && document.activeElement !== slider) slider.value = shown;
    }
  }
}

/** Held quantities: unit of the field, its factor to the SI unit, and the initial value. */
const HELD = { base: ["mm", 1e3, 0.06], superior: ["mm", 1e3, 3], current: ["A", 1, 0.3] };

export class SweepForm {
  /** @param {(what: string, values: object) => void} act */
  constructor(act) {
    byId("sweep-hold").addEventListener("change", () => this.choose());
    byId("sweep-form").addEventListener("submit", (event) => { event.preventDefault(); act("sweep", this.values()); });
    this.choose();
  }

  /** Show the target in its unit, if it has one. */
  choose() {
    const hold = byId("sweep-hold").value, held = HELD[hold], target = byId("sweep-target");
    target.disabled = !held;
    target.value = held ? held[2] : "";
    byId("sweep-unit").textContent = held ? held[0] : "";
    byId("sweep-start").textContent = hold === "phase" ? "Lock" : "Sweep";
  }

  /** @returns {{frequencies: number[], direction: string, hold: string, target: number}} the requested sweep */
  values() {
    const number = (id) => byId(id).valueAsNumber, hold = byId("sweep-hold").value;
    return {
      frequencies: steps(number("sweep-from"), number("sweep-to"), number("sweep-points")),
      direction: byId("sweep-direction").value, hold, target: HELD[hold] ? number("sweep-target") / HELD[hold][1] : 0,
    };
  }
}
