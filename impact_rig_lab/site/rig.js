// The rig in WebAssembly: rig.h of impact_rig/embedded, for JavaScript. Its readings equal those of the rig in Python bit for bit.

export const QUANTITIES = ["x_b", "x_1", "x_2", "v_b", "v_1", "v_2", "a_b", "a_1", "a_2", "current", "force_left", "force_right"];
export const TICK_S = 0.01, MOST_TICKS = 25;
const ERRORS = {
  [-1]: "the frequency, current or gap is out of range; choose another value",
  [-2]: "the motion cannot be resolved numerically; choose other values and reset the rig",
  [-3]: "too many contacts of the sphere in one step of the simulation; choose other values and reset the rig",
};

export class Rig {
  /** @param {WebAssembly.Module} module @param {ArrayBuffer} snapshot of a rig @returns {Promise<Rig>} */
  static async load(module, snapshot) {
    const instance = await WebAssembly.instantiate(module, { wasi_snapshot_preview1: { random_get: () => 0 } });
    return new Rig(/** @type {any} */ (instance.exports), snapshot);
  }

  /** @private */
  constructor(calls, snapshot) {
    this.calls = calls;
    const at = calls.malloc(snapshot.byteLength);
    new Uint8Array(calls.memory.buffer, at).set(new Uint8Array(snapshot));
    this.rig = calls.ir_rig_new(at, snapshot.byteLength);
    if (!this.rig) throw new Error("the snapshot of the rig was made by another version of impact_rig; build this page again");
    this.channels = Number(calls.ir_rig_channels(this.rig));
    this.room = calls.malloc(8 * QUANTITIES.length);
  }

  /** @private */
  checked(status) {
    if (status < 0) throw new Error(ERRORS[Number(status)]);
    return Number(status);
  }

  /** @returns {number} time [s] */
  get time() { return Number(this.calls.ir_rig_tick(this.rig)) * TICK_S; }

  /** @returns {number} total gap [m] */
  get gap() { return this.calls.ir_rig_gap(this.rig); }

  /** @param {number} frequency [Hz] @param {number} amplitude peak current [A] */
  command(frequency, amplitude) { this.checked(this.calls.ir_rig_command(this.rig, frequency, amplitude)); }

  /** @param {number} gap total gap [m]; the sphere returns to its start */
  setGap(gap) { this.checked(this.calls.ir_rig_set_gap(this.rig, gap)); }

  reset() { this.calls.ir_rig_reset(this.rig); }

  /**
   * Simulate some ticks of 10 ms.
   * @param {number} ticks 1 to MOST_TICKS
   * @returns {Float64Array} rows of complete scans: status bits (as an integer in the first byte) and a reading for each channel
   */
  advance(ticks) {
    const scans = this.checked(this.calls.ir_rig_advance(this.rig, BigInt(ticks)));
    const at = this.calls.ir_rig_scans(this.rig);
    return new Float64Array(this.calls.memory.buffer.slice(at, at + 8 * scans * (this.channels + 1)));
  }

  /**
   * Return the true motion at a time of the last call.
   * @param {number} tick of the call, from 0 on @param {number} offset within it [s] @returns {Float64Array} QUANTITIES
   */
  sample(tick, offset) {
    this.checked(this.calls.ir_rig_sample(this.rig, BigInt(tick), offset, this.room));
    return new Float64Array(this.calls.memory.buffer.slice(this.room, this.room + 8 * QUANTITIES.length));
  }

  /** @returns {number[][]} contacts of the last call: time [s], wall, approach, separation [m/s], peak force [N] */
  contacts() {
    const found = [];
    while (this.calls.ir_rig_contact(this.rig, BigInt(found.length), this.room)) {
      const [tick, offset, ...rest] = new Float64Array(this.calls.memory.buffer, this.room, 6);
      found.push([tick * TICK_S + offset, ...rest]);
    }
    return found;
  }
}
