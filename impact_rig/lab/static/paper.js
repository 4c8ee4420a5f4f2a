// Drawing by hand: canvases as sharp as the screen, colours of the style sheet.

/**
 * Make a canvas fit its place and return its context, in CSS pixels.
 * @param {HTMLCanvasElement} canvas
 * @returns {{g: CanvasRenderingContext2D, w: number, h: number}}
 */
export function paper(canvas) {
  const ratio = devicePixelRatio || 1;
  const w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const g = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, w, h);
  return { g, w, h };
}

let cached = {};

/** @param {string} name of a variable of style.css @returns {string} its value now */
export function colour(name) {
  if (!(name in cached)) cached[name] = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return cached[name];
}

/** The theme has changed: read the colours again. */
export function forgetColours() { cached = {}; }
