// What is wrong with the camera's pictures: too dark, too bright, blurred, moving, with bands of
// light that flickers. Pure functions of grey pictures.

/** @typedef {{grey: Float32Array, width: number, height: number}} Grey */

/** Mean levels below which it is dark, and the share of white pixels above which it is too bright. */
const [DARK, WHITE] = [40, 0.15];
/** Level from which a pixel is white. */
const CLIPPED = 250;
/** Pixels over which the steepest edges rise; more is blurred. */
const BLURRED = 5;
/** Least range of levels that can be judged for blur. */
const RANGE = 40;
/** Levels by which two pictures differ, on average, if the camera moves. */
const MOVES = 8;
/** Share of the level by which rows differ between two pictures, where light flickers; and how much
 * more than columns. */
const [BANDS, MORE] = [0.015, 3];

/** @param {Float32Array} values */
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / Math.max(values.length, 1);

/** The value below which this share lies. @param {Float32Array} values @param {number} share */
const quantile = (values, share) => Float32Array.from(values).sort()[Math.min(values.length - 1, Math.floor(share * values.length))] ?? 0;

/**
 * How many pixels the steepest edges take to rise through the picture's range; null where there is
 * too little to see.
 * @param {Grey} of
 */
export function edgeWidth({ grey, width, height }) {
  const range = quantile(grey, 0.99) - quantile(grey, 0.01);
  if (range < RANGE) return null;
  const steps = new Float32Array(Math.max(0, (width - 1) * (height - 1)));
  for (let y = 0; y + 1 < height; y += 1) {
    for (let x = 0; x + 1 < width; x += 1) {
      const at = y * width + x;
      steps[y * (width - 1) + x] = Math.hypot(grey[at + 1] - grey[at], grey[at + width] - grey[at]);
    }
  }
  return range / Math.max(quantile(steps, 0.995), 1e-3);
}

/** The standard deviation, without a slope along them. @param {number[]} values */
function spread(values) {
  const middle = (values.length - 1) / 2;
  const average = values.reduce((sum, value) => sum + value, 0) / values.length;
  const square = values.reduce((sum, _, k) => sum + (k - middle) ** 2, 0);
  const slope = values.reduce((sum, value, k) => sum + value * (k - middle), 0) / square;
  return Math.sqrt(values.reduce((sum, value, k) => sum + (value - average - slope * (k - middle)) ** 2, 0) / values.length);
}

/**
 * How much rows flicker between two pictures, as a share of the level, and columns for comparison.
 * @param {Grey} now
 * @param {Grey} before
 */
export function flicker(now, before) {
  const { width, height } = now;
  const rows = Array.from({ length: height }, (_, y) => mean(now.grey.subarray(y * width, (y + 1) * width)) - mean(before.grey.subarray(y * width, (y + 1) * width)));
  const columns = Array.from({ length: width }, (_, x) => {
    let sum = 0;
    for (let y = 0; y < height; y += 1) sum += now.grey[y * width + x] - before.grey[y * width + x];
    return sum / height;
  });
  const level = Math.max(mean(now.grey), 1);
  return { rows: spread(rows) / level, columns: spread(columns) / level };
}

/**
 * What is wrong with a picture, each as a sentence with what to do.
 * @param {{small: Grey, middle: Grey, before: Grey | null}} pictures
 */
export function faults({ small, middle, before }) {
  const found = [];
  const white = small.grey.reduce((count, level) => count + (level >= CLIPPED ? 1 : 0), 0) / small.grey.length;
  const moved = before === null ? 0 : mean(small.grey.map((level, k) => Math.abs(level - before.grey[k])));
  if (mean(small.grey) < DARK) found.push("The picture is dark. Give the stage more light, or the camera more gain.");
  if (white > WHITE) found.push("Much of the picture is white. Shorten the exposure, or dim the light.");
  if (moved > MOVES) found.push("The camera or the light moves. Hold the camera still to judge the picture.");
  const edge = moved > MOVES ? null : edgeWidth(middle);
  if (edge !== null && edge > BLURRED) found.push("The picture is blurred. Focus on the stage, and clean the lens.");
  const bands = before === null || moved > MOVES ? null : flicker(small, before);
  if (bands !== null && bands.rows > BANDS && bands.rows > MORE * bands.columns) found.push("Bands run through the picture: the light flickers. Set the exposure to a multiple of 10 ms (50 Hz) or 8.3 ms (60 Hz).");
  return found;
}
