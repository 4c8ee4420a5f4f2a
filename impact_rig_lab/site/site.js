// The page: the lab's views of a rig that runs in a worker.

import { Clock, Motion } from "lab/motion.js";
import { byId, element } from "lab/page.js";
import { forgetColours } from "lab/paper.js";
import { drawRig, GLOW_S } from "lab/rigview.js";
import { ScopeView } from "lab/scopeview.js";
import { SpectrumView } from "lab/spectrumview.js";
import { spectrum, transmissibility } from "./signals.js";

const RATE_HZ = 10_000, KEPT = 1 << 15, COLUMNS = 500, WINDOW_S = 0.5, FFT = 1 << 14, LOCK_IN_CYCLES = 20, SETTLING_CYCLES = 20;
const CHANNELS = ["accelerometer", "laser", "base", "current"];
const { start, worker } = globalThis.site;
const motion = new Motion(), clock = new Clock(0.12);
const scope = new ScopeView(byId("scope"), byId("readout")), view = new SpectrumView(byId("spectrum"));
const rings = CHANNELS.map(() => new Float64Array(KEPT));
const now = { scans: 0, gap: 0.006, speed: 1, time: 0, impacts: /** @type {number[]} */ ([]), since: 0 };
globalThis.lab = { now, motion, digest: null };

const knob = (id) => Number(byId(id).value);
const send = (message) => {
  byId("answer").textContent = "";
  worker.postMessage(message);
};
const command = () => { send({ type: "command", frequency: knob("frequency"), amplitude: knob("current") }); now.since = now.scans; };

worker.onmessage = ({ data }) => {
  if (data.type === "error") { byId("answer").textContent = data.text; return; }
  if (data.type === "digest") { globalThis.lab.digest = data; return; }
  if (data.type === "began") {
    Object.assign(now, { scans: 0, since: 0, gap: data.gap, impacts: [] });
    motion.clear();
    byId("word").textContent = "running";
    return;
  }
  if (data.gap !== now.gap) { now.gap = data.gap; now.since = now.scans; }
  now.time = data.time;
  for (let at = 0; at < data.scans.length; at += data.channels + 1, now.scans++) {
    rings.forEach((ring, j) => { ring[now.scans % KEPT] = data.scans[at + 1 + j]; });
  }
  motion.add("states", { rows: data.states.length / 7, columns: 7, values: data.states });
  motion.add("impacts", { rows: data.contacts.length / 5, columns: 5, values: data.contacts });
  for (let at = 0; at < data.contacts.length; at += 5) now.impacts.push(data.contacts[at]);
};

/** Return the last readings of a channel. @param {number} channel @param {number} count */
function newest(channel, count) {
  const n = Math.min(count, now.scans, KEPT);
  return Float64Array.from({ length: n }, (_, i) => rings[channel][(now.scans - n + i) % KEPT]);
}

function drawScope() {
  const count = Math.round(WINDOW_S * RATE_HZ), each = count / COLUMNS, low = [], high = [];
  const columns = Math.floor(Math.min(count, now.scans) / each);
  if (columns < 2) return;
  CHANNELS.forEach((_, channel) => {
    const values = newest(channel, columns * each);
    const parts = Array.from({ length: columns }, (_unused, i) => values.subarray(i * each, (i + 1) * each));
    low.push(Float32Array.from(parts, (one) => Math.min(...one)));
    high.push(Float32Array.from(parts, (one) => Math.max(...one)));
  });
  const end = now.scans / RATE_HZ, begin = end - columns * each / RATE_HZ;
  scope.impacts = [motion.impacts.map((row) => row[0]).filter((time) => time > begin), []];
  scope.draw({ begin, column: each / RATE_HZ, trigger: NaN, now: end, low, high, status: new Uint8Array(columns) }, null);
}

function showFigures() {
  const frequency = knob("frequency"), channel = byId("channel").selectedIndex;
  byId("time").textContent = `${now.time.toFixed(2)} s`;
  const cycles = Math.min(LOCK_IN_CYCLES, Math.floor(KEPT / RATE_HZ * frequency)), count = Math.round(cycles / frequency * RATE_HZ);
  const isSettled = now.scans - now.since > (SETTLING_CYCLES + cycles) / frequency * RATE_HZ; // approximately: decays take longer
  byId("dt").textContent = isSettled ? transmissibility(newest(1, count), newest(2, count), frequency / RATE_HZ).toFixed(2) : "–";
  now.impacts = now.impacts.filter((time) => time > now.time - 5);
  byId("rate").textContent = (now.impacts.length / Math.min(5, Math.max(now.time, 0.1)) / frequency).toFixed(1);
  view.drive = frequency;
  if (now.scans >= FFT) view.show({ resolution: RATE_HZ / FFT, channel, amplitudes: spectrum(newest(channel, FFT)).slice(0, Math.ceil(view.top * FFT / RATE_HZ)) });
  drawScope();
}

let before = performance.now();
function frame(at) {
  const t = clock.advance((at - before) / 1000, motion.newest, now.speed);
  before = at;
  const pace = now.speed > 0 ? Math.min(1, now.speed * 4) : 1;
  drawRig(byId("rig"), motion.at(t, now.gap), { gap: now.gap, present: true }, (wall) => motion.flash(t, wall, GLOW_S * pace), pace);
  requestAnimationFrame(frame);
}

byId("channel").append(...CHANNELS.map((name) => element("option", { textContent: name })));
byId("preset").append(...Object.keys(start.snapshots).map((name) => element("option", { textContent: name })));
for (const id of ["frequency", "current"]) byId(id).addEventListener("change", command);
byId("gap").addEventListener("change", () => send({ type: "gap", gap: knob("gap") / 1000 }));
byId("preset").addEventListener("change", () => send({ type: "rig", name: byId("preset").value }));
byId("pace").addEventListener("change", () => { now.speed = knob("pace"); send({ type: "pace", speed: now.speed }); });
byId("reset").addEventListener("click", () => send({ type: "reset" }));
const preference = matchMedia("(prefers-color-scheme: dark)");
function theme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "";
  forgetColours();
  scope.make();
  view.make();
}
byId("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme !== "dark"));
preference.addEventListener("change", () => theme(preference.matches));
if (preference.matches) theme(true);
send({ type: "start", ...start });
setInterval(showFigures, 200);
requestAnimationFrame(frame);
