// What happened: the daemon's events, the last of them first.
import { computed, signal } from "./vendor/signals.js";
import { parsed, sentence } from "./ask.js";
import { html } from "./ui.js";

/** Events that are shown; the daemon remembers more. */
const SHOWN = 40;
/** Milliseconds from a lost connection to the next try. */
const TRY_AGAIN = 1000;

/** @import { Happening, Job } from "./types.js" */

/** Whether it is how far a job is. @param {Happening | Job} said @returns {said is Job} */
const isJob = (said) => said.event === "job";

/** The newest first. */
export const happened = signal(/** @type {Happening[]} */ ([]));

/** The last that was heard of a job: work that takes its time. */
export const job = signal(/** @type {Job | null} */ (null));

/** What is the matter with the camera; null while it is open. */
export const trouble = computed(() => {
  const last = happened.value.find(({ event }) => event.startsWith("camera_"));
  return last === undefined || last.event === "camera_opened" ? null : sentence(last.says);
});

/** Begins to listen. */
export function listenToEvents() {
  const address = new URL("ws/events", document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(address);
  // Each connection begins with what is remembered.
  let isFirst = true;
  socket.onmessage = (/** @type {MessageEvent<string>} */ { data }) => {
    const said = /** @type {Happening | Job} */ (parsed(data));
    if (isJob(said)) job.value = said;
    // How far something is fills no list.
    if (isJob(said) && said.state === "running") return;
    happened.value = [said, ...(isFirst ? [] : happened.value)].slice(0, SHOWN);
    isFirst = false;
  };
  socket.onclose = () => setTimeout(listenToEvents, TRY_AGAIN);
}

const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });

/** The list of what happened. */
export function Happened() {
  return html`<section class="happened" aria-labelledby="happened">
    <h2 id="happened">Events</h2>
    <ol tabindex="0">
      ${happened.value.map(
        ({ unix_ms, level, says }, k) => html`<li key=${happened.value.length - k} class=${level}>
          <time datetime=${new Date(unix_ms).toISOString()}>${clock.format(unix_ms)}</time> ${sentence(says)}
        </li>`,
      )}
    </ol>
  </section>`;
}
