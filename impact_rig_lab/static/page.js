// Elements of the page: lookup by id, and creation.

/** @param {string} id @returns {any} the element of this id */
export const byId = (id) => document.getElementById(id);

/**
 * Create an element.
 * @param {string} tag @param {object} [properties] @param {(Node | string)[]} children @returns {any}
 */
export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}
