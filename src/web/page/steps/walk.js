// The walk that measures the stage (survey) or maps a set: a recording that is guided to what is
// missing, the computation with its progress, and the result to accept or to leave.
import { computed, signal } from "../vendor/signals.js";
import { useEffect } from "../vendor/hooks.js";
import { barred } from "../access.js";
import { ask, content, post, reason, sentence } from "../ask.js";
import { head, scene } from "../daemon.js";
import { html } from "../ui.js";
import { change, draft } from "./draft.js";
import { isTracking } from "./force.js";
import { readBack } from "./fromconfig.js";
import { Working, work, working } from "./jobs.js";
import { begin, end, since } from "./recording.js";
import { seenFrom } from "./walked.js";

/** @import { Walked } from "./walked.js" */
/**
 * @typedef {{verdict: string, reasons: string[], frames?: number, found?: number, keyframes: number,
 *   rms_px: number | {configured: number | null, surveyed: number},
 *   surfaces?: {name: string, position_m: number[], sigma_mm: number, height_mm: {max: number}}[],
 *   size?: {growth: number, sigma: number} | null, facets?: unknown[]}} Result
 */

/** Milliseconds between two looks at the camera. */
const LOOKS_EVERY = 200;

/** Where the camera has been while walking. */
const walked = signal(/** @type {Walked | null} */ (null));
/** The recording to compute from. */
const recorded = signal("");
const said = signal("");
const refines = signal(false);
/** What was computed, and by which command. */
const result = signal(/** @type {{of: "survey" | "map", made: Result} | null} */ (null));
/** The time now, while walking. */
const now = signal(0);

async function start() {
  said.value = "";
  result.value = null;
  walked.value = { places: [], frames: 0, tracked: 0, blurred: 0 };
  await begin().catch((/** @type {unknown} */ why) => (said.value = reason(why)));
}

async function stop() {
  try {
    recorded.value = await end();
  } catch (why) {
    said.value = reason(why);
  }
}

/** Notes where the camera is. */
function watch() {
  const look = () => {
    now.value = performance.now();
    const [of, frame] = [walked.peek(), head.peek()];
    if (of === null || frame === null || since.peek() === null) return;
    const { record, motion, reason: why } = frame;
    const isTracked = record.state === "tracking" && record.pose !== null;
    // Radians a second at which a picture of usual exposure blurs by pixels.
    const isFast = motion !== null && Math.hypot(...motion.turn_rate) > 0.6;
    walked.value = {
      places: isTracked && record.pose !== null ? [...of.places, record.pose.position_m] : of.places,
      frames: of.frames + 1,
      tracked: of.tracked + (isTracked ? 1 : 0),
      blurred: of.blurred + (isFast || why === "blurred" ? 1 : 0),
    };
  };
  const timer = setInterval(look, LOOKS_EVERY);
  return () => clearInterval(timer);
}

/** The middle of the surfaces, and how far they reach. */
const aim = computed(() => {
  const all = scene.value?.stage.surfaces ?? [];
  if (all.length === 0) return null;
  const centre = [0, 1, 2].map((axis) => all.reduce((sum, { pose }) => sum + pose.position_m[axis], 0) / all.length);
  return { centre, width: Math.max(...all.map(({ size_m }) => Math.max(...size_m))) };
});

/** What the walk has, and what it still wants. */
function Guide() {
  const of = walked.value;
  if (of === null || aim.value === null) return null;
  const { wants, facts } = seenFrom(of, aim.value);
  const seconds = since.value === null ? null : Math.floor((now.value - since.value) / 1000);
  return html`<dl class="facts">
      ${seconds === null ? null : html`<div><dt>Time</dt><dd>${seconds} s</dd></div>`}
      ${facts.map(({ name, value }) => html`<div key=${name}><dt>${name}</dt><dd>${value}</dd></div>`)}
    </dl>
    <ul class="todo" aria-label="What is still missing">${wants.map((words) => html`<li key=${words}>${words}</li>`)}</ul>
    ${wants.length === 0 ? html`<p class="good" role="status">Everything has been seen. End the walk.</p>` : null}`;
}

