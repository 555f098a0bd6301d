// Lengths as people type them: metres, centimetres, or feet and inches.

/** @typedef {"m" | "cm" | "ft"} Unit */

export const UNITS = /** @type {const} */ ([
  { unit: "m", title: "metres" },
  { unit: "cm", title: "centimetres" },
  { unit: "ft", title: "feet and inches" },
]);

/** Metres in a foot, and inches in it. */
const FOOT = 0.3048;
const INCHES = 12;

/** What each is like, for a person. */
export const EXAMPLES = { m: "4.25", cm: "425", ft: "13' 11 1/2\"" };

/** A plain number, with a comma or a point; null if it is none. @param {string} text */
export function number(text) {
  const plain = text.trim().replace(",", ".");
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(plain) ? Number(plain) : null;
}

/** A number of inches such as 11, 11.5 or 11 1/2. @param {string} text */
function inches(text) {
  const [, whole, upper, lower] = /^(\d+(?:\.\d+)?)?\s*(?:(\d+)\/(\d+))?$/.exec(text.trim()) ?? [];
  if (whole === undefined && upper === undefined) return null;
  return Number(whole ?? 0) + (upper === undefined ? 0 : Number(upper) / Number(lower));
}

/** Feet and inches such as 13' 11 1/2", 13 ft 11 in, or 13 11. @param {string} text */
function feet(text) {
  const plain = text.trim().toLowerCase().replace(/[’′]/g, "'").replace(/[”″]/g, '"').replace(",", ".").replace(/\s*(ft|feet|foot)\.?\s*/, "' ").replace(/\s*(in|inch|inches)\.?$|''|"$/, "");
  const [, before, after] = /^(\d+(?:\.\d+)?)\s*(?:'|\s|$)\s*(.*)$/.exec(plain) ?? [];
  if (before === undefined) return null;
  const more = after === "" ? 0 : inches(after);
  return more === null ? null : Number(before) + more / INCHES;
}

/**
 * A typed length in metres; null if it is none.
 * @param {string} text
 * @param {Unit} unit
 */
export function metres(text, unit) {
  const value = unit === "ft" ? feet(text) : number(text);
  if (value === null || !Number.isFinite(value)) return null;
  return value * { m: 1, cm: 0.01, ft: FOOT }[unit];
}
