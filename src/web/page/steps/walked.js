// What a walk has shown of the stage, and what is still missing: a pure function of where the camera
// was.

/**
 * @typedef {{places: number[][], frames: number, tracked: number, blurred: number}} Walked where the
 *   camera was, metres, and how many of the looks at it were tracked, and fast
 */

/** Degrees about the stage that a walk should cover: what docs/survey.md asks for, and some more. */
const ROUND = 40;
/** How many times as far as the nearest place the farthest should be. */
const DEPTH = 1.3;
/** Metres between the lowest and the highest place. */
const RISE = 0.25;
/** Looks before anything is said: some seconds. */
const FIRST = 15;
/** Share of looks that should be tracked, and that may be fast. */
const [TRACKED, FAST] = [0.6, 0.25];

/**
 * @param {Walked} of
 * @param {{centre: number[], width: number}} aim the middle of the stage, metres
 * @returns {{wants: string[], facts: {name: string, value: string}[]}}
 */
export function seenFrom({ places, frames, tracked, blurred }, { centre }) {
  const away = places.map((place) => place.map((value, axis) => value - centre[axis]));
  // The audience is where y is negative: angles are from there.
  const angles = away.map(([x, y]) => (Math.atan2(x, -y) * 180) / Math.PI);
  const far = away.map((place) => Math.hypot(...place));
  const heights = places.map((place) => place[2]);
  const range = (/** @type {number[]} */ values) => (values.length === 0 ? [0, 0] : [Math.min(...values), Math.max(...values)]);
  const [[left, right], [near, distant], [low, high]] = [range(angles), range(far), range(heights)];
  const wants = [];
  if (frames > FIRST && tracked < TRACKED * frames) wants.push("Keep the stage in view: it is seen in too few pictures.");
  if (frames > FIRST && blurred > FAST * frames) wants.push("Walk and turn more slowly: pictures are blurred.");
  if (right - left < ROUND) wants.push(Math.abs(left) < Math.abs(right) ? "Go farther to the left." : "Go farther to the right.");
  if (near === 0 || distant < DEPTH * near) wants.push("Go nearer, and farther away.");
  if (high - low < RISE) wants.push("Hold the camera higher, and lower.");
  const facts = [
    { name: "Seen", value: frames === 0 ? "–" : `${Math.round((100 * tracked) / frames)} %` },
    { name: "Round", value: `${Math.round(right - left)}°` },
    { name: "Distance", value: places.length === 0 ? "–" : `${near.toFixed(1)} to ${distant.toFixed(1)} m` },
    { name: "Height", value: places.length === 0 ? "–" : `${Math.round(100 * (high - low))} cm` },
  ];
  return { wants, facts };
}
