// Formatting of numbers, and the scales of plots; independent of the page.

/** @param {number | null | undefined} value @param {number} digits after the point @returns {string} */
export function fixed(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text; // no negative zero
}

/** @param {number} seconds @returns {string} e.g. 12.3 s, 4:05.2, 1:02:03 */
export function clock(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  const s = Math.round(Math.abs(seconds) * 10) / 10;
  const sign = seconds < 0 && s > 0 ? "−" : "";
  if (s < 100) return `${sign}${s.toFixed(1)} s`;
  const h = Math.floor(s / 3600), m = Math.floor((s % 3600) / 60), rest = s % 60;
  if (h) return `${sign}${h}:${String(m).padStart(2, "0")}:${String(Math.floor(rest)).padStart(2, "0")}`;
  return `${sign}${m}:${rest.toFixed(1).padStart(4, "0")}`;
}

const PREFIXES = [[1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];

/** @param {number} value @param {string} unit @param {number} [digits] significant @returns {string} e.g. 5.85 mm */
export function engineering(value, unit, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return `0 ${unit}`;
  const size = Math.abs(value);
  const [factor, prefix] = PREFIXES.find(([f]) => size >= /** @type {number} */ (f) * 0.9995) ?? PREFIXES[PREFIXES.length - 1];
  return `${(value / /** @type {number} */ (factor)).toPrecision(digits)} ${prefix}${unit}`;
}

/**
 * A value with its expanded uncertainty, both to the second significant digit of 2u.
 * @param {number} value @param {number} u standard uncertainty
 * @returns {[string, string]} value and "± 2u"
 */
export function withUncertainty(value, u) {
  if (!Number.isFinite(value)) return ["–", ""];
  if (!(u > 0) || !Number.isFinite(u)) return [value.toPrecision(4), ""];
  const exponent = Number((2 * u).toExponential(1).split("e")[1]);
  const step = 10 ** Math.max(0, exponent - 1);
  const rounded = (/** @type {number} */ x) => (Math.round(x / step) * step).toFixed(0);
  if (exponent >= 1) return [rounded(value), `± ${rounded(2 * u)}`];
  const digits = Math.min(100, 1 - exponent);
  return [value.toFixed(digits), `± ${(2 * u).toFixed(digits)}`];
}

/**
 * Stable limits of an axis: they grow at once and shrink only when half is empty.
 * @param {[number, number] | null} before @param {number} low @param {number} high
 * @returns {[number, number]}
 */
export function limits(before, low, high) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return before ?? [-1, 1];
  const middle = (low + high) / 2;
  const half = Math.max((high - low) / 2, 1e-9, Math.abs(middle) * 1e-6) * 1.15;
  const wanted = /** @type {[number, number]} */ ([middle - half, middle + half]);
  if (!before) return wanted;
  const fits = before[0] <= low && before[1] >= high;
  return fits && before[1] - before[0] < 4 * half ? before : wanted;
}

/** @param {number} amplitude @returns {number} decibels relative to 1 SI unit, at least -240 */
export function decibel(amplitude) { return 20 * Math.log10(Math.max(amplitude, 1e-12)); }

/**
 * Interleave minima and maxima into one line that goes through both in every column.
 * @param {Float32Array} low @param {Float32Array} high @param {number} column length of a column
 * @returns {[number[], (number | null)[]]} abscissa and ordinate
 */
export function line(low, high, column) {
  const x = new Array(2 * low.length), y = new Array(2 * low.length);
  for (let i = 0; i < low.length; i++) {
    x[2 * i] = (i + 0.25) * column;
    x[2 * i + 1] = (i + 0.75) * column;
    const known = low[i] === low[i];
    const falls = i > 0 && high[i - 1] > high[i];
    y[2 * i] = known ? (falls ? high[i] : low[i]) : null;
    y[2 * i + 1] = known ? (falls ? low[i] : high[i]) : null;
  }
  return [x, y];
}

/**
 * Frequencies of a sweep.
 * @param {number} from @param {number} to @param {number} points
 * @returns {number[]}
 */
export function steps(from, to, points) {
  const n = Math.max(1, Math.round(points));
  if (n === 1) return [from];
  return Array.from({ length: n }, (_, i) => Number((from + (to - from) * i / (n - 1)).toFixed(6)));
}
