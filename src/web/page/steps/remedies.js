// What a finding asks to write, as changes of the draft: each with a title for its button.

import { parsed } from "../ask.js";

/** @import { Draft } from "./draft.js" */
/** @typedef {{title: string, part: Partial<Draft>}} Remedy */

/** A number, or a list of numbers or of pairs, as a finding writes it. */
const VALUE = String.raw`(\[(?:[^\][]|\[[^\][]*\])*\]|[\d.]+(?:e-?\d+)?)`;
/** What is to be written: `write KEY = VALUE`, and further values of the same key after `or`. */
const WRITE = new RegExp(String.raw`write \`?(fov_deg|readout_s|exposure_s|size_m|corners_px) = ${VALUE}`, "g");

/** @param {string} text @returns {number[] | number[][] | number | null} */
function valueOf(text) {
  try {
    return /** @type {number[] | number[][] | number} */ (parsed(text));
  } catch {
    return null;
  }
}

/** The surface that a finding names, by its number; the first, where it names none. @param {string} message */
function surfaceOf(message) {
  const [, number] = /\bsurface (\d+)\b/i.exec(message) ?? [];
  return number === undefined ? 0 : Number(number) - 1;
}

/** @param {string} message @param {Draft} of @returns {Remedy[]} */
export function remedies(message, of) {
  return [...message.matchAll(WRITE)].flatMap(([, key, text]) => {
    const value = valueOf(text);
    const part = value === null ? null : written(key, value, text, surfaceOf(message), of);
    return part === null ? [] : [{ title: `Write ${key} = ${text}`, part }];
  });
}

/**
 * @param {string} key
 * @param {number[] | number[][] | number} value
 * @param {string} text
 * @param {number} which
 * @param {Draft} of
 * @returns {Partial<Draft> | null}
 */
function written(key, value, text, which, of) {
  const surface = of.surfaces[which];
  /** @param {Partial<import("./draft.js").SurfaceDraft>} part */
  const changed = (part) => (surface === undefined ? null : { surfaces: of.surfaces.map((one, k) => (k === which ? { ...one, ...part } : one)) });
  if (typeof value === "number") {
    if (key === "fov_deg") return of.lens === "guess" ? { fov: text } : null;
    return key === "readout_s" || key === "exposure_s" ? { more: { ...of.more, camera: { ...of.more.camera, [key]: text } } } : null;
  }
  if (key === "size_m" && value.length === 2) {
    const [width, height] = value.map(String);
    const sides = changed({ width, height });
    // Sizes in a finding are metres.
    return sides === null ? null : { ...sides, ...(of.unit === "m" || of.surfaces.length === 1 ? { unit: "m" } : {}) };
  }
  if (key !== "corners_px" || value.length !== 4 || surface?.door !== "freeze") return null;
  const corners = value.filter((pair) => Array.isArray(pair) && pair.length === 2);
  return corners.length === 4 ? changed({ corners: /** @type {number[][]} */ (corners), former: [...surface.former, surface.corners] }) : null;
}
