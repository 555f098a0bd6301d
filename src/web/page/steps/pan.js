// The check of a set-up: a slow pan of ten seconds is recorded, the daemon looks through it as
// `stagepose check --clip` does, and each finding comes with its remedy.
import { computed, signal } from "../vendor/signals.js";
import { useEffect } from "../vendor/hooks.js";
import { barred } from "../access.js";
import { ask, content, reason, sentence } from "../ask.js";
import { head } from "../daemon.js";
import { rested } from "../picture.js";
import { amount, html } from "../ui.js";
import { change, draft } from "./draft.js";
import { work, working, Working } from "./jobs.js";
import { begin, end, since } from "./recording.js";
import { remedies } from "./remedies.js";

/** @import { Head } from "../types.js" */
/** @typedef {{grade: "fault" | "doubt" | "warning" | "note", message: string}} Diagnosed */
/**
 * @typedef {{verdict: string, good: boolean, findings: Diagnosed[], shutter: string[],
 *   frames: {all: number, found: number, followed: number, given: number} | null}} Checked
 */

/** Seconds of the pan. */
const LASTS = 10;
/** Columns and rows into which residuals are gathered. */
const [COLUMNS, ROWS] = [4, 3];
/** Tiles of which a part of the picture needs this many before it is judged. */
const ENOUGH = 8;

/** What the last pan showed. */
const checked = signal(/** @type {Checked | null} */ (null));
const said = signal("");
/** Seconds that are left; null while nothing is recorded. */
const left = signal(/** @type {number | null} */ (null));
/** Residuals by part of the picture, pixels. */
let gathered = /** @type {number[][]} */ ([]);
/** The parts of the picture where the residuals are largest. */
const worst = signal(/** @type {{name: string, px: number}[]} */ ([]));

const VERTICAL = ["top", "middle", "bottom"];
const HORIZONTAL = ["far left", "left", "right", "far right"];

/** @param {number} k */
const nameOf = (k) => `${VERTICAL[Math.floor(k / COLUMNS)]}, ${HORIZONTAL[k % COLUMNS]}`;

/** @param {number[]} values */
const middle = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

/** Gathers the residuals of a frame. @param {Head} said */
function gather({ displaced, size }) {
  for (let k = 0; displaced && k + 3 < displaced.length; k += 4) {
    const [x, y, dx, dy] = displaced.slice(k, k + 4);
    const [column, row] = [Math.floor((COLUMNS * x) / size[0]), Math.floor((ROWS * y) / size[1])];
    gathered[Math.min(Math.max(row, 0), ROWS - 1) * COLUMNS + Math.min(Math.max(column, 0), COLUMNS - 1)].push(Math.hypot(dx, dy));
  }
}

async function pan() {
  said.value = "";
  checked.value = null;
  gathered = Array.from({ length: COLUMNS * ROWS }, () => []);
  const before = rested.peek();
  let stop = () => {};
  try {
    await begin();
    rested.value = true;
    stop = head.subscribe((now) => now !== null && gather(now));
    for (left.value = LASTS; left.value > 0; left.value -= 1) await new Promise((done) => setTimeout(done, 1000));
    left.value = null;
    const id = await end();
    const judged = gathered.flatMap((px, k) => (px.length >= ENOUGH ? [{ name: nameOf(k), px: middle(px) }] : []));
    worst.value = judged.sort((a, b) => b.px - a.px).slice(0, 3);
    if (await work(`recordings/${id}/check`, {})) checked.value = await content(await ask(`recordings/${id}/check`));
  } catch (why) {
    said.value = reason(why);
  } finally {
    stop();
    rested.value = before;
    left.value = null;
  }
}

/** Milliseconds from a frame's exposure to its pose; null before that is known. */
const latency = signal(/** @type {number | null} */ (null));

/** How late poses are, as long as this is shown. */
function watchLatency() {
  const look = async () => {
    try {
      const { age_s } = /** @type {{age_s: number | null}} */ (await content(await ask("state")));
      latency.value = age_s === null ? null : 1000 * age_s;
    } catch {
      latency.value = null;
    }
  };
  void look();
  const timer = setInterval(look, 1000);
  return () => clearInterval(timer);
}

const GRADES = { fault: "Must be mended", doubt: "Should be mended", warning: "Worth a look", note: "To be known" };
const LEVELS = { fault: "error", doubt: "error", warning: "warning", note: "note" };

/** @param {{of: Diagnosed}} props */
function Finding({ of }) {
  const all = remedies(of.message, draft.value);
  return html`<li class=${LEVELS[of.grade]}>
    <b>${GRADES[of.grade]}.</b> ${sentence(of.message)}
    ${all.length === 0 ? null : html`<div class="row">${all.map(({ title, part }) => html`<button key=${title} type="button" onClick=${() => change(part)}>${title}</button>`)}</div>`}
  </li>`;
}

/** What the pan showed: figures, then each finding, worst first. */
function Result() {
  const of = checked.value;
  if (of === null) return null;
  const { frames, findings, shutter, verdict } = of;
  const share = (/** @type {number} */ count) => (frames === null || frames.all === 0 ? "–" : `${Math.round((100 * count) / frames.all)} %`);
  const grave = findings.filter(({ grade }) => grade !== "note");
  const notes = findings.filter(({ grade }) => grade === "note");
  return html`<section aria-label="What the pan showed">
    <p class=${of.good ? "good" : "warned"}>${sentence(`the pan: ${verdict}`)}</p>
    <dl class="facts">
      <div><dt>Found</dt><dd>${share(frames?.found ?? 0)}</dd></div>
      <div><dt>Trusted</dt><dd>${share(frames?.given ?? 0)}</dd></div>
      ${worst.value.length === 0 ? null : html`<div><dt>Worst part</dt><dd>${amount(worst.value[0].px, 2, "px")}</dd></div>`}
    </dl>
    ${worst.value.length === 0 ? null : html`<p class="note">Largest residuals: ${worst.value.map(({ name, px }) => `${name} ${px.toFixed(2)} px`).join("; ")}. If the rim is worse than the middle, the lens is to blame.</p>`}
    ${shutter.length === 0 ? null : html`<p class="note">Shutter: ${shutter.join(" ")}</p>`}
    <ul class="findings">${grave.map((one, k) => html`<${Finding} key=${k} of=${one} />`)}</ul>
    ${notes.length === 0 ? null : html`<details><summary>${notes.length === 1 ? "One note" : `${notes.length} notes`}</summary><ul class="findings">${notes.map((one, k) => html`<${Finding} key=${k} of=${one} />`)}</ul></details>`}
  </section>`;
}

const isBusy = computed(() => left.value !== null || working.value !== null || since.value !== null);

export function Pan() {
  useEffect(watchLatency, []);
  return html`<section class="pan" aria-labelledby="pan">
    <h3 id="pan">A slow pan of ${LASTS} seconds</h3>
    <p class="note">Pan over all of the stage, from one side to the other and back, as slowly as on the show. Poses are ${amount(latency.value, 0, "ms")} old.</p>
    ${left.value !== null
      ? html`<p class="count" role="timer">${left.value} s</p>`
      : html`<div class="row"><button type="button" disabled=${isBusy.value || barred.value !== null} onClick=${pan}>${checked.value === null ? "Begin the pan" : "Pan again"}</button></div>`}
    <p class="refused" role="status">${said.value}</p>
    <${Working} />
    <${Result} />
  </section>`;
}
