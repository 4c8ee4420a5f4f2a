// Canvas drawing: sharp canvases, colours of the style sheet.

/**
 * Fit a canvas to its element and return its context, in CSS pixels.
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

/** Draw a line. @param {CanvasRenderingContext2D} g @param {number[][]} points */
export function stroke(g, points) {
  g.beginPath();
  points.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y)));
  g.stroke();
}

/** Save the state of a plot's context, and clip drawing to its axes. @returns {CanvasRenderingContext2D} */
export function clipped({ ctx, bbox: { left, top, width, height } }) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, width, height);
  ctx.clip();
  return ctx;
}

let cached = {};

/** @param {string} name of a variable of style.css @returns {string} its value now */
export function colour(name) {
  if (!(name in cached)) cached[name] = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return cached[name];
}

/** Common properties of the axes of a plot, in the colours of the theme. */
export const axis = () => ({ stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "10.5px system-ui" });

/** Read the colours again after a change of the theme. */
export function forgetColours() { cached = {}; }

/**
 * Stack drawings vertically on the panel's colour.
 * @param {HTMLCanvasElement[]} drawings @returns {HTMLCanvasElement}
 */
export function stacked(drawings) {
  const whole = document.createElement("canvas");
  whole.width = Math.max(...drawings.map((one) => one.width));
  whole.height = drawings.reduce((sum, one) => sum + one.height, 0);
  const g = /** @type {CanvasRenderingContext2D} */ (whole.getContext("2d"));
  g.fillStyle = colour("panel");
  g.fillRect(0, 0, whole.width, whole.height);
  let y = 0;
  for (const one of drawings) {
    g.drawImage(one, 0, y);
    y += one.height;
  }
  return whole;
}

/** Save a file through the browser. @param {Blob} blob @param {string} name of the file */
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Save a drawing through the browser. @param {HTMLCanvasElement} drawing @param {string} name of the file */
export function savePicture(drawing, name) {
  drawing.toBlob((blob) => { if (blob) save(blob, name); }, "image/png");
}
