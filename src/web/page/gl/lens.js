// The lens on the graphics card: the set is drawn by a pinhole that sees a little more than the
// camera, and then bent like the lens bends.
import { direction, pixel } from "../lens.js";
import { BufferAttribute, BufferGeometry, Matrix4 } from "../vendor/three.js";

/** @import { Camera } from "../types.js" */

/**
 * Cells across and down in which the bending is linear. The error within a cell is the lens'
 * curvature there: below 0.005 px for the lenses of stage cameras. Raised, there are more corners
 * per frame.
 */
const ACROSS = 128;
const DOWN = 72;
/**
 * Maximum ratio of the pinhole's picture to the camera's, along a side: a fisheye's border would
 * need any size.
 */
const MOST = 2;
/** Newton iterations that make a direction exact, and the maximum error after them, pixels. */
const ROUNDS = 4;
const EXACT = 1e-3;
/**
 * The pinhole sees this share of a side beyond the border: what the first and last rows of a shaken
 * camera see outside the middle row's view.
 */
const BESIDE = 0.02;
/** Metres between which things are drawn. */
const NEAR = 0.05;
const FAR = 200;

/**
 * @typedef {{width: number, height: number, fx: number, fy: number, cx: number, cy: number}}
 *   Pinhole the overscanned picture's own camera
 */

/**
 * The exact direction (x, y at z = 1) of a raw pixel; null if there is none: beyond the fold of the
 * lens, or if the inversion fails.
 * @param {Camera} camera
 * @param {number[]} raw
 * @returns {number[] | null}
 */
export function undistorted(camera, raw) {
  let [x, y] = direction(camera, raw);
  const free = { ...camera, valid_radius: null };
  const step = 1e-6;
  for (let k = 0; k < ROUNDS; k += 1) {
    const [at, right, down] = [[x, y], [x + step, y], [x, y + step]].map(([a, b]) => pixel(free, [a, b, 1]));
    if (at === null || right === null || down === null) return null;
    const [[a, c], [b, d]] = [right, down].map((moved) => moved.map((value, axis) => (value - at[axis]) / step));
    const [ex, ey] = [raw[0] - at[0], raw[1] - at[1]];
    const determinant = a * d - b * c;
    [x, y] = [x + (d * ex - b * ey) / determinant, y + (a * ey - c * ex) / determinant];
  }
  const back = pixel(camera, [x, y, 1]);
  return back !== null && Math.hypot(back[0] - raw[0], back[1] - raw[1]) < EXACT ? [x, y] : null;
}

/**
 * The overscanned pinhole: as fine as the camera, as wide as what its border shows.
 * @param {Camera} camera
 * @returns {Pinhole}
 */
export function pinhole(camera) {
  const shown = corners(camera).flat().filter((corner) => corner.towards !== null).map(({ towards }) => /** @type {number[]} */ (towards));
  const bounds = [0, 1].map((axis) => {
    const values = shown.map((one) => one[axis]);
    return [Math.min(...values), Math.max(...values)];
  });
  const [[left, right], [top, bottom]] = bounds;
  const [more, above] = [camera.width, camera.height].map((side) => Math.ceil(BESIDE * side));
  const sides = [camera.fx * (right - left) + 2 * more, camera.fy * (bottom - top) + 2 * above];
  const scale = Math.min(1, (MOST * camera.width) / sides[0], (MOST * camera.height) / sides[1]);
  const [fx, fy] = [camera.fx * scale, camera.fy * scale];
  return { width: Math.ceil(sides[0] * scale), height: Math.ceil(sides[1] * scale), fx, fy, cx: scale * more - 0.5 - fx * left, cy: scale * above - 0.5 - fy * top };
}

/** The grid over the raw picture, edges included. @param {Camera} camera */
function corners(camera) {
  return Array.from({ length: DOWN + 1 }, (_row, j) =>
    Array.from({ length: ACROSS + 1 }, (_cell, i) => {
      const raw = [(i / ACROSS) * camera.width - 0.5, (j / DOWN) * camera.height - 0.5];
      return { raw, towards: undistorted(camera, raw) };
    }),
  );
}

/**
 * The mesh that applies the lens: `position` in the picture (-1 to 1, up), `raw` within the
 * camera's picture (0 to 1, down), `towards` the direction there (x, y at z = 1). Cells that the
 * lens does not show completely are omitted.
 * @param {Camera} camera
 */
export function bending(camera) {
  const grid = corners(camera);
  const [position, raw, towards] = /** @type {number[][]} */ ([[], [], []]);
  for (let j = 0; j < DOWN; j += 1) {
    for (let i = 0; i < ACROSS; i += 1) {
      const cell = [grid[j][i], grid[j + 1][i], grid[j + 1][i + 1], grid[j][i + 1]];
      if (cell.some((corner) => corner.towards === null)) continue;
      for (const corner of [cell[0], cell[1], cell[2], cell[0], cell[2], cell[3]]) {
        const [u, v] = [(corner.raw[0] + 0.5) / camera.width, (corner.raw[1] + 0.5) / camera.height];
        position.push(2 * u - 1, 1 - 2 * v, 0);
        raw.push(u, v);
        towards.push(.../** @type {number[]} */ (corner.towards));
      }
    }
  }
  const mesh = new BufferGeometry();
  for (const [name, values] of Object.entries({ position, raw, towards })) mesh.setAttribute(name, new BufferAttribute(new Float32Array(values), name === "position" ? 3 : 2));
  return mesh;
}

/** The pinhole as the graphics card has it: it looks along -z, y is up. @param {Pinhole} of */
export function projection({ width, height, fx, fy, cx, cy }) {
  const [across, up] = [1 - (2 * (cx + 0.5)) / width, (2 * (cy + 0.5)) / height - 1];
  // prettier-ignore
  return new Matrix4(
    (2 * fx) / width, 0, across, 0,
    0, (2 * fy) / height, up, 0,
    0, 0, -(FAR + NEAR) / (FAR - NEAR), (-2 * FAR * NEAR) / (FAR - NEAR),
    0, 0, -1, 0,
  );
}
