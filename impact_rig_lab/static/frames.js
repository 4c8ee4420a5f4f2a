// Decoder of the binary frames of the WebSocket; see impact_rig_lab/protocol.py.

export const Kind = { STATE: 1, REPLY: 2, TRACE: 3, MOTION: 4, IMPACTS: 5, DETECTED: 6, SPECTRUM: 7, TRACE_B: 8 };

/**
 * @typedef {object} Trace one window of the scope
 * @property {number} begin time of the first column [s]
 * @property {number} column length of a column [s]
 * @property {number} trigger time of the trigger, NaN without one [s]
 * @property {number} now end of the data [s]
 * @property {Float32Array[]} low minima by channel
 * @property {Float32Array[]} high maxima by channel
 * @property {Uint8Array} status bits by column
 */

/**
 * Decode one frame.
 * @param {ArrayBuffer} buffer the frame
 * @returns {{kind: number, number: number, content: any}} its content
 */
export function decode(buffer) {
  const view = new DataView(buffer);
  const kind = view.getUint8(0);
  const number = view.getUint32(4, true);
  if (kind === Kind.STATE || kind === Kind.REPLY) {
    return { kind, number, content: JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8))) };
  }
  if (kind === Kind.TRACE || kind === Kind.TRACE_B) return { kind, number, content: decodeTrace(buffer, view) };
  if (kind === Kind.SPECTRUM) {
    const count = view.getUint32(16, true);
    const amplitudes = new Float32Array(buffer.slice(24, 24 + 4 * count));
    return { kind, number, content: { resolution: view.getFloat64(8, true), channel: view.getUint32(20, true), amplitudes } };
  }
  const rows = view.getUint32(8, true);
  const columns = view.getUint32(12, true);
  return { kind, number, content: { rows, columns, values: new Float64Array(buffer, 16, rows * columns) } };
}

/**
 * @param {ArrayBuffer} buffer
 * @param {DataView} view
 * @returns {Trace}
 */
function decodeTrace(buffer, view) {
  const channels = view.getUint32(40, true);
  const columns = view.getUint32(44, true);
  const low = [], high = [];
  for (let channel = 0; channel < channels; channel++) {
    low.push(new Float32Array(buffer, 48 + 4 * columns * channel, columns));
    high.push(new Float32Array(buffer, 48 + 4 * columns * (channels + channel), columns));
  }
  return {
    begin: view.getFloat64(8, true), column: view.getFloat64(16, true), trigger: view.getFloat64(24, true),
    now: view.getFloat64(32, true), low, high, status: new Uint8Array(buffer, 48 + 8 * columns * channels, columns),
  };
}