/** @param {"survey" | "map"} command */
async function compute(command) {
  result.value = null;
  const path = `recordings/${recorded.peek()}/${command}`;
  if (!(await work(path, command === "survey" ? { refines_lens: refines.peek() } : {}))) return;
  try {
    result.value = { of: command, made: await content(await ask(path)) };
  } catch (why) {
    said.value = reason(why);
  }
}

async function accept() {
  if (result.value === null) return;
  try {
    await post(`recordings/${recorded.peek()}/${result.value.of}/use`);
    said.value = "The measured stage is in force. The former config is kept.";
    if (await readBack()) {
      // The daemon has what the steps now show.
      const { config } = await import("./config.js");
      change({ written: config.peek() });
    }
  } catch (why) {
    said.value = reason(why);
  }
}

function Outcome() {
  if (result.value === null) return null;
  const { verdict, reasons, surfaces, size, rms_px, keyframes } = result.value.made;
  const isGood = !verdict.includes("not use");
  const before = typeof rms_px === "number" || rms_px.configured === null ? "" : `, ${rms_px.configured.toFixed(3)} px before`;
  const px = typeof rms_px === "number" ? rms_px : rms_px.surveyed;
  return html`<section aria-label="What the walk measured">
    <p class=${isGood ? "good" : "warned"}>${sentence(`verdict: ${verdict}`)} ${reasons.map(sentence).join(" ")}</p>
    <p class="note">${keyframes} views; residual ${px.toFixed(3)} px${before}.${size ? ` The stage is ${(100 * size.growth).toFixed(2)} % larger than typed, known to ${(100 * size.sigma).toFixed(2)} %.` : ""}</p>
    ${(surfaces ?? []).length === 0
      ? null
      : html`<table>
          <thead><tr><th scope="col">Surface</th><th scope="col">Place</th><th scope="col">Bent by</th></tr></thead>
          <tbody>${(surfaces ?? []).map((one) => html`<tr key=${one.name}><th scope="row">${one.name}</th><td>± ${one.sigma_mm.toFixed(1)} mm</td><td>${one.height_mm.max.toFixed(0)} mm</td></tr>`)}</tbody>
        </table>`}
    ${isGood ? html`<div class="row"><button type="button" disabled=${barred.value !== null} onClick=${accept}>Use this stage</button><button type="button" class="quiet" onClick=${() => (result.value = null)}>Leave it</button></div>` : null}
  </section>`;
}

export function Walk() {
  useEffect(watch, []);
  if (!isTracking.value) {
    return html`<p>A walk measures how the surfaces really stand and bend, and the lens; or it maps a set without pictures, from a poster in it.</p>
      <p class="warned">It begins from a stage that is tracked. Give one surface its artwork, or a poster, and go through to step 6. Then come back here.</p>`;
  }
  const isOn = since.value !== null;
  const { surfaces } = draft.value;
  return html`<p>Walk past the stage from one side to the other and back, nearer and farther, the camera higher and lower. Half a minute measures the surfaces; a minute maps a set.</p>
    <div class="row">
      ${isOn ? html`<button type="button" data-first class="recording" onClick=${stop}>End the walk</button>` : html`<button type="button" data-first disabled=${barred.value !== null || working.value !== null} onClick=${start}>${recorded.value === "" ? "Begin the walk" : "Walk again"}</button>`}
    </div>
    <${Guide} />
    ${recorded.value === "" || isOn || working.value !== null
      ? null
      : html`<label class="choice-line"><input type="checkbox" checked=${refines.value} onChange=${(/** @type {Event} */ { target }) => (refines.value = /** @type {HTMLInputElement} */ (target).checked)} /><span>Measure the lens as well</span></label>
          <div class="row">
            <button type="button" disabled=${barred.value !== null} onClick=${() => compute("survey")}>Measure ${surfaces.length === 1 ? "the surface" : "the surfaces"}</button>
            <button type="button" disabled=${barred.value !== null} onClick=${() => compute("map")}>Map the set</button>
          </div>`}
    <${Working} />
    <${Outcome} />
    <p role="status">${said.value}</p>`;
}
