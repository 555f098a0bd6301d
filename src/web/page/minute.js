// The last minute as this page saw it: one entry per shown frame. It costs the daemon nothing.
import { effect, signal } from "./vendor/signals.js";
import { head } from "./daemon.js";

/** Milliseconds that are remembered. */
export const REMEMBERED = 60_000;

/** @import { State } from "./types.js" */
/**
 * @typedef {{at: number, state: State, rms: number | null, place: number[] | null, objects:
 *   (number[] | null)[]}} Moment when a frame was shown (milliseconds of performance.now), and what
 *   its record says
 */

/** Oldest first. The list is changed in place: drawing reads it, and no view is rendered for it. */
export const minute = /** @type {Moment[]} */ ([]);
/** Counts what was added. */
export const added = signal(0);

let epoch = 0;

effect(() => {
  const said = head.value;
  if (said === null) return;
  // Another session may have another stage.
  if (said.epoch !== epoch) minute.length = 0;
  epoch = said.epoch;
  const { state, rms_px, pose, objects } = said.record;
  const at = performance.now();
  minute.push({ at, state, rms: rms_px, place: pose?.position_m ?? null, objects: objects.map((object) => object.pose?.position_m ?? null) });
  while (minute[0].at < at - REMEMBERED) minute.shift();
  added.value = added.peek() + 1;
});
