// Moves corners to where the edges of the surface meet. Along each side the strongest edge near it
// is found and a curve laid through most of it: a lens bends straight edges. Corners are where two
// curves meet.

/** @typedef {{grey: Float32Array | Uint8ClampedArray, width: number, height: number}} Grey */
/**
 * @typedef {{t: number, s: number, strength: number}} Found a point of an edge: along, and across
 */
/**
 * @typedef {{from: number[], along: number[], across: number[], bend: number[], sigma: number}}
 *   Side
 *   its direction (the side's whole length), its normal (1 px), the curve's polynomial across, and
 *   how well the curve is known, pixels
 */

/** Points that are looked at along a side, and the share of it at each end that is left out. */
const [POINTS, ENDS] = [64, 0.04];
/**
 * Pixels to each side that an edge is looked for, and between two samples. Raised, others are
 * found.
 */
const [REACH, STEP] = [8, 0.5];
/** Grey levels over two pixels that are an edge. Raised, faint edges are missed. */
const FAINT = 6;
/** Pixels within which points agree with a line, and then with the curve. */
const [LINE, CURVE] = [1.5, 0.7];
/** The share of a side's points that must agree. Lowered, chance edges pass. */
const AGREE = 0.4;
/** Rounds in which two curves' meeting point settles. */
const ROUNDS = 6;

/** @param {Grey} of @param {number} x @param {number} y */
function level({ grey, width, height }, x, y) {
  const [left, top] = [Math.floor(x), Math.floor(y)];
  if (left < 0 || top < 0 || left + 1 >= width || top + 1 >= height) return null;
  const at = top * width + left;
  const [u, v] = [x - left, y - top];
  return (1 - v) * ((1 - u) * grey[at] + u * grey[at + 1]) + v * ((1 - u) * grey[at + width] + u * grey[at + width + 1]);
}

/**
 * The strongest edge across a point.
 * @param {Grey} of
 * @param {number[]} at
 * @param {number[]} across
 * @returns {{s: number, strength: number} | null}
 */
function strongest(of, [x, y], [nx, ny]) {
  const count = Math.round((2 * REACH) / STEP) + 1;
  const steps = Array.from({ length: count }, (_, k) => {
    const s = k * STEP - REACH;
    const [before, behind] = [level(of, x + (s - 1) * nx, y + (s - 1) * ny), level(of, x + (s + 1) * nx, y + (s + 1) * ny)];
    return before === null || behind === null ? 0 : Math.abs(behind - before);
  });
  let best = 0;
  for (let k = 1; k + 1 < count; k += 1) if (steps[k] > steps[best] && steps[k] >= steps[k - 1] && steps[k] >= steps[k + 1]) best = k;
  if (best === 0 || steps[best] < FAINT) return null;
  const [before, here, behind] = [steps[best - 1], steps[best], steps[best + 1]];
  const curved = before - 2 * here + behind;
  return { s: (best + (curved < 0 ? (0.5 * (before - behind)) / curved : 0)) * STEP - REACH, strength: here };
}

/** Those points that agree with the line that most agree with. @param {Found[]} points */
function onOneLine(points) {
  /** @type {Found[]} */
  let most = [];
  for (let i = 0; i < points.length; i += 1) {
    for (let j = i + 8; j < points.length; j += 3) {
      const slope = (points[j].s - points[i].s) / (points[j].t - points[i].t);
      const agree = points.filter(({ t, s }) => Math.abs(s - points[i].s - slope * (t - points[i].t)) < LINE);
      if (agree.length > most.length) most = agree;
    }
  }
  return most;
}

/**
 * The parabola of least squares through points.
 * @param {Found[]} points
 * @returns {number[] | null}
 */
