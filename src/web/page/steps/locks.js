// What keeps a camera from changing by itself: the names of V4L2's controls, today's and older.

/** @import { Means } from "../types.js" */

/** Automatic modes with the value that ends them, and what they change. */
const AUTOMATICS = [
  { name: "auto_exposure", off: 1, holds: ["exposure_time_absolute", "gain"], word: "exposure" },
  { name: "exposure_auto", off: 1, holds: ["exposure_absolute", "gain"], word: "exposure" },
  { name: "exposure_dynamic_framerate", off: 0, holds: [], word: "frame rate" },
  { name: "exposure_auto_priority", off: 0, holds: [], word: "frame rate" },
  { name: "focus_automatic_continuous", off: 0, holds: ["focus_absolute"], word: "focus" },
  { name: "focus_auto", off: 0, holds: ["focus_absolute"], word: "focus" },
  { name: "white_balance_automatic", off: 0, holds: ["white_balance_temperature"], word: "white balance" },
  { name: "white_balance_temperature_auto", off: 0, holds: ["white_balance_temperature"], word: "white balance" },
];

/**
 * Controls that hold exposure, focus and white balance as they are now; the automatics come first,
 * because cameras refuse the others while they run.
 * @param {Means["cameras"][number]["controls"]} controls
 */
export function locked(controls) {
  const values = new Map(controls.map(({ name, value }) => [name, value]));
  const there = AUTOMATICS.filter(({ name }) => values.has(name));
  /** @type {Record<string, number>} */
  const held = Object.fromEntries(there.map(({ name, off }) => [name, off]));
  for (const name of there.flatMap(({ holds }) => holds)) {
    const value = values.get(name);
    if (typeof value === "number") held[name] = value;
  }
  return held;
}

/** What the camera sets by itself just now, in words. @param {Means["cameras"][number]["controls"]} controls */
export function automatic(controls) {
  const values = new Map(controls.map(({ name, value }) => [name, value]));
  return AUTOMATICS.filter(({ name, off }) => typeof values.get(name) === "number" && values.get(name) !== off).map(({ word }) => word);
}
