// A recording over time: the state of each row as a band, its residual as a line, events as marks,
// and the current row.
import { computed, effect } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { clip, go, retracked, row, shown } from "./clip.js";
import { BAND, HEIGHTS, LEAST_FULL } from "./strip.js";
import { theme } from "./theme.js";
import { WORDS, emptied, html } from "./ui.js";

/** The part of a recording that a page key moves by, and rows with Shift. */
const PAGES = 20;
const MANY = 10;
/** Half the width of an event's mark, pixels. */
const MARK = 4;

/** @typedef {import("./clip.js").Clip} Clip */

/** Seconds as minutes and seconds. @param {number} seconds */
export function clock(seconds) {
  const tenths = Math.round(10 * seconds);
  const [minutes, rest] = [Math.floor(tenths / 600), tenths % 600];
  return `${minutes}:${String(Math.floor(rest / 10)).padStart(2, "0")}.${rest % 10}`;
}

/**
 * The approximate time of a row, seconds since the first: rows have a constant rate except where
 * frames were dropped.
 * @param {Clip} of
 * @param {number} number
 */
export function secondsOf({ first_ns, last_ns, frames }, number) {
  return first_ns === null || last_ns === null || frames < 2 ? 0 : ((last_ns - first_ns) * number) / (frames - 1) / 1e9;
}

/**
 * The rms, pixels, that fills the height: the same for the recorded and for today's results, so
 * that they compare.
 */
const full = computed(() => [clip.value, retracked.value].reduce((most, of) => of?.columns.reduce((worst, { rms_px }) => Math.max(worst, rms_px ?? 0), most) ?? most, LEAST_FULL));

/** @typedef {Pick<Clip, "frames" | "columns" | "events">} Drawn */

/** @param {HTMLCanvasElement} canvas @param {Drawn} of @param {number} at a row */
function draw(canvas, of, at) {
  const drawn = emptied(canvas);
  if (!drawn) return;
  const { context, width, height, colour } = drawn;
  const x = (/** @type {number} */ number) => (number / of.frames) * width;
  const band = BAND * devicePixelRatio;
  // The worst last: a lost row is seen among hundreds that share a pixel.
  for (const state of Object.keys(HEIGHTS)) {
    context.fillStyle = colour(state);
    for (const column of of.columns) {
      if (column.state !== state) continue;
      // Whole pixels, so that neighbours have no seam.
      const [from, to] = [Math.floor(x(column.row)), Math.ceil(x(column.row + column.rows))];
      context.fillRect(from, height - band * HEIGHTS[state], to - from, band * HEIGHTS[state]);
    }
  }
  const [top, room] = [2 * MARK * devicePixelRatio, height - band - 3 * MARK * devicePixelRatio];
  const fits = new Path2D();
  let isOpen = true;
  for (const { row: first, rows, rms_px } of of.columns) {
    if (rms_px !== null) {
      const [along, y] = [x(first + rows / 2), top + room * (1 - rms_px / full.value)];
      if (isOpen) fits.moveTo(along, y);
      else fits.lineTo(along, y);
    }
    isOpen = rms_px === null;
  }
  context.lineWidth = 1.5 * devicePixelRatio;
  context.strokeStyle = colour("text");
  context.stroke(fits);
  drawMarks(context, of, x, colour("accent"));
  context.fillStyle = colour("accent");
  context.fillRect(x(at + 0.5) - devicePixelRatio, 0, 2 * devicePixelRatio, height);
}

/**
 * Events as triangles along the upper edge.
 * @param {CanvasRenderingContext2D} context
 * @param {Drawn} of
 * @param {(row: number) => number} x
 * @param {string} colour
 */
function drawMarks(context, of, x, colour) {
  const size = MARK * devicePixelRatio;
  context.fillStyle = colour;
  for (const { row: number } of of.events) {
    const at = x(number + 0.5);
    const mark = new Path2D();
    mark.moveTo(at - size, 0);
    mark.lineTo(at + size, 0);
    mark.lineTo(at, 1.6 * size);
    context.fill(mark);
  }
}

/** @param {KeyboardEvent} event */
function pressed(event) {
  const frames = clip.value?.frames ?? 0;
  const far = Math.max(1, Math.round(frames / PAGES));
  const step = event.shiftKey ? MANY : 1;
  const by = { ArrowLeft: -step, ArrowRight: step, ArrowDown: -step, ArrowUp: step, PageDown: -far, PageUp: far, Home: -frames, End: frames }[event.key];
  if (by === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  go(row.value + by);
}

/** The state of the shown row as a word. */
const word = computed(() => {
  const state = shown.value?.record?.state;
  return state === undefined ? "" : WORDS[state];
});
const rowText = computed(() => (clip.value === null ? "" : `${clock(secondsOf(clip.value, row.value))}, ${word.value}`));

/** What today's config makes of it, as the recording's own is drawn. */
const today = computed(() => (retracked.value === null ? null : { ...retracked.value, events: [] }));

/** The drawing of one of the two. @param {{isToday?: boolean}} props */
export function Drawing({ isToday = false }) {
  const drawn = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const canvas = /** @type {HTMLCanvasElement} */ (drawn.current);
    const source = isToday ? today : clip;
    const again = () => {
      const of = source.peek();
      if (of !== null) draw(canvas, of, row.peek());
    };
    const sized = new ResizeObserver(again);
    sized.observe(canvas);
    const stop = effect(() => {
      void [source.value, full.value, row.value, theme.value];
      again();
    });
    return () => {
      stop();
      sized.disconnect();
    };
  }, []);
  return html`<canvas ref=${drawn} aria-hidden="true" />`;
}

/** The timeline, as a slider over the rows. @param {{of: Clip}} props */
export function Timeline({ of }) {
  const seek = (/** @type {PointerEvent} */ event) => {
    const { left, width } = /** @type {HTMLElement} */ (event.currentTarget).getBoundingClientRect();
    go(Math.floor(((event.clientX - left) / width) * of.frames));
  };
  return html`<div
    class="timeline"
    role="slider"
    tabindex="0"
    aria-label="Row"
    aria-valuemin="0"
    aria-valuemax=${Math.max(0, of.frames - 1)}
    aria-valuenow=${row}
    aria-valuetext=${rowText}
    onKeyDown=${pressed}
    onPointerDown=${(/** @type {PointerEvent} */ event) => {
      /** @type {HTMLElement} */ (event.currentTarget).setPointerCapture(event.pointerId);
      seek(event);
    }}
    onPointerMove=${(/** @type {PointerEvent} */ event) => (event.buttons & 1) !== 0 && seek(event)}
  >
    <${Drawing} />
  </div>`;
}
