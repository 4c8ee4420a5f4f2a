// Keyboard: one table for the actions of keys and for the help sheet.

import { element } from "./page.js";

/** @typedef {{keys: string[], text: string, run: () => void}} Binding */

/**
 * Listen for keys, except in text fields.
 * @param {Binding[]} bindings
 */
export function listen(bindings) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = /** @type {HTMLElement} */ (event.target);
    const writes = target.matches("input:not([type=checkbox]):not([type=range]), select, textarea");
    if (writes && event.key !== "Escape") return;
    if ((event.key === " " || event.key === "Enter") && target.matches("button, summary, input")) return;
    if (event.key.startsWith("Arrow") && target.matches("input[type=range]")) return;
    const binding = bindings.find((one) => one.keys.includes(event.key));
    if (!binding) return;
    event.preventDefault();
    binding.run();
  });
  document.addEventListener("click", (event) => { // the space bar must not press a clicked button again
    const button = /** @type {HTMLElement} */ (event.target).closest?.("button, summary");
    if (event.detail > 0 && button) /** @type {HTMLElement} */ (button).blur();
  });
}

/** @param {HTMLElement} table @param {Binding[]} bindings */
export function fillSheet(table, bindings) {
  const names = { " ": "space", ArrowUp: "↑", ArrowDown: "↓", ArrowLeft: "←", ArrowRight: "→", Escape: "Esc" };
  table.replaceChildren(...bindings.map((binding) => {
    const keys = binding.keys.flatMap((key) => [element("kbd", { textContent: names[key] ?? key }), " "]);
    return element("tr", {}, element("th", { scope: "row" }, ...keys), element("td", { textContent: binding.text }));
  }));
}
