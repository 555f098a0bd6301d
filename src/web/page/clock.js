// A clock to film: the daemon's time as black and white cells, which `stagepose delay --clock`
// reads from a clip, to find how late a camera's stamps are. src/delay/filmed_clock/layout.rs
// describes the code.
import { signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { ask, reason } from "./ask.js";
import { emptied, html } from "./ui.js";

/** Cells across and down, without the white margin. */
const SIZE = [18, 8];
const BITS_PER_ROW = 14;
const PERIOD_MS = 2 ** 28;
/**
 * Milliseconds for which a code stays: three refreshes at 60 per second. Raised, more frames see
 * one code only; lowered, long exposures see three.
 */
const HOLD_MS = 45;
/** Requests of a synchronisation, and milliseconds from one to the next. */
const ROUND_TRIPS = 8;
const SYNCHRONISED_EVERY = 10000;

/** Whether each cell is white at a time, row by row. @param {number} ms */
export function cells(ms) {
  const time = ms % PERIOD_MS;
  const gray = time ^ (time >> 1);
  const [columns, rows] = SIZE.map((count) => [...Array(count).keys()]);
  return rows.map((row) => columns.map((column) => isWhite(column, row, gray)));
}

/** @param {number} column @param {number} row @param {number} gray */
function isWhite(column, row, gray) {
  const depth = Math.min(column, SIZE[0] - 1 - column, row, SIZE[1] - 1 - row);
  // The mark tells top from bottom.
  if (depth < 2) return depth === 1 && !(column === 1 && row === 1);
  const bit = column - 2 + BITS_PER_ROW * ((row - 2) >> 1);
  const isInverse = (row & 1) === 1;
  return (((gray >> bit) & 1) === 1) !== isInverse;
}

/** Draws the code as large as fits. @param {HTMLCanvasElement} canvas @param {number} ms */
function draw(canvas, ms) {
  const { context, width, height } = emptied(canvas) ?? {};
  if (!context || width === undefined || height === undefined) return;
  const cell = Math.floor(Math.min(width / (SIZE[0] + 2), height / (SIZE[1] + 2)));
  const [left, top] = [Math.round((width - cell * SIZE[0]) / 2), Math.round((height - cell * SIZE[1]) / 2)];
  context.fillStyle = "#fff";
  context.fillRect(0, 0, width, height);
  context.fillStyle = "#000";
  cells(ms).forEach((row, y) => row.forEach((white, x) => void (white || context.fillRect(left + cell * x, top + cell * y, cell, cell))));
}

/** Daemon's milliseconds minus performance.now, and half of the round trip; null until known. */
const offset = signal(/** @type {{ms: number, within: number} | null} */ (null));
const fault = signal("");

/** Asks for the daemon's time; the shortest round trip says it best. */
async function synchronise() {
  try {
    let best = { ms: 0, within: Infinity };
    for (let k = 0; k < ROUND_TRIPS; k += 1) {
      const asked = performance.now();
      const said = Number(await (await ask("clock")).text());
      const within = (performance.now() - asked) / 2;
      if (within < best.within) best = { ms: said - asked - within, within };
    }
    offset.value = best;
    fault.value = "";
  } catch (why) {
    fault.value = reason(why);
  }
}

/** Whether the clock covers the page. */
const shows = signal(false);

function open() {
  shows.value = true;
  // Where a browser has no full screen, the clock covers the page.
  document.documentElement.requestFullscreen?.().catch(() => undefined);
}

function close() {
  shows.value = false;
  if (document.fullscreenElement !== null) document.exitFullscreen().catch(() => undefined);
}

/** The clock over the whole screen, until Escape or a tap. */
function Clock() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    void synchronise();
    const timer = setInterval(synchronise, SYNCHRONISED_EVERY);
    let changedAt = -Infinity;
    let frame = requestAnimationFrame(function show(now) {
      frame = requestAnimationFrame(show);
      if (canvas.current === null || offset.value === null || now - changedAt < HOLD_MS) return;
      changedAt = now;
      draw(canvas.current, Math.round(now + offset.value.ms));
    });
    const onKey = (/** @type {KeyboardEvent} */ { key }) => key === "Escape" && close();
    const onChange = () => document.fullscreenElement === null && close();
    addEventListener("keydown", onKey);
    document.addEventListener("fullscreenchange", onChange);
    return () => {
      clearInterval(timer);
      cancelAnimationFrame(frame);
      removeEventListener("keydown", onKey);
      document.removeEventListener("fullscreenchange", onChange);
    };
  }, []);
  return html`<canvas ref=${canvas} class="clock" role="img" aria-label="The time as black and white cells. Escape closes it." onClick=${close}></canvas>`;
}

/** The section of Health. */
export function ClockToFilm() {
  const within = offset.value === null ? "" : ` Its time is the daemon's, to ${offset.value.within.toFixed(1)} ms.`;
  return html`<section aria-labelledby="clock">
    <h2 id="clock">Clock to film</h2>
    <p class="note">
      It measures how late a camera's stamps are. Show it on a screen or a tablet, record it with the camera for ten seconds or more, sharp and with its
      white margin, then run <code>stagepose delay --config FILE --clip CLIP --clock</code>.
    </p>
    <div class="row"><button type="button" onClick=${open}>Show the clock</button></div>
    <p role="status">${fault.value || within.trim()}</p>
    ${shows.value ? html`<${Clock} />` : null}
  </section>`;
}
