// The lens from a board: printed, held before the camera, photographed by itself when it is still.
import { signal } from "../vendor/signals.js";
import { useEffect } from "../vendor/hooks.js";
import { barred } from "../access.js";
import { ask, content, reason, send, sentence } from "../ask.js";
import { head, painters } from "../daemon.js";
import { html, typed } from "../ui.js";
import { seen } from "./boardmarks.js";
import { change, draft } from "./draft.js";
import { Working, work, working } from "./jobs.js";
import { number } from "./lengths.js";

/** @import { Seen } from "./boardmarks.js" */
/**
 * @typedef {{verdict: string, sentence: string, rms_px: number | null, width: number, height: number,
 *   fx: number, next_picture: string | null, uncertainty_map: {columns: number, rows: number,
 *   values_px: number[], worst_px: number, median_px: number | null},
 *   views: {file: string, used: boolean, rms_px: number | null, reason: string | null}[]}} Solved
 */

/** Milliseconds between two looks at the board. Lowered, the daemon has more to do. */
const LOOKS_EVERY = 250;
/** Quality of the pictures: their noise is above that of the compression. */
const QUALITY = 0.95;

/** Whether pictures are being taken. */
const takes = signal(false);
const said = signal("");
/** The lens that was computed last. */
const solved = signal(/** @type {Solved | null} */ (null));

const WORDS = {
  none: "No board is seen. Hold it so that all of it is in the picture.",
  moving: "Hold it still.",
  blurred: "It is blurred. Hold it still, nearer or farther, with more light.",
  known: "There is such a picture already. Move it on.",
  taken: "Taken.",
};

/** The board's size as a query. */
const query = () => `columns=${draft.peek().columns}&rows=${draft.peek().rows}`;

/** The next picture as a JPEG. @returns {Promise<Blob>} */
function nextPicture() {
  return new Promise((done) => {
    const paint = (/** @type {ImageBitmap} */ picture) => {
      painters.delete(paint);
      const canvas = new OffscreenCanvas(picture.width, picture.height);
      canvas.getContext("2d")?.drawImage(picture, 0, 0);
      done(canvas.convertToBlob({ type: "image/jpeg", quality: QUALITY }));
    };
    painters.add(paint);
  });
}

async function list() {
  try {
    seen.value = /** @type {Seen} */ (await content(await ask(`boards?${query()}`)));
  } catch (why) {
    said.value = reason(why);
  }
}

/** Looks at the board until pictures are not wanted any more. */
function watch() {
  let isOver = false;
  const run = async () => {
    while (!isOver && takes.peek()) {
      try {
        const picture = await nextPicture();
        if (isOver) return;
        seen.value = /** @type {Seen} */ (await content(await send("POST", `boards/look?${query()}`, picture)));
        said.value = "";
        if (seen.value.good) takes.value = false;
      } catch (why) {
        said.value = reason(why);
        takes.value = false;
      }
      await new Promise((done) => setTimeout(done, LOOKS_EVERY));
    }
  };
  void run();
  return () => {
    isOver = true;
  };
}

/** @param {string} name */
async function remove(name) {
  try {
    await send("DELETE", `boards/${name}`);
    await list();
    // Solved anew, if it was.
    if (solved.peek() !== null) await solve();
  } catch (why) {
    said.value = reason(why);
  }
}

async function solve() {
  takes.value = false;
  const { columns, rows, square } = draft.peek();
  if (!(await work("lens", { columns: Number(columns), rows: Number(rows), square_mm: number(square) }))) return;
  const of = /** @type {Solved} */ (await content(await ask("lens")));
  solved.value = of;
  const isGood = !of.verdict.includes("not use");
  const fov = (2 * Math.atan(of.width / (2 * of.fx)) * 180) / Math.PI;
  change({ calibration: isGood ? { file: "calibrations/from-board.toml", name: "from-board.toml", width: of.width, height: of.height, fov_deg: fov } : null });
}

