// The picture of a still camera: the mean of several frames has less noise than one.
import { frozen, painters } from "../daemon.js";

/** Frames in a mean. Raised, it takes longer; lowered, it has more noise. */
const FRAMES = 8;
/** Milliseconds in which they must come. */
const COME_WITHIN = 6000;
/**
 * Grey levels by which the last frame may differ from the first on average. More is a camera that
 * moves, of which the mean would be blurred.
 */
const STILL = 3;

/** @typedef {{blob: Blob, width: number, height: number, isMean: boolean}} Frozen */

/**
 * Takes the next frames.
 * @param {number} count
 * @returns {Promise<ImageData[]>}
 */
function nextFrames(count) {
  frozen.value = false;
  return new Promise((done, fail) => {
    /** @type {ImageData[]} */
    const frames = [];
    const paint = (/** @type {ImageBitmap} */ picture) => {
      const { width, height } = picture;
      const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
      if (context === null) return;
      context.drawImage(picture, 0, 0);
      if (frames.length > 0 && frames[0].width !== width) frames.length = 0;
      frames.push(context.getImageData(0, 0, width, height));
      if (frames.length < count) return;
      end();
      done(frames);
    };
    const timer = setTimeout(() => {
      end();
      fail(new Error("The camera sends no pictures, so there is none to freeze. Check the camera in step 1."));
    }, COME_WITHIN);
    const end = () => {
      clearTimeout(timer);
      painters.delete(paint);
    };
    painters.add(paint);
  });
}

/** The mean difference of two frames, grey levels. @param {ImageData} a @param {ImageData} b */
function difference({ data: a }, { data: b }) {
  let sum = 0;
  for (let k = 0; k < a.length; k += 4) sum += Math.abs(a[k + 1] - b[k + 1]);
  return sum / (a.length / 4);
}

/** @param {ImageData[]} frames */
function mean(frames) {
  const sums = new Float32Array(frames[0].data.length);
  for (const { data } of frames) for (let k = 0; k < sums.length; k += 1) sums[k] += data[k];
  const { width, height } = frames[0];
  return new ImageData(Uint8ClampedArray.from(sums, (sum) => sum / frames.length), width, height);
}

/**
 * Freezes the picture: a mean of frames, or the last one if the camera moves.
 * @returns {Promise<Frozen>}
 */
export async function freeze() {
  const frames = await nextFrames(FRAMES);
  const [first, last] = [frames[0], frames[frames.length - 1]];
  const isMean = difference(first, last) < STILL;
  const { width, height } = first;
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d")?.putImageData(isMean ? mean(frames) : last, 0, 0);
  return { blob: await canvas.convertToBlob({ type: "image/png" }), width, height, isMean };
}
