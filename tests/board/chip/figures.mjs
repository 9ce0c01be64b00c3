// Statistics of what was measured.
const rounded = (value, digits = 2) => Number(value.toFixed(digits));

/** Number, mean, median, 99th and 99.9th percentile and largest; null without values. */
export function figures(values) {
  if (!values.length) return null;
  const sorted = Float64Array.from(values).sort();
  const share = (part) => sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * part))];
  return {
    n: sorted.length,
    mean: rounded(sorted.reduce((sum, value) => sum + value, 0) / sorted.length),
    p50: rounded(share(0.5)),
    p99: rounded(share(0.99)),
    p999: rounded(share(0.999)),
    max: rounded(sorted[sorted.length - 1]),
    min: rounded(sorted[0]),
  };
}

/** Repeatable numbers 0..1. */
export function randomNumbers(seed) {
  let state = (seed * 2654435761 + 1) >>> 0;
  return () => {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    state >>>= 0;
    return state / 2 ** 32;
  };
}

export { rounded };
