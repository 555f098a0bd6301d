// The view of the stage in 3D. The projection is parallel, as in a stage plan: lengths along one
// direction have the same scale everywhere, and a covariance's outline is an ellipse.

/**
 * @typedef {{azimuth: number, elevation: number, zoom: number}} View radians; 0, 0 looks upstage
 *   from the house; zoom 1 shows all
 */

/** From the house, a little from the left and from above. @type {View} */
export const FIRST = { azimuth: 0.6, elevation: 0.45, zoom: 1 };
/** A step by key or button, radians and as a factor. */
const TURN = Math.PI / 24;
const NEARER = 1.25;
/** The closest and the farthest, by zoom. */
const MOST_ZOOM = 20;
const LEAST_ZOOM = 0.2;

/** What buttons and keys do with the view. */
export const STEPS = [
  { key: "ArrowLeft", sign: "←", does: "rotate left", by: { azimuth: -TURN } },
  { key: "ArrowRight", sign: "→", does: "rotate right", by: { azimuth: TURN } },
  { key: "ArrowUp", sign: "↑", does: "view from higher up", by: { elevation: TURN } },
  { key: "ArrowDown", sign: "↓", does: "view from lower down", by: { elevation: -TURN } },
  { key: "+", sign: "+", does: "nearer", by: { zoom: NEARER } },
  { key: "-", sign: "−", does: "farther", by: { zoom: 1 / NEARER } },
];

/**
 * The view after a step; it never goes over the top.
 * @param {View} view
 * @param {{azimuth?: number, elevation?: number, zoom?: number}} by
 * @returns {View}
 */
export function stepped(view, { azimuth = 0, elevation = 0, zoom = 1 }) {
  const within = (/** @type {number} */ value, /** @type {number} */ least, /** @type {number} */ most) => Math.min(most, Math.max(least, value));
  return {
    azimuth: view.azimuth + azimuth,
    elevation: within(view.elevation + elevation, -Math.PI / 2, Math.PI / 2),
    zoom: within(view.zoom * zoom, LEAST_ZOOM, MOST_ZOOM),
  };
}

/**
 * The drawing's directions in the stage: right, up, and away from the viewer.
 * @param {View} view
 */
export function axes({ azimuth, elevation }) {
  const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
  return { right: [ca, -sa, 0], up: [sa * se, ca * se, ce], away: [sa * ce, ca * ce, -se] };
}

/** @param {number[]} a @param {number[]} b */
export function dot(a, b) {
  return a.reduce((sum, value, k) => sum + value * b[k], 0);
}

/**
 * Projects a position's covariance: the half axes of the one-sigma ellipse, and the angle of the
 * longer one, from right to up.
 * @param {number[][]} covariance three rows, square metres
 * @param {{right: number[], up: number[]}} axes
 */
export function ellipse(covariance, { right, up }) {
  const by = (/** @type {number[]} */ a, /** @type {number[]} */ b) => dot(a, covariance.map((row) => dot(row, b)));
  const [xx, xy, yy] = [by(right, right), by(right, up), by(up, up)];
  const [mean, spread] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  return { long: Math.sqrt(mean + spread), short: Math.sqrt(Math.max(0, mean - spread)), turned: Math.atan2(2 * xy, xx - yy) / 2 };
}
