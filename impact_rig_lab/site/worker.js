// The rig in a Web Worker. It exchanges objects with the page; docs/how-to/browser.md describes them.

import { MOST_TICKS, Rig, TICK_S } from "./rig.js";

const PERIOD_MS = 40, SAMPLES = 5; // of the motion in a tick
let rig = null, module = null, snapshots = {}, drive = { frequency: 9.1, amplitude: 0.52 };
let speed = 1, running = false, due = 0, last = 0;

/** Simulate ticks and post the results. @param {number} ticks */
function advance(ticks) {
  const begin = rig.time, scans = rig.advance(ticks), states = [];
  for (let tick = 0; tick < ticks; tick++) {
    for (let i = 1; i <= SAMPLES; i++) {
      states.push(begin + (tick + i / SAMPLES) * TICK_S, ...rig.sample(tick, i / SAMPLES * TICK_S).subarray(0, 6));
    }
  }
  const contacts = rig.contacts().flat();
  postMessage({ type: "data", time: rig.time, gap: rig.gap, channels: rig.channels, scans, states: Float64Array.from(states),
    contacts: Float64Array.from(contacts) }, [scans.buffer]);
}

function turn() {
  const now = performance.now();
  due += Math.min(now - last, 250) / 1000 * speed / TICK_S;
  last = now;
  while (running && due >= 1) {
    const ticks = Math.min(MOST_TICKS, Math.floor(due));
    due -= ticks;
    advance(ticks);
  }
}

/** Show an error on the page. @param {any} error */
function report(error) {
  postMessage({ type: "error", text: String(error?.message ?? error) });
}

/** Reset the rig, simulate some seconds, and return the SHA-256 of the readings, channel after channel. */
async function digest(seconds) {
  rig.reset();
  rig.command(drive.frequency, drive.amplitude);
  const columns = Array.from({ length: rig.channels }, () => /** @type {number[]} */ ([]));
  const began = performance.now();
  for (let left = Math.round(seconds / TICK_S); left > 0; left -= MOST_TICKS) {
    const scans = rig.advance(Math.min(left, MOST_TICKS));
    for (let at = 0; at < scans.length; at += rig.channels + 1) columns.forEach((one, j) => one.push(scans[at + 1 + j]));
  }
  const took = (performance.now() - began) / 1000;
  const sum = await crypto.subtle.digest("SHA-256", Float64Array.from(columns.flat()));
  const hash = Array.from(new Uint8Array(sum), (byte) => byte.toString(16).padStart(2, "0")).join("");
  return { hash, scans: columns[0].length, realTimes: seconds / took };
}

const TAKES = {
  async start(message) {
    module = await WebAssembly.compile(message.module);
    snapshots = message.snapshots;
    await TAKES.rig({ name: Object.keys(snapshots)[0] });
    setInterval(() => {
      try {
        turn();
      } catch (error) { // a motion that cannot be simulated cannot go on either
        running = false;
        report(error);
      }
    }, PERIOD_MS);
  },
  async rig({ name }) {
    const gap = rig?.gap;
    rig = await Rig.load(module, snapshots[name]);
    if (gap) rig.setGap(gap);
    rig.command(drive.frequency, drive.amplitude);
    last = performance.now();
    running = true;
    postMessage({ type: "began", name, gap: rig.gap, channels: rig.channels });
  },
  command({ frequency, amplitude }) {
    rig.command(frequency, amplitude);
    drive = { frequency, amplitude };
  },
  gap({ gap }) { rig.setGap(gap); },
  reset() { rig.reset(); rig.command(drive.frequency, drive.amplitude); postMessage({ type: "began", gap: rig.gap, channels: rig.channels }); },
  pace(message) { speed = message.speed; running = speed > 0; },
  async digest({ seconds }) {
    running = false;
    postMessage({ type: "digest", ...await digest(seconds) });
  },
};

onmessage = async ({ data }) => {
  try {
    await TAKES[data.type](data);
  } catch (error) {
    report(error);
  }
};
