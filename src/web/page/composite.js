// Draws the set in the camera's picture, each picture with the pose of its own record. Once a
// second it draws the stage's artwork instead, off screen, and compares it with the picture: their
// distance is the alignment.
import { signal } from "./vendor/signals.js";
import { frozen, head, painters, scene } from "./daemon.js";
import { align, summary } from "./gl/align.js";
import { Compositor } from "./gl/compose.js";
import { models } from "./models.js";
import { set } from "./things.js";

/**
 * @import { Mode } from "./gl/compose.js"
 * @import { Head, Motion, PoseRecord, Scene } from "./types.js"
 * @typedef {{median: number | null, most: number | null, tiles: number, unlike: number, sequence:
 *   number}} Measured
 */

/** Milliseconds between two measurements, and tiles that one looks at: some 20 ms of work. */
const MEASURES_EVERY = 1000;
const TILES = 150;
/** Milliseconds until the stage's pictures are asked for again. */
const ASKS_AGAIN = 1000;

/** How it is shown. */
export const mode = signal(/** @type {Mode} */ ("set"));
/** The set's strength in a mix, or where a wipe begins. */
export const share = signal(0.5);
/** Without handles: for a projector. */
export const clean = signal(false);
/** The last measurement. */
export const measured = signal(/** @type {Measured | null} */ (null));
/** Why there is no set; null while there is. */
export const fault = signal(/** @type {string | null} */ (null));

/** @type {Compositor | null} */
export let compositor = null;
/** The frame that is on the canvas. @type {Head | null} */
let shown = null;
let measuredAt = 0;
/** The session that it is of. @type {Scene | null} */
let known = null;

/** The floor's height, metres: as chosen, or the stage's lowest point if that is below zero. */
export function floorHeight() {
  const points = scene.value?.stage.surfaces.flatMap(({ outline_m }) => outline_m.map(([, , z]) => z)) ?? [];
  return set.value.floor_m ?? Math.min(0, ...points);
}

/** Draws on a canvas from now on; what it returns ends it. @param {HTMLCanvasElement} canvas */
export function composeOn(canvas) {
  try {
    compositor = new Compositor(canvas);
  } catch {
    fault.value = "This browser has no WebGL2, which the Set view needs. Use another browser, or turn on graphics acceleration.";
    return () => {};
  }
  fault.value = null;
  const lost = (/** @type {Event} */ event) => {
    event.preventDefault();
    fault.value = "The graphics card was reset. The set will return on its own.";
  };
  const back = () => (fault.value = null);
  canvas.addEventListener("webglcontextlost", lost);
  canvas.addEventListener("webglcontextrestored", back);
  painters.add(paint);
  learn();
  return () => {
    painters.delete(paint);
    canvas.removeEventListener("webglcontextlost", lost);
    canvas.removeEventListener("webglcontextrestored", back);
    compositor?.dispose();
    compositor = known = shown = null;
    measured.value = null;
  };
}

/** The session's camera and stage, once they are known. */
export function learn() {
  if (compositor === null || scene.value === null) return;
  const floor = floorHeight();
  if (known === scene.value) {
    if (compositor.set.floor !== floor) compositor.set.setStage(known, floor);
  } else {
    known = scene.value;
    compositor.setScene(known, floor);
    void artworks(known);
  }
  again();
}

/** Fetches what is on the surfaces. @param {Scene} of the scene that they are of */
async function artworks(of) {
  const fetched = await Promise.all(
    of.stage.surfaces.map(async (_, k) => {
      const answer = await fetch(`./api/v1/surfaces/${k}/picture`, { cache: "no-store" }).catch(() => null);
      if (answer === null || answer.status === 503) return /** @type {const} */ ("later");
      return answer.ok ? createImageBitmap(await answer.blob(), { colorSpaceConversion: "none" }).catch(() => null) : null;
    }),
  );
  if (of !== known || compositor === null) return;
  const pictures = fetched.filter((one) => one !== "later");
  if (pictures.length < fetched.length) setTimeout(() => of === known && artworks(of), ASKS_AGAIN);
  else compositor.setArtworks(pictures);
}

/** @param {ImageBitmap} picture @param {Head} said */
function paint(picture, said) {
  if (compositor === null) return;
  compositor.setPicture(picture);
  shown = said;
  again();
  const now = performance.now();
  if (now - measuredAt > MEASURES_EVERY && said.record.state === "tracking") {
    measuredAt = now;
    measured.value = measure(said.record, said.motion, TILES);
  } else if (said.record.state !== "tracking") {
    measured.value = null;
  }
}

/**
 * Measures how far the artwork, drawn at a record's pose, lies from the last picture.
 * @param {PoseRecord} record
 * @param {Motion | null} motion
 * @param {number} [tiles] at most
 * @returns {Measured | null}
 */
export function measure(record, motion, tiles) {
  if (compositor === null || compositor.artworks.children.length === 0) return null;
  const pair = compositor.pair(record, motion);
  return pair === null ? null : { ...summary(align(pair, tiles)), sequence: record.sequence };
}

/** Draws the shown frame anew, after something else changed. */
export function again() {
  if (compositor === null) return;
  compositor.set.setThings(set.value.objects, models.value);
  compositor.draw(shown?.record ?? null, shown?.motion ?? null, { mode: mode.value, share: share.value, clean: clean.value });
}

/** Whether nothing but changes of the set draws: the picture stands still. */
export function isStill() {
  return frozen.value || head.value === null;
}
