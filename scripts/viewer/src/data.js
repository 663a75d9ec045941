// The data that scanweave put into the page (src/report/html/data.rs), and questions about it.

function bytes(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

/** Typed arrays of a scan's points. */
export function pointsOf(scan) {
  const p = scan.points;
  const xyz = bytes(p.xyz);
  return {
    count: p.count,
    low: p.low,
    size: p.size,
    xyz: new Uint16Array(xyz.buffer),
    rgb: p.rgb === null ? null : bytes(p.rgb),
    residual: p.residual === null ? null : bytes(p.residual),
  };
}

export function readData() {
  const element = document.getElementById('data');
  const data = JSON.parse(element.textContent);
  element.textContent = '';
  data.similarity = data.similarity === null ? null : bytes(data.similarity);
  data.lastStep = data.components.map((c) => Math.max(...c.scans.map((s) => data.scans[s].placed.step)));
  return data;
}

/** Predicted overlap of two scans in [0, 1], or null. */
export function predicted(data, i, j) {
  return data.similarity === null ? null : data.similarity[i * data.scans.length + j] / 255;
}

/** Overlap of two placed scans at the final poses; 0 where both are placed together and do not
 *  touch, null where it cannot be known. */
export function verified(data, i, j) {
  const [a, b] = [data.scans[i].placed, data.scans[j].placed];
  if (!a || !b || a.component !== b.component) return null;
  const found = a.neighbours.find((n) => n.scan === j) ?? b.neighbours.find((n) => n.scan === i);
  return found ? found.overlap : 0;
}

/** Overlap of a scan with its parent, else the largest with any scan. */
export function overlapOf(scan) {
  const all = scan.placed.neighbours;
  const ofParent = all.find((n) => n.scan === scan.placed.parent);
  if (ofParent) return ofParent.overlap;
  return all.length ? Math.max(...all.map((n) => n.overlap)) : null;
}

/** A length with the unit that suits it. */
export function length(m) {
  if (m === null || m === undefined) return '';
  const size = Math.abs(m);
  if (size >= 1) return `${m.toFixed(2)} m`;
  if (size >= 0.01) return `${(100 * m).toFixed(1)} cm`;
  return `${(1000 * m).toFixed(2)} mm`;
}

export function share(v) {
  return v === null || v === undefined ? '' : v.toFixed(2);
}

export function counted(n, one) {
  return `${n.toLocaleString('en')} ${one}${n === 1 ? '' : 's'}`;
}
