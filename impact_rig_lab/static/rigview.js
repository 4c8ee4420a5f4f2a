// The rig in motion: table, bending columns, superior base with its barriers, sphere; walls flash with the peak force.

import { engineering, fixed } from "./format.js";
import { colour, paper, stroke } from "./paper.js";

const BASE_ENLARGED = 20;
const SPHERE_M = 6.35e-3;
export const GLOW_S = 0.06;

const READINGS_WIDE = 96, READINGS_HIGH = 62; // corner of the picture for x₁, x_b and x₂

/**
 * Draw the rig at one time.
 * @param {HTMLCanvasElement} canvas
 * @param {{base: number, structure: number, sphere: number} | null} at positions [m]
 * @param {{gap: number, present: boolean}} knobs
 * @param {(wall: number) => {force: number, age: number} | null} flash
 * @param {number} [pace] factor by which the glow of walls is shorter in slow motion
 */
export function drawRig(canvas, at, knobs, flash, pace = 1) {
  const { g, w, h } = paper(canvas);
  if (w < 10) return;
  const gap = knobs.present ? knobs.gap : 0.006;
  const inner = gap + SPHERE_M;
  const scale = Math.min(w / (inner + 0.034), h * 0.34 / SPHERE_M); // pixels per metre
  const middle = w / 2, floor = h - 22, deck = Math.round(h * 0.5);
  const base = middle + (at ? at.base : 0) * BASE_ENLARGED * scale;
  const top = middle + (at ? at.structure : 0) * scale;
  const plate = (inner + 0.012) * scale;
  g.lineJoin = "round";
  g.strokeStyle = colour("line"); // the ground
  g.lineWidth = 1;
  stroke(g, [[8, floor + 0.5], [w - 8, floor + 0.5]]);
  // inferior base, on the shaker's table
  g.fillStyle = colour("steel");
  g.fillRect(base - plate * 0.62, floor - 16, plate * 1.24, 16);
  // columns: clamped at both ends, so they bend like a cubic
  g.strokeStyle = colour("ink");
  g.lineWidth = 2.5;
  for (const side of [-1, 1]) {
    const x0 = base + side * plate * 0.46, x1 = top + side * plate * 0.46, y0 = floor - 16, y1 = deck + 12;
    g.beginPath();
    g.moveTo(x0, y0);
    g.bezierCurveTo(x0, (y0 + y1) / 2, x1, (y0 + y1) / 2, x1, y1);
    g.stroke();
  }
  // superior base and its barriers
  g.fillStyle = colour("accent");
  g.fillRect(top - plate / 2, deck, plate, 12);
  const high = SPHERE_M * scale * 1.15;
  for (const wall of knobs.present ? [-1, 1] : []) { // without a sphere the barriers have no gap to show
    const hit = flash(wall);
    const glow = hit ? 1 - hit.age / (GLOW_S * pace) : 0;
    g.fillStyle = colour("steel");
    const thick = 0.0045 * scale;
    const x = top + wall * (inner / 2) * scale;
    g.fillRect(wall < 0 ? x - thick : x, deck - high, thick, high);
    if (hit && glow > 0) {
      g.fillStyle = colour("hot");
      g.globalAlpha = Math.min(1, 0.25 + glow);
      g.fillRect(wall < 0 ? x - thick : x, deck - high, thick, high);
      g.font = "600 12px system-ui, sans-serif";
      g.textAlign = wall < 0 ? "right" : "left";
      const words = engineering(hit.force, "N"), beside = x + wall * (thick + 6);
      const reaches = wall < 0 ? beside - g.measureText(words).width < READINGS_WIDE : beside > w - READINGS_WIDE;
      g.fillText(words, beside, reaches ? Math.max(deck - high + 10, READINGS_HIGH) : deck - high + 10);
      g.globalAlpha = 1;
    }
  }
  if (knobs.present) sphere(g, middle + (at ? at.sphere : 0) * scale, deck - SPHERE_M / 2 * scale, SPHERE_M / 2 * scale);
  labels(g, { w, h, middle, top, deck, scale, at, gap, present: knobs.present });
}

