// Work of the daemon that takes its time: begun here, with progress, and cancelled here.
import { computed, signal } from "../vendor/signals.js";
import { ask, content, post, reason, send, sentence } from "../ask.js";
import { job } from "../events.js";
import { html } from "../ui.js";

/** What each kind of work is called while it runs. @type {Record<string, string>} */
const TITLES = { check: "Looking through the pan", survey: "Measuring the stage", map: "Mapping the set", lens: "Computing the lens" };

/** The job that was begun here; null without one. */
const begun = signal(/** @type {number | null} */ (null));
/** Why the last job was not begun, or failed. */
export const fault = signal("");

/** The work of this page that runs. */
export const working = computed(() => (job.value !== null && job.value.state === "running" && job.value.kind in TITLES ? job.value : null));

/** Waits for the end of a job. @param {number} number */
function ended(number) {
  return new Promise((/** @type {(text: string) => void} */ done, fail) => {
    const timer = setInterval(async () => {
      try {
        /** @type {{state: string, text: string}} */
        const now = await content(await fetchJob(number));
        if (now.state === "running") return;
        clearInterval(timer);
        if (now.state === "done") done(now.text);
        else fail(new Error(sentence(now.text)));
      } catch (why) {
        // A daemon that is away may come back; one that forgot the job was started anew.
        if (!(why instanceof Error) || !("status" in why) || why.status !== 404) return;
        clearInterval(timer);
        fail(new Error("stagepose was started anew meanwhile. Begin again."));
      }
    }, 500);
  });
}

/** @param {number} number */
const fetchJob = (number) => ask(`jobs/${number}`);

/**
 * Begins a job and waits for its end. Returns whether it did its work.
 * @param {string} path
 * @param {unknown} wanted
 */
export async function work(path, wanted) {
  fault.value = "";
  try {
    /** @type {{job: number}} */
    const { job: number } = await content(await post(path, wanted));
    begun.value = number;
    await ended(number);
    return true;
  } catch (why) {
    fault.value = reason(why);
    return false;
  } finally {
    begun.value = null;
  }
}

async function cancel() {
  const number = begun.peek() ?? working.peek()?.job;
  if (number !== undefined) await send("DELETE", `jobs/${number}`).catch((/** @type {unknown} */ why) => (fault.value = reason(why)));
}

/** How far it is. */
export function Working() {
  const now = working.value;
  if (now === null && begun.value === null) return fault.value === "" ? null : html`<p class="refused" role="alert">${fault.value}</p>`;
  const done = now?.done ?? 0;
  return html`<div class="working" role="status">
    <p>${now === null ? "Beginning" : TITLES[now.kind]} … ${Math.round(100 * done)} %</p>
    <div class="row"><progress max="1" value=${done} aria-label="Progress"></progress><button type="button" class="quiet" onClick=${cancel}>Cancel</button></div>
  </div>`;
}
