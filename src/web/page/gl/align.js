// Measures how far the drawn artwork lies from the camera's picture, in pixels. Both are cut into
// tiles; each tile's shift, with a gain and a bias of its own, minimises the squared differences.
// Tiles that do not fit, because something is in front of the artwork, are counted, not measured.
// This measures what the page draws: whether it took the right frame's pose, its lens, and its
// motion while the rows are read. It does not judge the pose: the tracker's own tiles (used.js) fit
// even if the page draws wrongly.

/** Pixels along a tile's side. */
export const TILE = 32;
/** Pixels around a tile that a shift may reach. A larger shift does not converge. */
const MARGIN = 4;
/** Maximum iterations, and the step in pixels that ends them. */
const ROUNDS = 12;
const SETTLED = 2e-3;
/**
 * Minimum share of a tile's variance that the artwork explains; below it, the tile shows something
 * else.
 */
const EXPLAINED = 0.5;
/**
 * A tile is measured if both principal energies of its gradients exceed this, grey levels squared
 * per pixel: plain ground has no position.
 */
const LEAST_ENERGY = 12;

/**
 * @typedef {{width: number, height: number, camera: Float32Array, drawn: Float32Array, covered:
 *   Uint8Array}} Pair greys of the camera's picture and of the drawn one, rows from the top, and
 *   where the drawn one has artwork
 * @typedef {{x: number, y: number, dx: number, dy: number}} Shift of the tile whose corner is at x,
 *   y: the picture lies dx, dy from the drawn one
 * @typedef {{shifts: Shift[], unlike: number}} Alignment
 */

/** @param {Pair} pair @param {number} [most] tiles at most, evenly chosen @returns {Alignment} */
export function align(pair, most = Infinity) {
  const corners = [];
  for (let y = MARGIN; y + TILE + MARGIN <= pair.height; y += TILE) {
    for (let x = MARGIN; x + TILE + MARGIN <= pair.width; x += TILE) if (isCovered(pair, x, y)) corners.push([x, y]);
  }
  const every = Math.max(1, corners.length / most);
  const chosen = corners.filter((_, k) => Math.floor(k / every) !== Math.floor((k - 1) / every));
  /** @type {Alignment} */
  const found = { shifts: [], unlike: 0 };
  for (const [x, y] of chosen) {
    const shift = shiftOf(pair, x, y);
    if (shift === "unlike") found.unlike += 1;
    else if (shift !== "plain") found.shifts.push({ x, y, dx: shift[0], dy: shift[1] });
  }
  return found;
}

/**
 * The median and the 90th percentile of the shifts' lengths; null without any.
 * @param {Alignment} alignment
 */
export function summary({ shifts, unlike }) {
  const lengths = shifts.map(({ dx, dy }) => Math.hypot(dx, dy)).sort((a, b) => a - b);
  const at = (/** @type {number} */ share) => lengths[Math.min(lengths.length - 1, Math.floor(share * lengths.length))] ?? null;
  return { median: at(0.5), most: at(0.9), tiles: lengths.length, unlike };
}

/** @param {Pair} pair @param {number} x @param {number} y */
function isCovered({ width, covered }, x, y) {
  for (let j = y - MARGIN; j < y + TILE + MARGIN; j += 1) {
    for (let i = x - MARGIN; i < x + TILE + MARGIN; i += 1) if (covered[j * width + i] === 0) return false;
  }
  return true;
}

/**
 * Solves for the shift of the drawn tile, its gain and its bias by Gauss-Newton.
 * @param {Pair} pair
 * @param {number} x
 * @param {number} y
 * @returns {number[] | "plain" | "unlike"}
 */
function shiftOf({ width, camera, drawn }, x, y) {
  let shift = [0, 0, 1, 0];
  for (let round = 0; round < ROUNDS; round += 1) {
    // The shifted drawn tile should equal the camera's: d(u - dx, v - dy) gain + bias = c(u, v).
    const normal = new Float64Array(14);
    const [dx, dy, gain, bias] = shift;
    const [fx, fy] = [Math.floor(-dx), Math.floor(-dy)];
    const [ax, ay] = [-dx - fx, -dy - fy];
    const [sums, energies] = [[0, 0, 0], [0, 0, 0]];
    for (let j = y; j < y + TILE; j += 1) {
      for (let i = x; i < x + TILE; i += 1) {
        const at = (j + fy) * width + i + fx;
        const [p, q, r, s] = [drawn[at], drawn[at + 1], drawn[at + width], drawn[at + width + 1]];
        const value = (p * (1 - ax) + q * ax) * (1 - ay) + (r * (1 - ax) + s * ax) * ay;
        const gx = (drawn[at + 1] - drawn[at - 1]) * (1 - ax) + (drawn[at + 2] - p) * ax;
        const gy = (drawn[at + width] - drawn[at - width]) * (1 - ay) + (drawn[at + 2 * width] - p) * ay;
        const seen = camera[j * width + i];
        const off = seen - gain * value - bias;
        const row = [(-gain * gx) / 2, (-gain * gy) / 2, value, 1];
        let k = 0;
        for (let a = 0; a < 4; a += 1) for (let b = a; b < 4; b += 1) normal[k++] += row[a] * row[b];
        for (let a = 0; a < 4; a += 1) normal[10 + a] += row[a] * off;
        sums[0] += seen;
        sums[1] += seen * seen;
        sums[2] += off * off;
        energies[0] += (gx * gx) / 4;
        energies[1] += (gx * gy) / 4;
        energies[2] += (gy * gy) / 4;
      }
    }
    const pixels = TILE * TILE;
    if (round === 0 && least(energies.map((energy) => energy / pixels)) < LEAST_ENERGY) return "plain";
    const step = solve(normal);
    if (step === null) return "plain";
    shift = shift.map((value, k) => value + step[k]);
    if (!(Math.abs(shift[0]) < MARGIN - 1 && Math.abs(shift[1]) < MARGIN - 1)) return "unlike";
    if (Math.hypot(step[0], step[1]) < SETTLED) {
      const varies = sums[1] - (sums[0] * sums[0]) / pixels;
      return shift[2] > 0 && sums[2] < (1 - EXPLAINED) * varies ? shift : "unlike";
    }
  }
  return "unlike";
}

/** The smaller eigenvalue of a symmetric matrix. @param {number[]} matrix its xx, xy, yy */
function least([xx, xy, yy]) {
  return (xx + yy) / 2 - Math.hypot((xx - yy) / 2, xy);
}

/**
 * Solves four normal equations by Cholesky decomposition; null if they are singular.
 * @param {Float64Array} normal upper rows, then the right side
 */
function solve(normal) {
  const index = (/** @type {number} */ a, /** @type {number} */ b) => (a * (9 - a)) / 2 + (b - a);
  const l = [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]];
  for (let a = 0; a < 4; a += 1) {
    for (let b = 0; b <= a; b += 1) {
      let sum = normal[index(b, a)];
      for (let k = 0; k < b; k += 1) sum -= l[a][k] * l[b][k];
      if (a !== b) l[a][b] = sum / l[b][b];
      else if (sum > 1e-9 * normal[index(a, a)]) l[a][a] = Math.sqrt(sum);
      else return null;
    }
  }
  const x = Array.from(normal.subarray(10));
  for (let a = 0; a < 4; a += 1) {
    for (let k = 0; k < a; k += 1) x[a] -= l[a][k] * x[k];
    x[a] /= l[a][a];
  }
  for (let a = 3; a >= 0; a -= 1) {
    for (let k = a + 1; k < 4; k += 1) x[a] -= l[k][a] * x[k];
    x[a] /= l[a][a];
  }
  return x;
}
