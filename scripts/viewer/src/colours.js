// Colours of scans and of values, all [red, green, blue] in [0, 1].

/** A colour for every scan; hues a golden angle apart stay distinct for any number of scans.
 *  The same colours as in src/report/top_view.rs. */
export function scanColour(scan) {
  const hue = ((scan * 137.508) % 360) / 60;
  return [5, 3, 1].map((n) => {
    const k = (n + hue) % 6;
    return 0.8 * (1 - 0.75 * Math.min(1, Math.max(0, Math.min(k, 4 - k))));
  });
}

const hex = (text) => [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);
// Viridis (matplotlib, CC0) and RdYlBu (ColorBrewer): both stay readable to the colour blind.
const RAMPS = {
  order: ['#440154', '#443983', '#31688e', '#21918c', '#35b779', '#90d743', '#fde725'].map(hex),
  error: ['#2c7bb6', '#7fb8d6', '#d7e9c8', '#fee79b', '#fdae61', '#e8603c', '#c01a20'].map(hex),
};
export const GREY = [0.55, 0.55, 0.55];

/** Colour at `at` in [0, 1] of a ramp. */
export function ramp(name, at) {
  const stops = RAMPS[name];
  const place = Math.min(1, Math.max(0, at)) * (stops.length - 1);
  const low = Math.min(stops.length - 2, Math.floor(place));
  return stops[low].map((v, c) => v + (stops[low + 1][c] - v) * (place - low));
}

export const css = (rgb) => `rgb(${rgb.map((v) => Math.round(255 * v)).join(' ')})`;

export function cssRamp(name) {
  return `linear-gradient(to right, ${RAMPS[name].map(css).join(', ')})`;
}

/** Residuals are drawn up to this share of the inlier radius. */
export const MOST_RESIDUAL = 0.5;

/** Errors against the truth are drawn up to so many inlier radii. */
export const MOST_ERROR = 3;

/** Ways to colour that this data allows, as [key, name] pairs. */
export function modes(data) {
  const placed = data.scans.filter((s) => s.placed);
  const all = [['scan', 'scan'], ['step', 'growth step']];
  if (data.scans.some((s) => s.points.residual !== null)) all.push(['residual', 'distance to other scans']);
  if (placed.some((s) => typeof s.placed.evidence?.probability === 'number')) all.push(['probability', 'probability']);
  if (data.scans.some((s) => s.error)) all.push(['error', 'error against the truth']);
  if (data.scans.some((s) => s.points.rgb !== null)) all.push(['original', 'original colour']);
  return all;
}

/** The one colour of a scan in a mode; where points differ, that of points without a value. */
export function colourOf(data, scan, mode) {
  const placed = data.scans[scan].placed;
  if (mode === 'step' && placed) return ramp('order', placed.step / Math.max(1, data.lastStep[placed.component]));
  if (mode === 'probability') {
    const p = placed?.evidence?.probability;
    return typeof p === 'number' ? ramp('error', 1 - p) : GREY;
  }
  if (mode === 'error') {
    const { error } = data.scans[scan];
    return error ? ramp('error', error.translation_m / (MOST_ERROR * data.scale.inlier_radius_m)) : GREY;
  }
  if (mode === 'residual' || mode === 'original') return GREY;
  return scanColour(scan);
}
