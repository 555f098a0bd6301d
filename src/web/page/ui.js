// What all views are built with.
import { createElement } from "./vendor/preact.js";
import htm from "./vendor/htm.js";

/** Preact elements written as HTML. */
export const html = htm.bind(createElement);

/** The mark of a state within a square of 16: they differ by shape, not only by colour. */
const SHAPES = {
  tracking: "M8 1a7 7 0 1 0 0 14A7 7 0 0 0 8 1z",
  coasting: "M8 1a7 7 0 0 0 0 14z M8 2.2v11.6a5.8 5.8 0 0 0 0-11.6z",
  searching: "M7 1a6 6 0 1 0 3.6 10.8l3.3 3.2 1.4-1.4-3.3-3.2A6 6 0 0 0 7 1zm0 2a4 4 0 1 1 0 8 4 4 0 0 1 0-8z",
  lost: "M8 1l7.5 14H.5z",
  withheld: "M5 0.600h6l4.400 4.400v6l-4.400 4.400H5L.6 11V5zM4 7v2h8V7z",
  stale: "M2 2h4v12H2zM10 2h4v12h-4z",
  none: "M2.4 1L8 6.600 13.600 1 15 2.400 9.400 8 15 13.600 13.600 15 8 9.400 2.400 15 1 13.600 6.600 8 1 2.400z",
};

/** The words for the states. */
export const WORDS = {
  tracking: "Tracking",
  coasting: "Coasting",
  searching: "Searching",
  lost: "Lost",
  withheld: "Withheld",
  stale: "No picture",
  none: "No contact",
};

/** A state as word, shape and colour. @param {{state: keyof typeof WORDS}} props */
export function StateMark({ state }) {
  return html`<span class="state ${state}">
    <svg viewBox="0 0 16 16" aria-hidden="true"><path d=${SHAPES[state]} fill-rule="evenodd" /></svg>
    <b>${WORDS[state]}</b>
  </span>`;
}

/** What a field holds after an event of it. @param {Event} event */
export function typed({ target }) {
  return /** @type {HTMLInputElement | HTMLSelectElement} */ (target).value;
}

/**
 * A number with its unit, or a dash.
 * @param {number | null | undefined} value
 * @param {number} digits
 * @param {string} unit
 */
export function amount(value, digits, unit) {
  return value === null || value === undefined ? "–" : `${value.toFixed(digits).replace("-", "\u2212")}\u00a0${unit}`;
}

/**
 * An empty canvas at the screen's resolution, with the theme's colours by name; null if it cannot
 * be drawn on.
 * @param {HTMLCanvasElement} canvas
 */
export function emptied(canvas) {
  const context = canvas.getContext("2d");
  if (!context) return null;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((length) => Math.round(length * devicePixelRatio));
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  context.clearRect(0, 0, width, height);
  const style = getComputedStyle(canvas);
  return { context, width, height, colour: (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim() };
}
