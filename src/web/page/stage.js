// The stage in 3D: surfaces, objects, the camera with its view, its path and its uncertainty.
import { computed, effect, signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { contact, head, scene } from "./daemon.js";
import { direction, place } from "./lens.js";
import { added, minute } from "./minute.js";
import { FIRST, STEPS, axes, dot, ellipse, stepped } from "./orbit.js";
import { theme } from "./theme.js";
import { amount, emptied, html } from "./ui.js";

/** From where it is seen. */
export const view = signal(FIRST);

/**
 * The ellipse shows this many sigmas of the camera's position, enlarged this many times: positions
 * are known to a millimetre or better, which no drawing of a stage shows.
 */
const SIGMAS = 3;
const ENLARGED = 100;
/** Less, where it would reach beyond this share of the drawing: after lost frames, for example. */
const WIDEST = 0.25;
/** How many times it is enlarged now. */
const enlarged = signal(ENLARGED);
/** How far the camera's pyramid reaches, as a share of the way to the stage's middle. */
const REACH = 0.35;
/** Radians that a pixel of a drag turns. */
const DRAG = 0.008;
/** Of the smaller side of the canvas, what half the stage takes up. */
const FILLS = 0.46;

/** @import { Pose, PoseRecord, State } from "./types.js" */
/** @typedef {{least: number[], most: number[]}} Bounds */
/** @typedef {(point: number[]) => number[]} Projection to pixels of the canvas */

/** @type {HTMLCanvasElement | null} */
let canvas = null;
/**
 * The bounds that are shown: the surfaces, and where the camera has been since.
 * @type {Bounds | null}
 */
let room = null;

/** @param {Bounds | null} bounds @param {number[]} point @returns {Bounds} */
function around(bounds, point) {
  if (bounds === null) return { least: point, most: point };
  return { least: bounds.least.map((value, k) => Math.min(value, point[k])), most: bounds.most.map((value, k) => Math.max(value, point[k])) };
}

effect(() => {
  room = null;
  for (const { outline_m } of scene.value?.stage.surfaces ?? []) for (const point of outline_m) room = around(room, point);
});

/** Shows all of it again. */
function fit() {
  view.value = FIRST;
}

/** @param {Bounds} bounds @param {number} width @param {number} height @returns {Projection} */
function projection({ least, most }, width, height) {
  const { right, up } = axes(view.value);
  const centre = least.map((value, k) => (value + most[k]) / 2);
  const radius = Math.hypot(...least.map((value, k) => most[k] - value)) / 2;
  const scale = (view.value.zoom * FILLS * Math.min(width, height)) / Math.max(radius, 0.1);
  return (point) => {
    const from = point.map((value, k) => value - centre[k]);
    return [width / 2 + scale * dot(right, from), height / 2 - scale * dot(up, from)];
  };
}

/** @param {number[][]} points @param {boolean} closes */
function path(points, closes) {
  const line = new Path2D();
  points.forEach(([x, y], k) => (k === 0 ? line.moveTo(x, y) : line.lineTo(x, y)));
  if (closes) line.closePath();
  return line;
}

/**
 * Lines on the floor, a metre apart.
 * @param {CanvasRenderingContext2D} context
 * @param {Projection} to
 * @param {Bounds} bounds
 */
function drawFloor(context, to, { least, most }) {
  const [left, front] = least.map((value) => Math.floor(value));
  const [right, back] = most.map((value) => Math.ceil(value));
  const line = (/** @type {number[]} */ a, /** @type {number[]} */ b) => context.stroke(path([to([...a, 0]), to([...b, 0])], false));
  for (let x = left; x <= right; x += 1) line([x, front], [x, back]);
  for (let y = front; y <= back; y += 1) line([left, y], [right, y]);
}

/** The surfaces of all bodies that have a place, the farthest first. @param {PoseRecord} record */
function surfaces(record) {
  /** @type {{points: number[][], state: State}[]} */
  const all = [];
  for (const { outline_m } of scene.value?.stage.surfaces ?? []) all.push({ points: outline_m, state: record.state });
  scene.value?.objects.forEach((object, k) => {
    const { pose, state } = record.objects[k] ?? {};
    if (!pose) return;
    for (const { outline_m } of object.surfaces) all.push({ points: outline_m.map((point) => place(pose, point)), state });
  });
  const { away } = axes(view.value);
  const depth = (/** @type {number[][]} */ points) => points.reduce((sum, point) => sum + dot(away, point), 0) / points.length;
  return all.sort((a, b) => depth(b.points) - depth(a.points));
}

/** The corners of the picture, as directions; kept, for the lens seldom changes. */
const corners = computed(() => {
  if (!scene.value) return [];
  const { camera } = scene.value;
  const [w, h] = [camera.width - 0.5, camera.height - 0.5];
  return [[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]].map((corner) => direction(camera, corner));
});

/**
 * The camera's pyramid.
 * @param {CanvasRenderingContext2D} context
 * @param {Projection} to
 * @param {Pose} pose
 * @param {Bounds} bounds
 */
function drawCamera(context, to, pose, { least, most }) {
  const middle = least.map((value, k) => (value + most[k]) / 2);
  const reach = REACH * Math.hypot(...middle.map((value, k) => value - pose.position_m[k]));
  const ends = corners.value.map(([x, y]) => to(place(pose, [x * reach, y * reach, reach])));
  const lens = to(pose.position_m);
  for (const end of ends) context.stroke(path([lens, end], false));
  context.stroke(path(ends, true));
  const mark = new Path2D();
  mark.arc(lens[0], lens[1], 2 * devicePixelRatio, 0, 2 * Math.PI);
  context.fill(mark);
}

/**
 * Draws the uncertainty of the camera's position.
 * @param {CanvasRenderingContext2D} context
 * @param {Projection} to
 * @param {PoseRecord} record
 */
function drawDoubt(context, to, { pose, covariance }) {
  if (!pose || !covariance) return;
  const { long, short, turned } = ellipse([0, 6, 12].map((row) => covariance.slice(row, row + 3)), axes(view.value));
  const [x, y] = to(pose.position_m);
  const scale = to(pose.position_m.map((value, k) => value + axes(view.value).right[k]))[0] - x;
  const most = (WIDEST * Math.min(context.canvas.width, context.canvas.height)) / Math.max(SIGMAS * scale * long, 1e-9);
  enlarged.value = most >= ENLARGED ? ENLARGED : Math.max(1, 10 ** Math.floor(Math.log10(most)));
  const by = SIGMAS * enlarged.value * scale;
  const line = new Path2D();
  // The canvas has y down.
  line.ellipse(x, y, by * long, by * short, -turned, 0, 2 * Math.PI);
  context.stroke(line);
}

/**
 * Draws the path of the camera or an object in the last minute, interrupted where it is unknown.
 * @param {CanvasRenderingContext2D} context
 * @param {Projection} to
 * @param {(moment: import("./minute.js").Moment) => number[] | null | undefined} of
 */
function drawTrail(context, to, of) {
  const trail = new Path2D();
  let isOpen = true;
  for (const moment of minute) {
    const point = of(moment);
    if (point) {
      const [x, y] = to(point);
      if (isOpen) trail.moveTo(x, y);
      else trail.lineTo(x, y);
    }
    isOpen = !point;
  }
  context.stroke(trail);
}

/** Draws all of it as the shown frame has it. */
function draw() {
  const drawn = canvas && emptied(canvas);
  if (!drawn) return;
  const { context, width, height, colour } = drawn;
  const record = head.value?.record;
  if (!scene.value || !record || room === null) return;
  const { pose } = record;
  if (pose) room = around(room, pose.position_m);
  const to = projection(room, width, height);
  context.lineJoin = "round";
  context.lineWidth = devicePixelRatio;
  context.strokeStyle = colour("edge");
  drawFloor(context, to, room);
  context.lineWidth = 1.6 * devicePixelRatio;
  for (const { points, state } of surfaces(record)) {
    const shape = path(points.map(to), true);
    context.fillStyle = context.strokeStyle = colour(state);
    context.globalAlpha = 0.18;
    context.fill(shape);
    context.globalAlpha = 1;
    context.stroke(shape);
  }
  context.strokeStyle = colour("pale");
  drawTrail(context, to, (moment) => moment.place);
  scene.value.objects.forEach((_, k) => drawTrail(context, to, ({ objects }) => objects[k]));
  if (!pose) return;
  context.fillStyle = context.strokeStyle = colour("text");
  drawCamera(context, to, pose, room);
  context.strokeStyle = colour("accent");
  context.lineWidth = 2 * devicePixelRatio;
  drawDoubt(context, to, record);
}

/** The largest standard deviation of the camera's place along an axis, as text. */
const doubt = computed(() => {
  const covariance = head.value?.record.covariance;
  return amount(covariance ? 1000 * Math.sqrt(Math.max(covariance[0], covariance[7], covariance[14])) : null, 2, "mm");
});

/** @param {KeyboardEvent} event */
function pressed(event) {
  const step = STEPS.find(({ key }) => key === event.key);
  if (event.ctrlKey || event.metaKey || event.altKey || (!step && event.key !== "0")) return;
  event.preventDefault();
  if (step) view.value = stepped(view.value, step.by);
  else fit();
}

/** @param {PointerEvent} event */
function dragged(event) {
  if ((event.buttons & 1) === 0) return;
  view.value = stepped(view.value, { azimuth: -DRAG * event.movementX, elevation: DRAG * event.movementY });
}

/** The drawing, with buttons for whoever does not drag. */
export function Stage() {
  const drawn = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const own = /** @type {HTMLCanvasElement} */ (drawn.current);
    canvas = own;
    const sized = new ResizeObserver(draw);
    sized.observe(own);
    // After each shown frame, and where the view or the colours change.
    const stop = effect(() => {
      void [added.value, scene.value, view.value, theme.value, contact.value];
      draw();
    });
    return () => {
      stop();
      sized.disconnect();
    };
  }, []);
  return html`<section class="stage" aria-labelledby="stage">
    <h2 id="stage">The stage</h2>
    <canvas
      ref=${drawn}
      tabindex="0"
      role="application"
      aria-roledescription="drawing in 3D"
      aria-label="Surfaces, camera and its path. Arrows rotate, plus and minus zoom, 0 shows all."
      onKeyDown=${pressed}
      onPointerDown=${(/** @type {PointerEvent} */ event) => drawn.current?.setPointerCapture(event.pointerId)}
      onPointerMove=${dragged}
    />
    <div class="steps" role="group" aria-label="Rotate and zoom">
      ${STEPS.map(
        ({ key, sign, does, by }) =>
          html`<button key=${key} type="button" aria-label=${does} title=${does} onClick=${() => (view.value = stepped(view.value, by))}>${sign}</button>`,
      )}
      <button type="button" onClick=${fit}>All</button>
    </div>
    <p class="note">The camera's position is known to ${doubt} (1 sigma). The ellipse shows ${SIGMAS} sigmas${enlarged.value > 1 ? `, enlarged ${enlarged.value} times` : ""}.</p>
  </section>`;
}