function parabola(points) {
  const sum = (/** @type {number} */ power, /** @type {boolean} */ withS) => points.reduce((all, { t, s }) => all + t ** power * (withS ? s : 1), 0);
  const rows = [0, 1, 2].map((row) => [sum(row, false), sum(row + 1, false), sum(row + 2, false), sum(row, true)]);
  for (let k = 0; k < 3; k += 1) {
    if (Math.abs(rows[k][k]) < 1e-9) return null;
    for (let row = 0; row < 3; row += 1) {
      if (row === k) continue;
      const by = rows[row][k] / rows[k][k];
      rows[row] = rows[row].map((value, column) => value - by * rows[k][column]);
    }
  }
  return rows.map((row, k) => row[3] / row[k]);
}

/** @param {number[]} bend @param {number} t */
const across = ([a, b, c], t) => a + t * (b + t * c);

/**
 * The edge along a side; null if there is none.
 * @param {Grey} of
 * @param {number[]} from
 * @param {number[]} to
 * @returns {Side | null}
 */
function edge(of, from, to) {
  const along = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(...along);
  if (length < 4 * REACH) return null;
  const normal = [-along[1] / length, along[0] / length];
  const points = Array.from({ length: POINTS }, (_, k) => ENDS + ((1 - 2 * ENDS) * k) / (POINTS - 1)).flatMap((t) => {
    const found = strongest(of, [from[0] + t * along[0], from[1] + t * along[1]], normal);
    return found === null ? [] : [{ t, ...found }];
  });
  let agree = onOneLine(points);
  /** @type {number[] | null} */
  let bend = null;
  for (const within of [LINE, CURVE, CURVE]) {
    bend = agree.length < 6 ? null : parabola(agree);
    if (bend === null) return null;
    const curve = bend;
    agree = points.filter(({ t, s }) => Math.abs(s - across(curve, t)) < within);
  }
  if (bend === null || agree.length < AGREE * POINTS) return null;
  const curve = bend;
  const rms = Math.sqrt(agree.reduce((sum, { t, s }) => sum + (s - across(curve, t)) ** 2, 0) / agree.length);
  // At its ends a parabola is known three times worse than in its middle.
  return { from, along, across: normal, bend: curve, sigma: (3 * rms) / Math.sqrt(agree.length) };
}

/** Where two sides meet, near a corner. @param {Side} a @param {Side} b @param {number[]} near */
function meet(a, b, near) {
  let corner = near;
  for (let round = 0; round < ROUNDS; round += 1) {
    const [p, q] = [a, b].map((side) => {
      const [dx, dy] = [corner[0] - side.from[0], corner[1] - side.from[1]];
      const t = (dx * side.along[0] + dy * side.along[1]) / (side.along[0] ** 2 + side.along[1] ** 2);
      const s = across(side.bend, t);
      const slope = side.bend[1] + 2 * t * side.bend[2];
      return {
        at: [0, 1].map((axis) => side.from[axis] + t * side.along[axis] + s * side.across[axis]),
        way: [0, 1].map((axis) => side.along[axis] + slope * side.across[axis]),
      };
    });
    const det = p.way[0] * q.way[1] - p.way[1] * q.way[0];
    if (Math.abs(det) < 1e-6) return null;
    const by = ((q.at[0] - p.at[0]) * q.way[1] - (q.at[1] - p.at[1]) * q.way[0]) / det;
    corner = [p.at[0] + by * p.way[0], p.at[1] + by * p.way[1]];
  }
  return corner;
}

/**
 * The corners where the edges near these sides meet, with one sigma of each, pixels; null for a
 * corner of which a side shows no edge.
 * @param {Grey} of
 * @param {number[][]} corners
 * @returns {({at: number[], sigma: number} | null)[]}
 */
export function snapped(of, corners) {
  const sides = corners.map((corner, k) => edge(of, corner, corners[(k + 1) % corners.length]));
  return corners.map((corner, k) => {
    const [before, behind] = [sides[(k + corners.length - 1) % corners.length], sides[k]];
    const at = before && behind ? meet(before, behind, corner) : null;
    const isNear = at !== null && Math.hypot(at[0] - corner[0], at[1] - corner[1]) < 2 * REACH;
    return at !== null && isNear && before && behind ? { at, sigma: Math.hypot(before.sigma, behind.sigma) } : null;
  });
}
