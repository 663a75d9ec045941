// Where a model is, how large, and which way is up.

/** Eigenvectors of a symmetric 3×3 matrix by Jacobi rotations, least eigenvalue first. */
export function eigenvectors(matrix) {
  const a = matrix.map((row) => [...row]);
  const v = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 30; sweep++) {
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
      if (Math.abs(a[p][q]) < 1e-15) continue;
      const theta = 0.5 * Math.atan2(2 * a[p][q], a[q][q] - a[p][p]);
      const [c, s] = [Math.cos(theta), Math.sin(theta)];
      for (let k = 0; k < 3; k++) [a[k][p], a[k][q]] = [c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]];
      for (let k = 0; k < 3; k++) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
      for (let k = 0; k < 3; k++) [v[k][p], v[k][q]] = [c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]];
    }
  }
  return [0, 1, 2].sort((i, j) => a[i][i] - a[j][j]).map((i) => v.map((row) => row[i]));
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const norm = (a) => Math.sqrt(dot(a, a));
const minus = (a, b) => a.map((v, i) => v - b[i]);
const mean = (all) => [0, 1, 2].map((a) => all.reduce((sum, p) => sum + p[a], 0) / Math.max(1, all.length));
/** Cosine of the angle up to which axes count as pointing one way: 25°. */
const AGREE = 0.906;

/** Mean of the directions to some points; its length is 1 where all lie one way, 0 all around. */
export function directionOf(points) {
  return mean(points.map((p) => p.map((v) => v / (norm(p) || 1))));
}

/**
 * Centre, radius, up, extent along it and some points of a model, and from where it was seen. Its
 * scans are `{sample, pose, viewpoint}`: points and the sensor in the scan's frame, `pose` 4×4 row by row.
 */
export function frameOf(scans) {
  const moved = (pose, p) => [0, 1, 2].map((r) => dot(pose[r], p) + pose[r][3]);
  const points = scans.flatMap(({ sample, pose }) => sample.map((p) => moved(pose, p)));
  const n = Math.max(1, points.length);
  const centre = [0, 1, 2].map((a) => points.reduce((sum, p) => sum + p[a], 0) / n);
  const off = points.map((p) => minus(p, centre));
  // A few stray points must not make everything else small.
  const distances = off.map(norm).sort((a, b) => a - b);
  const radius = Math.max(1e-6, distances[Math.floor(0.97 * (distances.length - 1))] ?? 1);
  const up = upOf(scans, off, n);
  const heights = off.map((p) => dot(p, up)).sort((a, b) => a - b);
  const at = (q) => heights[Math.round(q * (heights.length - 1))] ?? 0;
  const seenFrom = [0, 1, 2].map((a) => scans.reduce((sum, s) => sum + moved(s.pose, s.viewpoint)[a] - centre[a], 0) / Math.max(1, scans.length));
  return { centre, radius, up, low: at(0.002), high: at(0.998), points: off, seenFrom };
}

/**
 * Scanners are mostly held or mounted upright: an axis that points one way in most scans is up.
 * Cameras look along z with y down; others have the axis itself up. Where no axis agrees, rooms
 * extend least in height.
 */
function upOf(scans, off, n) {
  let best = { count: 0 };
  for (const a of [2, 1, 0]) {
    const all = scans.map(({ pose }) => [0, 1, 2].map((r) => pose[r][a]));
    for (const axis of all) {
      const count = all.filter((other) => dot(axis, other) > AGREE).length;
      if (count > best.count) best = { count, axis: mean(all.filter((other) => dot(axis, other) > AGREE)), a };
    }
  }
  if (scans.length < 3 || best.count < 0.55 * scans.length) {
    const least = eigenvectors([0, 1, 2].map((r) => [0, 1, 2].map((c) => off.reduce((s, p) => s + p[r] * p[c], 0) / n)))[0];
    return least[least.map(Math.abs).indexOf(Math.max(...least.map(Math.abs)))] < 0 ? least.map((v) => -v) : least;
  }
  const ahead = directionOf(scans.flatMap((s) => s.sample));
  const camera = best.a === 1 && ahead[2] > 0.7 * norm(ahead);
  return best.axis.map((v) => (camera ? -v : v) / norm(best.axis));
}
