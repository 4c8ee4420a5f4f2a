// The sweep form: which frequencies, and what stays constant meanwhile.

import { steps } from "./format.js";

/** What is held, in which unit a person writes it, how many of that are one SI unit, and what to begin with. */
const HELD = { base: ["mm", 1e3, 0.06], superior: ["mm", 1e3, 3], current: ["A", 1, 0.3] };

export class SweepForm {
  /** @param {(id: string) => any} byId @param {(what: string, values: object) => void} act */
  constructor(byId, act) {
    this.byId = byId;
    byId("sweep-hold").addEventListener("change", () => this.choose());
    byId("sweep-form").addEventListener("submit", (event) => { event.preventDefault(); act("sweep", this.values()); });
    this.choose();
  }

  /** Show the target in its unit, where there is one. */
  choose() {
    const hold = this.byId("sweep-hold").value, held = HELD[hold], target = this.byId("sweep-target");
    target.disabled = !held;
    target.value = held ? held[2] : "";
    this.byId("sweep-unit").textContent = held ? held[0] : "";
    this.byId("sweep-start").textContent = hold === "phase" ? "Lock" : "Sweep";
  }

  /** @returns {{frequencies: number[], direction: string, hold: string, target: number}} what is asked for */
  values() {
    const number = (id) => this.byId(id).valueAsNumber, hold = this.byId("sweep-hold").value;
    return {
      frequencies: steps(number("sweep-from"), number("sweep-to"), number("sweep-points")),
      direction: this.byId("sweep-direction").value, hold, target: HELD[hold] ? number("sweep-target") / HELD[hold][1] : 0,
    };
  }
}