function sphere(g, x, y, r) {
  g.fillStyle = colour("sphere");
  g.beginPath();
  g.arc(x, y, r, 0, 2 * Math.PI);
  g.fill();
  g.fillStyle = "rgba(255,255,255,.35)";
  g.beginPath();
  g.arc(x - r * 0.3, y - r * 0.35, r * 0.28, 0, 2 * Math.PI);
  g.fill();
}

function labels(g, s) {
  g.font = "11px system-ui, sans-serif";
  g.fillStyle = colour("soft");
  g.textAlign = "left";
  g.fillText(`inferior base, motion ×${BASE_ENLARGED}`, 10, s.h - 7);
  g.textAlign = "right";
  const ruler = 0.01 * s.scale;
  g.fillText("10 mm", s.w - 10, s.h - 7);
  g.fillRect(s.w - 10 - ruler, s.h - 21, ruler, 2);
  g.textAlign = "left";
  if (!s.at) return;
  g.fillText(`x₁ ${fixed(s.at.structure * 1e3, 2)} mm`, 10, 14);
  g.fillText(`x_b ${fixed(s.at.base * 1e6, 0)} µm`, 10, 29);
  if (s.present) g.fillText(`x₂ ${fixed(s.at.sphere * 1e3, 2)} mm`, 10, 44);
  g.textAlign = "right";
  g.fillText(s.present ? `gap ${(s.gap * 1e3).toFixed(1)} mm` : "no sphere", s.w - 10, 14);
}

/**
 * Draw the phase plane of the sphere against the superior base.
 * @param {HTMLCanvasElement} canvas
 * @param {import("./motion.js").Motion} motion
 * @param {number} until newest time drawn [s]
 * @param {{gap: number, present: boolean}} knobs
 * @param {number} span duration [s]
 */
export function drawPhase(canvas, motion, until, knobs, span) {
  const { g, w, h } = paper(canvas);
  if (w < 10) return;
  const reach = Math.max(knobs.gap / 2, 1e-4) * 1.15;
  let fastest = 0.05;
  for (const s of motion.states) fastest = Math.max(fastest, Math.abs(s[6] - s[5]));
  const x = (value) => w / 2 + value / reach * (w / 2 - 8), y = (value) => h / 2 - value / (fastest * 1.1) * (h / 2 - 14);
  g.strokeStyle = colour("line");
  g.strokeRect(0.5, 0.5, w - 1, h - 1);
  stroke(g, [[0, h / 2], [w, h / 2]]);
  g.strokeStyle = colour("hot");
  g.setLineDash([4, 3]);
  for (const wall of knobs.present ? [-1, 1] : []) stroke(g, [[x(wall * knobs.gap / 2), 0], [x(wall * knobs.gap / 2), h]]);
  g.setLineDash([]);
  if (knobs.present && motion.states.length > 2) {
    g.strokeStyle = colour("sphere");
    g.lineWidth = 1.2;
    g.beginPath();
    const step = 0.001, h2 = 0.0004;
    let first = true;
    for (let t = Math.max(motion.oldest + 0.002, until - span); t < until - 0.002; t += step) {
      if (motion.impacts.some((row) => Math.abs(row[0] - t) <= h2)) { first = true; continue; } // the velocity jumps here
      const a = motion.at(t - h2, knobs.gap), b = motion.at(t + h2, knobs.gap);
      if (!a || !b) continue;
      const d = (a.sphere - a.structure + b.sphere - b.structure) / 2;
      const v = (b.sphere - b.structure - a.sphere + a.structure) / (2 * h2);
      if (first) g.moveTo(x(d), y(v)); else g.lineTo(x(d), y(v));
      first = false;
    }
    g.stroke();
  }
  g.fillStyle = colour("soft");
  g.font = "11px system-ui, sans-serif";
  g.textAlign = "left";
  g.fillText(`± ${engineering(fastest * 1.1, "m/s")}`, 6, 13);
  g.textAlign = "right";
  g.fillText(knobs.present ? `walls at ± ${engineering(knobs.gap / 2, "m")}` : "no sphere", w - 6, h - 6);
}
