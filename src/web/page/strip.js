// The last minute as a strip: the state of each shown frame, and the residual of its pose.
import { computed, effect } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { REMEMBERED, added, minute } from "./minute.js";
import { theme } from "./theme.js";
import { WORDS, amount, emptied, html } from "./ui.js";

/**
 * Pixels of the band of states; the band's height shows the state too: the more certain, the
 * higher.
 */
export const BAND = 14;
/** @type {Record<string, number>} */
export const HEIGHTS = { tracking: 1, coasting: 0.6, searching: 0.3, lost: 0.3 };
/** The least rms, pixels, that fills the height: noise alone is not to look like trouble. */
export const LEAST_FULL = 0.1;
/** Milliseconds after which a frame does not speak for the time that follows: nothing was shown. */
const SPEAKS = 1000;

/** The strip's own words: the share of each state, and the worst fit. */
const words = computed(() => {
  if (added.value === 0 || minute.length === 0) return "No frames yet.";
  const states = Object.entries(WORDS).map(([state, word]) => ({ word, count: minute.filter((moment) => moment.state === state).length }));
  const shares = states.filter(({ count }) => count > 0).map(({ word, count }) => {
    return `${word.toLowerCase()} ${Math.round((100 * count) / minute.length)}\u00a0%`;
  });
  return `Of ${minute.length} frames shown: ${shares.join(", ")}; largest residual ${amount(worst(), 2, "px")}. The top of the curve is ${amount(Math.max(LEAST_FULL, worst() ?? 0), 2, "px")}.`;
});

/** The largest rms that is remembered; null where nothing was measured. */
function worst() {
  const measured = minute.flatMap(({ rms }) => (rms === null ? [] : [rms]));
  return measured.length === 0 ? null : Math.max(...measured);
}

/** @param {HTMLCanvasElement} canvas */
function draw(canvas) {
  const drawn = emptied(canvas);
  if (!drawn) return;
  const { context, width, height, colour } = drawn;
  const begun = performance.now() - REMEMBERED;
  const x = (/** @type {number} */ at) => ((at - begun) / REMEMBERED) * width;
  const band = BAND * devicePixelRatio;
  const full = Math.max(LEAST_FULL, worst() ?? 0);
  const fits = new Path2D();
  let isOpen = true;
  minute.forEach(({ at, state, rms }, k) => {
    const until = Math.min(minute[k + 1]?.at ?? at, at + SPEAKS);
    const share = HEIGHTS[state] ?? 0;
    context.fillStyle = colour(state);
    context.fillRect(x(at), height - band * share, Math.max(1, x(until) - x(at)), band * share);
    if (rms !== null) {
      const y = (height - band - 4 * devicePixelRatio) * (1 - rms / full) + 2 * devicePixelRatio;
      if (isOpen) fits.moveTo(x(at), y);
      else fits.lineTo(x(at), y);
    }
    isOpen = rms === null || until < (minute[k + 1]?.at ?? at);
  });
  context.lineWidth = 1.5 * devicePixelRatio;
  context.strokeStyle = colour("text");
  context.stroke(fits);
}

/** The strip with its words. */
export function Strip() {
  const drawn = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const canvas = /** @type {HTMLCanvasElement} */ (drawn.current);
    const again = () => draw(canvas);
    const sized = new ResizeObserver(again);
    sized.observe(canvas);
    const stop = effect(() => {
      void [added.value, theme.value];
      again();
    });
    return () => {
      stop();
      sized.disconnect();
    };
  }, []);
  return html`<section class="strip" aria-labelledby="strip">
    <h2 id="strip">The last minute</h2>
    <canvas ref=${drawn} aria-hidden="true" />
    <p class="note">${words}</p>
  </section>`;
}
