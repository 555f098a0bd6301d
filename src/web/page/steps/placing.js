// Where the first surface is in the stage: from a point and a turn, or from three measured points.
// Upright surfaces only: x to the surface's right, y up it, from its centre, metres.
import { size } from "./sides.js";
import { number } from "./lengths.js";

/** @import { Draft } from "./draft.js" */
/** @typedef {{name: string, at: number[]}} Placed a point of the surface, and where it is */

/** Points of a surface by their names in the config: shares of width and height from the centre. */
export const POINTS = [
  { name: "bottom", title: "Centre of its bottom edge", at: [0, -0.5] },
  { name: "bottom left", title: "Bottom left corner", at: [-0.5, -0.5] },
  { name: "bottom right", title: "Bottom right corner", at: [0.5, -0.5] },
  { name: "centre", title: "Its centre", at: [0, 0] },
  { name: "top left", title: "Top left corner", at: [-0.5, 0.5] },
  { name: "top right", title: "Top right corner", at: [0.5, 0.5] },
  { name: "top", title: "Centre of its top edge", at: [0, 0.5] },
];
/** What a clicked point is called; the config has no name for it. */
export const CLICKED = "clicked";

/** @param {string} name @param {number[]} sides @param {number[] | null} clicked */
export function within(name, [width, height], clicked) {
  const at = name === CLICKED ? (clicked ?? [0.5, 0.5]).map((share, axis) => (axis === 0 ? share - 0.5 : 0.5 - share)) : (POINTS.find((one) => one.name === name)?.at ?? [0, 0]);
  return [at[0] * width, at[1] * height];
}

/** The typed numbers; null unless all are. @param {string[]} texts @returns {number[] | null} */
export function numbers(texts) {
  const values = texts.map(number);
  return values.some((value) => value === null) ? null : values.map(Number);
}

/**
 * Where a point of the surface is, for one that is placed by a point and a turn.
 * @param {{from: number[], at: number[], turn: number}} placed `from`: the point within the surface
 * @param {number[]} point
 */
function place({ from, at, turn }, [x, y]) {
  const [dx, dy] = [x - from[0], y - from[1]];
  const angle = (turn * Math.PI) / 180;
  return [at[0] + dx * Math.cos(angle), at[1] + dx * Math.sin(angle), at[2] + dy];
}

/** The three corners that say how a surface stands. */
const CORNERS = ["bottom left", "bottom right", "top left"];

/**
 * What the config says of the origin: points of the first surface with their places. Null while
 * something is not typed.
 * @param {Draft} of
 * @returns {Placed[] | null}
 */
export function placed(of) {
  if (of.origin === "points") {
    const found = of.points.map(({ point, at }) => ({ name: point, at: numbers(at) }));
    return found.every(({ at }) => at !== null) ? found.map(({ name, at }) => ({ name, at: at ?? [] })) : null;
  }
  const [at, turn, [width, height]] = [numbers(of.at), number(of.turn), size(of, 0)];
  if (at === null || turn === null) return null;
  if (turn === 0 && of.point !== CLICKED) return [{ name: of.point, at }];
  if (width === null || height === null) return null;
  const sides = [width, height];
  const by = { from: within(of.point, sides, of.clicked), at, turn };
  if (turn === 0) return [{ name: "centre", at: place(by, [0, 0]) }];
  return CORNERS.map((name) => ({ name, at: place(by, within(name, sides, null)) }));
}

/**
 * How much the places of three points contradict the sizes: the largest difference of a length, as
 * a share of it, with its points. Null where nothing can be said.
 * @param {Placed[]} points
 * @param {number[]} sides
 */
export function contradiction(points, sides) {
  let worst = /** @type {{share: number, names: string[], typed: number, known: number} | null} */ (null);
  for (const [k, a] of points.entries()) {
    for (const b of points.slice(k + 1)) {
      const [p, q] = [a, b].map(({ name }) => within(name, sides, null));
      const [known, typed] = [Math.hypot(p[0] - q[0], p[1] - q[1]), Math.hypot(...a.at.map((value, axis) => value - b.at[axis]))];
      const share = known === 0 ? Infinity : Math.abs(typed / known - 1);
      if (worst === null || share > worst.share) worst = { share, names: [a.name, b.name], typed, known };
    }
  }
  return worst;
}

/** @param {number[]} a @param {number[]} b */
const minus = (a, b) => a.map((value, axis) => value - b[axis]);
/** @param {number[]} a */
const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));
/** @param {number[]} a @param {number[]} b */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/**
 * The surface's axes in the stage and where its centre is, by the draft; null where it does not say.
 * Three points are fitted roughly: for drawing. The daemon fits them for the poses.
 * @param {Draft} of
 */
export function axes(of) {
  const points = placed(of);
  const [width, height] = size(of, 0);
  if (points === null || width === null || height === null) return null;
  const sides = [width, height];
  if (points.length < 3) return { x: [1, 0, 0], y: [0, 0, 1], centre: minus(points[0].at, [within(points[0].name, sides, null)[0], 0, within(points[0].name, sides, null)[1]]) };
  const [a, b, c] = points.map(({ name, at }) => ({ at, in: within(name, sides, null) }));
  // Two differences within the surface, and the same two in the stage.
  const [p, q] = [[b.in[0] - a.in[0], b.in[1] - a.in[1]], [c.in[0] - a.in[0], c.in[1] - a.in[1]]];
  const [u, v] = [minus(b.at, a.at), minus(c.at, a.at)];
  const det = p[0] * q[1] - p[1] * q[0];
  if (Math.abs(det) < 1e-9) return null;
  const x = unit(u.map((value, axis) => (value * q[1] - v[axis] * p[1]) / det));
  const away = u.map((value, axis) => (v[axis] * p[0] - value * q[0]) / det);
  const y = unit(cross(unit(cross(x, away)), x));
  return { x, y, centre: a.at.map((value, axis) => value - a.in[0] * x[axis] - a.in[1] * y[axis]) };
}
