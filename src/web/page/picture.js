// The camera's picture, and over it what the pose says where the surfaces are.
import { head, scene } from "./daemon.js";
import { pixel, place, within } from "./lens.js";

/** @typedef {import("./daemon.js").Head} Head */

/** @type {HTMLCanvasElement | null} */
let below = null;
/** @type {HTMLCanvasElement | null} */
let above = null;

/** The canvases to draw on. @param {typeof below} picture @param {typeof above} marks */
export function drawOn(picture, marks) {
  below = picture;
  above = marks;
}

/** @param {ImageBitmap} picture @param {Head} said */
export function drawFrame(picture, said) {
  if (below === null || above === null) return;
  if (below.width !== picture.width || below.height !== picture.height) {
    below.width = picture.width;
    below.height = picture.height;
  }
  below.getContext("2d", { alpha: false })?.drawImage(picture, 0, 0);
  drawMarks(said);
}

/** Draws the marks of the shown frame anew, after its size or the colours changed. */
export function drawAgain() {
  if (head.value !== null) drawMarks(head.value);
}

/** @param {Head} said */
function drawMarks(said) {
  const context = above?.getContext("2d");
  if (!above || !context) return;
  const width = Math.round(above.clientWidth * devicePixelRatio);
  const height = Math.round(above.clientHeight * devicePixelRatio);
  if (above.width !== width || above.height !== height) {
    above.width = width;
    above.height = height;
  }
  context.clearRect(0, 0, width, height);
  const { record, size } = said;
  if (!scene.value || !record.pose) return;
  const scale = width / size[0];
  const style = getComputedStyle(above);
  const colour = (/** @type {string} */ state) => style.getPropertyValue(`--${state}`).trim();
  const draw = (/** @type {any} */ surface, /** @type {any} */ pose, /** @type {string} */ state) => {
    const inStage = (/** @type {number[]} */ point) => (pose === null ? point : place(pose, point));
    const pixels = surface.outline_m.map((/** @type {number[]} */ point) => pixel(scene.value.camera, within(record.pose, inStage(point))));
    stroke(context, pixels, scale, colour(state));
  };
  for (const surface of scene.value.stage.surfaces) draw(surface, null, record.state);
  scene.value.objects.forEach((/** @type {any} */ object, /** @type {number} */ k) => {
    const { pose, state } = record.objects[k] ?? {};
    if (pose) for (const surface of object.surfaces) draw(surface, pose, state);
  });
}

/** A closed line through pixels, open where one is not seen; with a dark seam, to be seen on any ground.
 * @param {CanvasRenderingContext2D} context @param {(number[] | null)[]} pixels @param {number} scale @param {string} colour */
function stroke(context, pixels, scale, colour) {
  const path = new Path2D();
  let isOpen = true;
  for (const point of [...pixels, pixels[0]]) {
    if (point === null) {
      isOpen = true;
    } else {
      // A pixel's centre is half a pixel into it.
      const [x, y] = point.map((value) => (value + 0.5) * scale);
      if (isOpen) path.moveTo(x, y);
      else path.lineTo(x, y);
      isOpen = false;
    }
  }
  context.lineJoin = "round";
  const line = 2.2 * devicePixelRatio;
  context.strokeStyle = "rgb(0 0 0 / 55%)";
  context.lineWidth = line + 2 * devicePixelRatio;
  context.stroke(path);
  context.strokeStyle = colour;
  context.lineWidth = line;
  context.stroke(path);
}
