// A watch over the camera's pictures, for what is wrong with them.
import { signal } from "../vendor/signals.js";
import { painters } from "../daemon.js";
import { faults } from "./faults.js";

/** @import { Grey } from "./faults.js" */

/** Width that pictures are made smaller to, for light, motion and bands. */
const SMALL = 160;
/** Side of the part in the middle that is looked at for blur, pixels of the picture. */
const MIDDLE = 256;
/** Milliseconds between two looks. */
const LOOKS_EVERY = 700;

/**
 * @param {ImageBitmap} picture
 * @param {number[]} from left, top, width and height of the part
 * @param {number[]} size
 * @returns {Grey | null}
 */
function greyOf(picture, [x, y, w, h], [width, height]) {
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  if (context === null) return null;
  context.drawImage(picture, x, y, w, h, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height);
  return { grey: Float32Array.from({ length: width * height }, (_, k) => 0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2]), width, height };
}

/** What is wrong now. */
export const warnings = signal(/** @type {string[]} */ ([]));

/** Looks at the pictures from now on; what it returns ends it. */
export function watchPictures() {
  let before = /** @type {Grey | null} */ (null);
  let lookedAt = -Infinity;
  const look = (/** @type {ImageBitmap} */ picture) => {
    const now = performance.now();
    if (now - lookedAt < LOOKS_EVERY) return;
    lookedAt = now;
    const { width, height } = picture;
    const side = Math.min(MIDDLE, width, height);
    const small = greyOf(picture, [0, 0, width, height], [SMALL, Math.max(2, Math.round((SMALL * height) / width))]);
    const middle = greyOf(picture, [(width - side) / 2, (height - side) / 2, side, side], [side, side]);
    if (small === null || middle === null) return;
    const isSame = before !== null && before.height === small.height;
    const found = faults({ small, middle, before: isSame ? before : null });
    before = small;
    if (found.join() !== warnings.peek().join()) warnings.value = found;
  };
  painters.add(look);
  return () => {
    painters.delete(look);
    warnings.value = [];
  };
}
