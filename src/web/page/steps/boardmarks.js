// What was seen of the calibration board, in the live picture: its corners, and the parts of the
// picture where it has not been yet.
import { signal } from "../vendor/signals.js";
import { emptied } from "../ui.js";

/** @import { Head } from "../types.js" */
/**
 * @typedef {{pictures: string[], missing_parts: number[][], missing_sides: string[],
 *   next: string | null, good: boolean, seen?: string, why?: string | null,
 *   corners?: number[][] | null}} Seen
 */

/** What the daemon said last; null before it was asked. */
export const seen = signal(/** @type {Seen | null} */ (null));
/** Columns and rows of parts. */
export const [COLUMNS, ROWS] = [4, 3];

/** @param {HTMLCanvasElement} on @param {Head} said */
export function drawBoard(on, { size }) {
  const drawn = emptied(on);
  const of = seen.value;
  if (!drawn || of === null) return;
  const { context, width, height, colour } = drawn;
  context.strokeStyle = colour("accent");
  context.lineWidth = devicePixelRatio;
  context.setLineDash([6 * devicePixelRatio, 6 * devicePixelRatio]);
  for (const [column, row] of of.missing_parts) context.strokeRect((column * width) / COLUMNS + 4, (row * height) / ROWS + 4, width / COLUMNS - 8, height / ROWS - 8);
  context.setLineDash([]);
  context.fillStyle = colour(of.seen === "moving" || of.seen === "blurred" ? "coasting" : "tracking");
  const scale = width / size[0];
  for (const [x, y] of of.corners ?? []) {
    context.beginPath();
    context.arc((x + 0.5) * scale, (y + 0.5) * scale, 3.5 * devicePixelRatio, 0, 2 * Math.PI);
    context.fill();
  }
}
