// Signals of the page: the amplitude spectrum of readings, and the transmissibility by lock-in.

/**
 * Return amplitudes by a fast Fourier transform with Hann's window.
 * @param {Float64Array} values as many as a power of two @returns {Float32Array} peak amplitudes up to half the rate
 */
export function spectrum(values) {
  const n = values.length, re = new Float64Array(n), im = new Float64Array(n);
  const mean = values.reduce((sum, one) => sum + one, 0) / n;
  for (let i = 0, j = 0; i < n; i++) {
    re[j] = (values[i] - mean) * (1 - Math.cos(2 * Math.PI * i / n));
    let bit = n >> 1;
    while (bit && j & bit) { j ^= bit; bit >>= 1; }
    j |= bit;
  }
  for (let size = 2; size <= n; size *= 2) {
    const half = size / 2;
    for (let k = 0; k < half; k++) {
      const c = Math.cos(2 * Math.PI * k / size), s = -Math.sin(2 * Math.PI * k / size);
      for (let i = k; i < n; i += size) {
        const a = re[i + half] * c - im[i + half] * s, b = re[i + half] * s + im[i + half] * c;
        re[i + half] = re[i] - a; im[i + half] = im[i] - b;
        re[i] += a; im[i] += b;
      }
    }
  }
  return Float32Array.from({ length: n / 2 }, (_, i) => 2 * Math.hypot(re[i], im[i]) / n);
}

/** Return the amplitude of one frequency over whole cycles. @param {Float64Array} values @param {number} cyclesPerScan */
function amplitude(values, cyclesPerScan) {
  let a = 0, b = 0;
  values.forEach((value, i) => {
    a += value * Math.cos(2 * Math.PI * cyclesPerScan * i);
    b += value * Math.sin(2 * Math.PI * cyclesPerScan * i);
  });
  return 2 * Math.hypot(a, b) / values.length;
}

/**
 * Return |X_1| / |X_b| of the fundamentals.
 * @param {Float64Array} structure @param {Float64Array} base readings over whole cycles @param {number} cyclesPerScan
 */
export function transmissibility(structure, base, cyclesPerScan) {
  return amplitude(structure, cyclesPerScan) / amplitude(base, cyclesPerScan);
}
