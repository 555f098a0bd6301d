// Poses and the lens: where a camera shows points of the stage. Conventions: docs/glossary.md.

/** @import { Camera } from "./types.js" */

/** A vector turned by a unit quaternion. @param {number[]} q x, y, z, w @param {number[]} v */
export function turn([x, y, z, w], [a, b, c]) {
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
}

/**
 * A point of a body in the frame that its pose is in.
 * @param {{position_m: number[], orientation_xyzw: number[]}} pose
 * @param {number[]} point
 */
export function place(pose, point) {
  const turned = turn(pose.orientation_xyzw, point);
  return turned.map((value, axis) => value + pose.position_m[axis]);
}

/**
 * A point in the frame of a body.
 * @param {{position_m: number[], orientation_xyzw: number[]}} pose
 * @param {number[]} point
 */
export function within(pose, point) {
  const [x, y, z, w] = pose.orientation_xyzw;
  return turn([-x, -y, -z, w], point.map((value, axis) => value - pose.position_m[axis]));
}

/**
 * Pan, tilt and roll of a camera, degrees: zero for a level one that looks upstage, positive to the
 * left, up, and clockwise as its operator sees it.
 * @param {number[]} q its orientation
 */
export function panTiltRoll(q) {
  const [right, forward, up] = [turn(q, [1, 0, 0]), turn(q, [0, 0, 1]), turn(q, [0, -1, 0])];
  const radians = [Math.atan2(-forward[0], forward[1]), Math.atan2(forward[2], Math.hypot(forward[0], forward[1])), Math.atan2(-right[2], up[2])];
  return radians.map((angle) => (angle * 180) / Math.PI);
}

/** Nearer points than this, metres, are not drawn: they are beside or behind the lens. */
const NEAR_M = 0.01;

/**
 * The raw pixel of a point in the camera's frame; null if the lens shows none.
 * @param {Camera} camera
 * @param {number[]} point
 */
export function pixel(camera, [x, y, z]) {
  if (!(z > NEAR_M)) return null;
  const [a, b] = [x / z, y / z];
  const r2 = a * a + b * b;
  // Further out the formula folds back into the picture.
  if (camera.valid_radius !== null && r2 > camera.valid_radius ** 2) return null;
  const [k1, k2, p1, p2, k3] = camera.distortion;
  const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const dx = radial * a + 2 * p1 * a * b + p2 * (r2 + 2 * a * a);
  const dy = radial * b + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b;
  return [camera.fx * (dx + camera.skew * dy) + camera.cx, camera.fy * dy + camera.cy];
}

/**
 * Iterations that invert the lens. Each removes at least nine tenths of the error unless the
 * formula folds.
 */
const ROUNDS = 20;

/**
 * The direction (x, y at z = 1) that the lens shows at a raw pixel: for drawing, not measuring.
 * @param {Camera} camera
 * @param {number[]} seen
 */
export function direction(camera, [u, v]) {
  const dy = (v - camera.cy) / camera.fy;
  const dx = (u - camera.cx) / camera.fx - camera.skew * dy;
  let [x, y] = [dx, dy];
  for (let k = 0; k < ROUNDS; k += 1) {
    const shown = pixel({ ...camera, fx: 1, fy: 1, cx: 0, cy: 0, skew: 0, valid_radius: null }, [x, y, 1]) ?? [x, y];
    [x, y] = [x + dx - shown[0], y + dy - shown[1]];
  }
  return [x, y];
}
