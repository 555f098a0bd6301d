// A recording tracked again with today's config: starting it, its progress, and the comparison with
// the recorded results.
import { computed, effect, signal } from "./vendor/signals.js";
import { useEffect } from "./vendor/hooks.js";
import { Change } from "./access.js";
import { content, lines, post, reason, send, sentence } from "./ask.js";
import { clip, fault, go, learnRetracked, playing, retracked, row, whose } from "./clip.js";
import { job } from "./events.js";
import { Drawing } from "./timeline.js";
import { amount, html } from "./ui.js";

/** @import { State } from "./types.js" */

/** Rows whose differences are fetched at once. */
const ROWS = 2000;

/** What became of the last wish. */
const said = signal("");
/** The job that was asked for here, by its number. */
const wanted = signal(/** @type {number | null} */ (null));
/** The job that runs now, whoever asked for it; text is the recording's name. */
const running = computed(() => (job.value?.kind === "retrack" && job.value.state === "running" ? job.value : null));

async function begin() {
  if (clip.value === null) return;
  said.value = "";
  try {
    const begun = /** @type {{job: number}} */ (await content(await post(`recordings/${clip.value.id}/retrack`)));
    wanted.value = begun.job;
    said.value = "Tracking again. The recording does not change.";
  } catch (why) {
    said.value = reason(why);
  }
}

async function cancel() {
  try {
    await send("DELETE", `jobs/${job.value?.job}`);
  } catch (why) {
    said.value = reason(why);
  }
}

/** The recorded and today's, in turns. */
export function swap() {
  if (retracked.value !== null) whose.value = whose.value === "recorded" ? "today" : "recorded";
}

/**
 * @typedef {{row: number, recorded: State, retracked: State, position_mm: number | null}}
 *   Difference a row in both results
 */

/**
 * Goes to the next row whose state differs, or whose poses differ more than in 95 % of the rows.
 */
export async function goToDifference() {
  const [of, found] = [clip.value, retracked.value];
  if (of === null || !found?.compared) return;
  playing.value = false;
  const far = Math.max(found.compared.position_mm?.p95 ?? Infinity, 0);
  const differs = (/** @type {Difference} */ one) => one.recorded !== one.retracked || (one.position_mm !== null && one.position_mm > far);
  try {
    for (let from = row.value + 1; from < of.frames; from += ROWS) {
      const rows = /** @type {Difference[]} */ (await lines(`recordings/${of.id}/retracked/differences?from=${from}&count=${ROWS}`));
      const next = rows.find(differs);
      if (clip.value?.id !== of.id) return;
      if (next) return go(next.row);
    }
    fault.value = "There is no difference after this row.";
  } catch (why) {
    fault.value = reason(why);
  }
}

/**
 * The share of the rows that were tracked.
 * @param {Record<string, number>} states
 * @param {number} rows
 */
function tracked(states, rows) {
  return `${states.tracking ?? 0} of ${rows}`;
}

/** How the two compare, in numbers. */
function Comparison() {
  const of = retracked.value?.compared;
  if (!of) return null;
  const [a, b] = [of.rms_px.recorded, of.rms_px.retracked];
  return html`<table>
      <thead><tr><td></td><th scope="col">Recorded</th><th scope="col">Today</th></tr></thead>
      <tbody>
        <tr><th scope="row">Rows tracked</th><td>${tracked(of.states.recorded, of.rows)}</td><td>${tracked(of.states.retracked, of.rows)}</td></tr>
        <tr><th scope="row">Residual, median</th><td>${amount(a?.median, 2, "px")}</td><td>${amount(b?.median, 2, "px")}</td></tr>
        <tr><th scope="row">Residual, 95th percentile</th><td>${amount(a?.p95, 2, "px")}</td><td>${amount(b?.p95, 2, "px")}</td></tr>
      </tbody>
    </table>
    <p class="note">
      ${of.same_record === of.rows
        ? "Today's config gives identical records."
        : of.both_tracked === 0
          ? "No row was tracked by both."
          : `In ${of.both_tracked} rows both were tracked; there the camera's places differ by ${amount(of.position_mm?.median, 2, "mm")} (half of them) and ${amount(of.position_mm?.max, 2, "mm")} at most, the directions by ${amount(of.angle_deg?.max, 3, "°")} at most.`}
    </p>`;
}

/** Asking for it, how far it is, and what came of it. */
export function Retracking() {
  useEffect(
    () =>
      effect(() => {
        const last = job.value;
        if (last === null || last.kind !== "retrack") return;
        // Also one that another page asked for, or this one before it was loaded anew.
        if (last.state === "running" && last.text === clip.value?.id) wanted.value = last.job;
        if (last.state === "running" || last.job !== wanted.peek()) return;
        wanted.value = null;
        said.value = last.state === "done" ? "" : sentence(`tracking again failed: ${last.text}`);
        if (last.state === "done") void learnRetracked();
      }),
    [],
  );
  if (clip.value === null) return null;
  const now = running.value;
  const has = retracked.value !== null;
  return html`<section class="retracking" aria-labelledby="retracking">
    <h2 id="retracking">With today's config</h2>
    ${now === null
      ? html`<${Change} act=${begin}>Track it again<//>`
      : html`<div class="row">
          <progress max="1" value=${now.done} aria-label="Progress"></progress> <span class="note">${Math.round(100 * now.done)}\u00a0% of ${now.text}</span>
          <${Change} act=${cancel}>Stop<//>
        </div>`}
    <p class="note" role="status">${said.value}</p>
    ${has
      ? html`<${Comparison} />
          <fieldset class="choice">
            <legend>Outlines</legend>
            ${/** @type {const} */ (["recorded", "today"]).map(
              (name) => html`<label key=${name}>
                <input type="radio" name="whose" value=${name} checked=${whose.value === name} onChange=${() => (whose.value = name)} />
                <span>${name}</span>
              </label>`,
            )}
          </fieldset>
          <div class="row"><button type="button" onClick=${goToDifference}>Next difference</button></div>`
      : html`<p class="note">Tracks the recorded pictures with the current stage, lens and settings, and compares the results.</p>`}
  </section>`;
}

/** The timeline of today's config, below the recorded one, to the same scale. */
export function Today() {
  if (retracked.value === null) return null;
  return html`<div class="timeline today"><p class="note">With today's config</p><${Drawing} isToday /></div>`;
}
