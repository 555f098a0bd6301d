// The camera's picture, with the outlines of the surfaces at the pose.
import { signal } from "./vendor/signals.js";
import { head, scene } from "./daemon.js";
import { pixel, place, within } from "./lens.js";
import { emptied } from "./ui.js";

/** @import { Camera, Head, Pose, PoseRecord, State, Surface } from "./types.js" */

/** Whether the outlines are drawn. */
export const outlined = signal(true);
/**
 * Whether seen and hidden tiles are marked, and what is mostly hidden, as a sentence. Both are the
 * work of seen.js, which is loaded later.
 */
export const parted = signal(false);
export const hidden = signal("");
/**
 * Functions that draw more on the live picture.
 * @type {Set<(context: CanvasRenderingContext2D, width: number, colour: (name: string) => string)
 *   => void>}
 */
export const extraMarks = new Set();
/**
 * Whether the pixels behind the poses are drawn, by used.js, which is loaded on demand; and a
 * sentence about them.
 */
export const rested = signal(false);
export const restsOn = signal("");
/** Whether the floor is drawn. */
export const floored = signal(false);

/**
 * Metres between the floor's lines, between the points of a line, and from the camera to their
 * ends.
 */
const LINES = 1;
const POINTS = 0.25;
const REACHES = 8;

/** @type {HTMLCanvasElement | null} */
let below = null;
/** @type {HTMLCanvasElement | null} */
let above = null;

/**
 * The canvases to draw on.
 * @param {HTMLCanvasElement | null} picture
 * @param {HTMLCanvasElement | null} marks
 */
export function drawOn(picture, marks) {
  below = picture;
  above = marks;
}

/** @param {ImageBitmap} picture @param {Head} said */
export function drawFrame(picture, said) {
  if (below === null || above === null) return;
  drawPicture(below, picture);
  drawAll(above, said);
}

/** Draws the marks of the shown frame anew, after its size or the colours changed. */
export function drawAgain() {
  if (head.value !== null && above !== null) drawAll(above, head.value);
}

/** @param {HTMLCanvasElement} on @param {Head} said */
function drawAll(on, said) {
  drawMarks(on, said);
  const context = on.getContext("2d");
  if (context === null || !said.record.pose) return;
  const style = getComputedStyle(on);
  for (const draw of extraMarks) draw(context, on.width, (name) => style.getPropertyValue(`--${name}`).trim());
}

/**
 * Draws a picture on a canvas, which gets its size.
 * @param {HTMLCanvasElement} canvas
 * @param {ImageBitmap} picture
 */
export function drawPicture(canvas, picture) {
  if (canvas.width !== picture.width || canvas.height !== picture.height) {
    canvas.width = picture.width;
    canvas.height = picture.height;
  }
  canvas.getContext("2d", { alpha: false })?.drawImage(picture, 0, 0);
}

/**
 * Draws the marks of a frame on a canvas over its picture.
 * @param {HTMLCanvasElement} on
 * @param {{record: PoseRecord | null, size: number[]}} said
 */
export function drawMarks(on, said) {
  const drawn = emptied(on);
  if (!drawn) return;
  const { context, width, colour } = drawn;
  const { record, size } = said;
  const seen = record?.pose;
  const known = scene.value;
  if (!known || !record || !seen) return;
  const scale = width / size[0];
  const draw = (/** @type {Surface} */ surface, /** @type {Pose | null} */ pose, /** @type {State} */ state) => {
    const inStage = (/** @type {number[]} */ point) => (pose === null ? point : place(pose, point));
    const pixels = surface.outline_m.map((point) => pixel(known.camera, within(seen, inStage(point))));
    stroke(context, pixels, scale, colour(state));
  };
  if (floored.value) drawFloor(context, known.camera, seen, scale, colour("accent"));
  if (!outlined.value) return;
  for (const surface of known.stage.surfaces) draw(surface, null, record.state);
  known.objects.forEach((object, k) => {
    const { pose, state } = record.objects[k] ?? {};
    if (pose) for (const surface of object.surfaces) draw(surface, pose, state);
  });
}

/**
 * Lines on the stage's floor, a metre apart, through the lens.
 * @param {CanvasRenderingContext2D} context
 * @param {Camera} camera
 * @param {Pose} pose
 * @param {number} scale
 * @param {string} colour
 */
function drawFloor(context, camera, pose, scale, colour) {
  const [x, y] = pose.position_m.map((value) => Math.round(value));
  const along = Array.from({ length: 1 + (2 * REACHES) / POINTS }, (_, k) => k * POINTS - REACHES);
  context.strokeStyle = colour;
  context.lineWidth = devicePixelRatio;
  for (let from = -REACHES; from <= REACHES; from += LINES) {
    for (const line of [along.map((to) => [x + from, y + to, 0]), along.map((to) => [x + to, y + from, 0])]) {
      context.stroke(path(line.map((point) => pixel(camera, within(pose, point))), scale));
    }
  }
}

/**
 * Draws a closed line through pixels, interrupted where one is null, with a dark border to show on
 * any ground.
 * @param {CanvasRenderingContext2D} context
 * @param {(number[] | null)[]} pixels
 * @param {number} scale
 * @param {string} colour
 */
function stroke(context, pixels, scale, colour) {
  const line = path([...pixels, pixels[0]], scale);
  context.lineJoin = "round";
  const wide = 2.2 * devicePixelRatio;
  context.strokeStyle = "rgb(0 0 0 / 55%)";
  context.lineWidth = wide + 2 * devicePixelRatio;
  context.stroke(line);
  context.strokeStyle = colour;
  context.lineWidth = wide;
  context.stroke(line);
}

/**
 * A line through pixels of the picture, interrupted where one is null.
 * @param {(number[] | null)[]} pixels
 * @param {number} scale
 */
function path(pixels, scale) {
  const line = new Path2D();
  let isOpen = true;
  for (const point of pixels) {
    if (point === null) {
      isOpen = true;
    } else {
      // A pixel's centre is half a pixel into it.
      const [x, y] = point.map((value) => (value + 0.5) * scale);
      if (isOpen) line.moveTo(x, y);
      else line.lineTo(x, y);
      isOpen = false;
    }
  }
  return line;
}
