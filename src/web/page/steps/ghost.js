// The origin in the live picture: a cube of one metre that stands on it and faces the audience, and
// a click on a surface or on the floor that moves it there.
import { computed } from "../vendor/signals.js";
import { head, scene } from "../daemon.js";
import { direction, pixel, place, turn, within } from "../lens.js";
import { emptied } from "../ui.js";
import { isTracking } from "./force.js";
import { change, draft } from "./draft.js";
import { axes } from "./placing.js";

/** @import { Head, Pose, Surface } from "../types.js" */

/** Its edges are drawn as this many pieces each: a lens bends them. */
const PIECES = 8;
/** Corners of the cube, metres from the origin: it stands on it, and centred. */
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [(k & 1) - 0.5, ((k >> 1) & 1) - 0.5, k >> 2]);
const EDGES = CORNERS.flatMap((a, i) => CORNERS.flatMap((b, j) => (i < j && a.filter((value, axis) => value !== b[axis]).length === 1 ? [[a, b]] : [])));

/** What a click in the live picture does now; null while the stage is not tracked. */
export const clicking = computed(() => {
  if (scene.value === null || !isTracking.value) return "Once the stage is tracked (step 6), a cube of one metre stands on the origin in the live picture, and a click moves it.";
  return "The cube of one metre stands on the origin. Click a point of a surface or of the floor in the live picture to move it there.";
});

/**
 * A point of the draft's stage in the stage that is tracked now.
 * @param {number[]} point
 */
function asTracked([a, b, c]) {
  const by = axes(draft.value);
  const first = scene.value?.stage.surfaces[0];
  if (by === null || first === undefined) return null;
  const d = [a - by.centre[0], b - by.centre[1], c - by.centre[2]];
  const dot = (/** @type {number[]} */ u) => u[0] * d[0] + u[1] * d[1] + u[2] * d[2];
  // Along the surface, up it, and out of its front.
  const out = [by.x[1] * by.y[2] - by.x[2] * by.y[1], by.x[2] * by.y[0] - by.x[0] * by.y[2], by.x[0] * by.y[1] - by.x[1] * by.y[0]];
  return place(first.pose, [dot(by.x), dot(by.y), dot(out)]);
}

/** Draws the cube. @param {HTMLCanvasElement} on @param {Head} said */
export function drawCube(on, said) {
  const drawn = emptied(on);
  const [camera, pose] = [scene.value?.camera, said.record.pose];
  if (!drawn || !camera || !pose || asTracked([0, 0, 0]) === null) return;
  const { context, width, colour } = drawn;
  const scale = width / said.size[0];
  const seen = (/** @type {number[]} */ point) => pixel(camera, within(pose, asTracked(point) ?? point));
  const line = new Path2D();
  for (const [from, to] of EDGES) {
    let isOpen = false;
    for (let k = 0; k <= PIECES; k += 1) {
      const at = seen(from.map((value, axis) => value + ((to[axis] - value) * k) / PIECES));
      if (at === null) {
        isOpen = false;
        continue;
      }
      const [x, y] = at.map((value) => (value + 0.5) * scale);
      if (isOpen) line.lineTo(x, y);
      else line.moveTo(x, y);
      isOpen = true;
    }
  }
  for (const [stroke, wide] of /** @type {const} */ ([["rgb(0 0 0 / 55%)", 5], [colour("accent"), 2.5]])) {
    context.strokeStyle = stroke;
    context.lineWidth = wide * devicePixelRatio;
    context.stroke(line);
  }
}

/**
 * Where the ray through a pixel meets the nearest surface, or else the floor of the draft; null if it
 * meets neither. In the stage that is tracked now.
 * @param {Pose} pose
 * @param {number[]} at raw pixel
 */
function met(pose, at) {
  const known = scene.value;
  if (known === null) return null;
  const [x, y] = direction(known.camera, at);
  const ray = turn(pose.orientation_xyzw, [x, y, 1]);
  const along = (/** @type {number} */ far) => ray.map((value, axis) => pose.position_m[axis] + far * value);
  const hits = known.stage.surfaces.map((surface) => meets(surface, pose.position_m, ray)).filter((far) => far !== null);
  if (hits.length > 0) return along(Math.min(...hits));
  // The floor: three points of the draft's, as they are tracked.
  const [o, a, b] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]].map((point) => asTracked(point));
  if (!o || !a || !b) return null;
  const [u, v] = [a.map((value, axis) => value - o[axis]), b.map((value, axis) => value - o[axis])];
  const up = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const dot = (/** @type {number[]} */ w) => up[0] * w[0] + up[1] * w[1] + up[2] * w[2];
  const far = dot(o.map((value, axis) => value - pose.position_m[axis])) / dot(ray);
  return far > 0 ? along(far) : null;
}

/**
 * How far along a ray a surface is met within its sides; null if it is not. Bent ones count as flat.
 * @param {Surface} surface
 * @param {number[]} from
 * @param {number[]} ray
 */
function meets({ pose, size_m: [width, height] }, from, ray) {
  const [start, end] = [within(pose, from), within(pose, from.map((value, axis) => value + ray[axis]))];
  const far = start[2] / (start[2] - end[2]);
  const [x, y] = [0, 1].map((axis) => start[axis] + far * (end[axis] - start[axis]));
  return far > 0 && Math.abs(x) <= width / 2 && Math.abs(y) <= height / 2 ? far : null;
}

/** Digits of metres that a click gives: a tenth of a millimetre. */
const DIGITS = 4;

/**
 * Moves the origin to where a click in the live picture meets the stage.
 * @param {MouseEvent} event
 */
export function moveThere(event) {
  const said = head.peek();
  const pose = said?.record.pose;
  if (!said || !pose || !isTracking.peek()) return;
  const box = /** @type {HTMLElement} */ (event.currentTarget).getBoundingClientRect();
  const at = [event.clientX - box.left, event.clientY - box.top].map((value) => (value * said.size[0]) / box.width - 0.5);
  const point = met(pose, at);
  if (point !== null) moveTo(point);
}

/** Makes a point of the tracked stage the origin; the axes stay. @param {number[]} point */
function moveTo(point) {
  const by = axes(draft.peek());
  const known = scene.peek();
  if (by === null || known === null) return;
  // The point in the surface, and from there in the draft's stage.
  const [x, y, out] = within(known.stage.surfaces[0].pose, point);
  const front = [by.x[1] * by.y[2] - by.x[2] * by.y[1], by.x[2] * by.y[0] - by.x[0] * by.y[2], by.x[0] * by.y[1] - by.x[1] * by.y[0]];
  const there = by.centre.map((value, axis) => value + x * by.x[axis] + y * by.y[axis] + out * front[axis]);
  const text = (/** @type {number} */ value) => `${Number(value.toFixed(DIGITS))}`;
  const { origin, at, points } = draft.peek();
  const moved = (/** @type {string[]} */ texts) => texts.map((typed, axis) => text(Number(typed.replace(",", ".")) - there[axis]));
  if (origin === "point") change({ at: moved(at) });
  else change({ points: points.map((one) => ({ ...one, at: moved(one.at) })) });
}