/** The board's corners and squares, and the sheet to print. */
function Which() {
  const { columns, rows, square } = draft.value;
  const field = (/** @type {"columns" | "rows" | "square"} */ name, /** @type {string} */ title, /** @type {string} */ value, /** @type {string} */ unit) => html`<label class="field">
    <span>${title}</span>
    <input data-first=${name === "columns" ? "" : null} inputmode="decimal" value=${value} aria-invalid=${number(value) === null ? "true" : "false"} onInput=${(/** @type {Event} */ event) => change({ [name]: typed(event) })} />
    <span class="unit">${unit}</span>
  </label>`;
  const sheet = `board-${columns}x${rows}-${square}-a4`;
  const make = async () => {
    said.value = "Drawing it …";
    try {
      await send("PUT", `prints/${sheet}`);
      said.value = "";
      made.value = sheet;
    } catch (why) {
      said.value = reason(why);
    }
  };
  return html`<div class="fields">${field("columns", "Inner corners", columns, "×")}${field("rows", "by", rows, "")}${field("square", "Square", square, "mm")}</div>
    <div class="row">${made.value === sheet ? html`<a class="button" href=${`./api/v1/prints/${sheet}.pdf`} download>Download to print</a>` : html`<button type="button" class="quiet" disabled=${barred.value !== null} onClick=${make}>A board to print</button>`}</div>
    <p class="note">Print it at 100 %, measure a square, and glue it on something flat.</p>`;
}
/** The sheet that was made. */
const made = signal("");

/** The pictures, each to be removed. */
function Pictures() {
  const all = seen.value?.pictures ?? [];
  if (all.length === 0) return null;
  const of = new Map((solved.value?.views ?? []).map((view) => [view.file.split("/").pop(), view]));
  return html`<ul class="boards">
    ${all.map((name) => {
      const view = of.get(name);
      const words = view === undefined ? "" : view.used ? `${view.rms_px?.toFixed(2)} px` : "left out";
      return html`<li key=${name}>
        <img src=${`./api/v1/boards/${name}`} alt=${`Picture ${Number.parseInt(name, 10)}`} loading="lazy" title=${view?.reason ?? ""} />
        <span>${words}</span>
        <button type="button" class="quiet" aria-label=${`Remove picture ${Number.parseInt(name, 10)}`} onClick=${() => remove(name)}>✕</button>
      </li>`;
    })}
  </ul>`;
}

/** How exact the lens is: over the picture, and in words. */
function Verdict() {
  const of = solved.value;
  if (of === null) return null;
  const { columns, rows, values_px, worst_px } = of.uncertainty_map;
  return html`<section aria-label="The computed lens">
    <p class=${draft.value.calibration === null ? "warned" : "good"}>${sentence(of.sentence)}</p>
    <div class="map" role="img" aria-label=${`Uncertainty over the picture, ${worst_px.toFixed(2)} px at worst`} style=${{ gridTemplateColumns: `repeat(${columns}, 1fr)`, aspectRatio: of.width / of.height }}>
      ${Array.from({ length: columns * rows }, (_, k) => html`<span key=${k} style=${{ opacity: Math.min(1, (values_px[k] ?? worst_px) / Math.max(worst_px, 1e-6)) }}></span>`)}
    </div>
    <p class="note">Uncertainty over the picture, ${worst_px.toFixed(2)} px at worst. ${of.next_picture ? sentence(`next: ${of.next_picture}`) : ""}</p>
  </section>`;
}

export function BoardCapture() {
  useEffect(() => void list(), [draft.value.columns, draft.value.rows]);
  useEffect(() => (takes.value ? watch() : undefined), [takes.value]);
  useEffect(() => () => void (takes.value = false), []);
  const of = seen.value;
  const count = of?.pictures.length ?? 0;
  const isSize = [draft.value.columns, draft.value.rows, draft.value.square].every((text) => number(text) !== null);
  return html`<${Which} />
    <div class="row">
      <button type="button" aria-pressed=${takes.value ? "true" : "false"} disabled=${barred.value !== null || head.value === null || !isSize} onClick=${() => (takes.value = !takes.value)}>${takes.value ? "Stop" : "Take pictures"}</button>
      <button type="button" disabled=${barred.value !== null || count < 3 || !isSize || working.value !== null} onClick=${solve}>Compute the lens</button>
    </div>
    <p role="status">${takes.value && of?.seen ? WORDS[/** @type {keyof typeof WORDS} */ (of.seen)] : ""} ${takes.value && of?.next ? sentence(`next: ${of.next}`) : ""}</p>
    ${count > 0 ? html`<p class="note">${count === 1 ? "1 picture" : `${count} pictures`}${of?.good ? ": a good set." : of && of.missing_sides.length > 0 ? `. Not tilted yet: ${of.missing_sides.join(", ")} side away.` : "."}</p>` : null}
    <p class="refused" role="alert">${said.value}</p>
    <${Working} />
    <${Verdict} />
    <${Pictures} />`;
}
