// Draws what the poses rest on over the live picture: the pixels that the tracker used, as dots,
// and each tile's residual, as an enlarged arrow. The daemon sends them only on request.
import { effect, signal } from "./vendor/signals.js";
import { head, pixelsWanted } from "./daemon.js";
import { drawAgain, extraMarks, restsOn } from "./picture.js";
import { theme } from "./theme.js";
import { amount } from "./ui.js";

/** Enlargements of the arrows. */
const SCALES = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
/**
 * The share of the picture's width within which nine of ten arrows stay, so that they do not
 * overlap.
 */
const LONGEST = 0.04;
/**
 * Milliseconds for which a scale is kept while arrows are at most twice as long: a scale that
 * changes with each frame cannot be read.
 */
const STANDS = 2000;
/** Radius of a dot, width of an arrow, and its head's length, pixels of the page. */
const [DOT, LINE, HEAD] = [1.5, 1.6, 5];

/** The current enlargement of the arrows. */
export const scale = signal(100);
let setAt = 0;

/** @param {number[]} lengths @param {number} share */
function quantile(lengths, share) {
  return [...lengths].sort((a, b) => a - b)[Math.floor(share * (lengths.length - 1))] ?? 0;
}

/**
 * Chooses a new scale if the current one is old enough, or arrows are far too long.
 * @param {number} most
 * @param {number} width of the picture
 */
function rescale(most, width) {
  const fitting = SCALES.filter((one) => one * most <= LONGEST * width).at(-1) ?? SCALES[0];
  const now = performance.now();
  if (fitting === scale.peek() || (now - setAt < STANDS && scale.peek() * most <= 2 * LONGEST * width)) return;
  scale.value = fitting;
  setAt = now;
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number} width
 * @param {(name: string) => string} colour
 */
function mark(context, width, colour) {
  const said = head.peek();
  if (said === null) return;
  if (!said.used || !said.displaced) {
    restsOn.value = "Pixels and residuals come with the next frame.";
    return;
  }
  const across = said.size[0];
  const on = (/** @type {number} */ px) => ((px + 0.5) * width) / across;
  const dots = new Path2D();
  for (let k = 0; k + 1 < said.used.length; k += 2) {
    const [x, y] = [on(said.used[k]), on(said.used[k + 1])];
    dots.moveTo(x + DOT * devicePixelRatio, y);
    dots.arc(x, y, DOT * devicePixelRatio, 0, 2 * Math.PI);
  }
  context.fillStyle = colour("accent");
  context.fill(dots);
  const tiles = Array.from({ length: Math.floor(said.displaced.length / 4) }, (_, k) => said.displaced?.slice(4 * k, 4 * k + 4) ?? []);
  const lengths = tiles.map(([, , dx, dy]) => Math.hypot(dx, dy));
  rescale(quantile(lengths, 0.9), across);
  const arrows = new Path2D();
  for (const [x, y, dx, dy] of tiles) {
    const [from, to] = [[on(x), on(y)], [on(x + scale.peek() * dx), on(y + scale.peek() * dy)]];
    const along = Math.atan2(to[1] - from[1], to[0] - from[0]);
    const tip = HEAD * devicePixelRatio;
    arrows.moveTo(from[0], from[1]);
    arrows.lineTo(to[0], to[1]);
    if (Math.hypot(to[0] - from[0], to[1] - from[1]) < tip) continue;
    for (const way of [along + 2.6, along - 2.6]) {
      arrows.moveTo(to[0], to[1]);
      arrows.lineTo(to[0] + tip * Math.cos(way), to[1] + tip * Math.sin(way));
    }
  }
  context.lineCap = "round";
  context.strokeStyle = "rgb(0 0 0 / 60%)";
  context.lineWidth = (LINE + 1.6) * devicePixelRatio;
  context.stroke(arrows);
  context.strokeStyle = colour("tracking");
  context.lineWidth = LINE * devicePixelRatio;
  context.stroke(arrows);
  restsOn.value = tiles.length === 0 ? "No tile is measured." : `Arrows enlarged ${scale.peek()} ×. Half of ${tiles.length} tiles lie within ${amount(quantile(lengths, 0.5), 2, "px")}.`;
}

/** Every frame comes with its pixels. */
const always = () => true;

/** Requests and draws them from now on; returns what ends it. */
export function watchUsed() {
  pixelsWanted.add(always);
  extraMarks.add(mark);
  const stop = effect(() => {
    void theme.value;
    drawAgain();
  });
  return () => {
    pixelsWanted.delete(always);
    extraMarks.delete(mark);
    restsOn.value = "";
    stop();
    drawAgain();
  };
}
