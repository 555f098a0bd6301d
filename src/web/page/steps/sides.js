// Width and height of surfaces, in metres.
import { metres } from "./lengths.js";

/** @import { Draft } from "./draft.js" */

/** A surface's side, metres. */
const SIDE = [0.05, 200];

/**
 * Width and height in metres; null where one is none. That of the surface that is shown, or of this
 * one.
 * @param {Draft} of
 * @param {number} [which]
 */
export function size({ surfaces, surface, unit }, which = surface) {
  const { width, height } = surfaces[which] ?? surfaces[0];
  return [width, height].map((text) => metres(text, unit));
}

/** Whether a length can be a surface's side. @param {number | null} length */
export const isSide = (length) => length !== null && length >= SIDE[0] && length <= SIDE[1];
