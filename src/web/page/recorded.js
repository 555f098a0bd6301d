// Whether a recording runs, and since when, for the bar of every view.
import { effect, signal } from "./vendor/signals.js";
import { session } from "./access.js";
import { read } from "./ask.js";
import { contact } from "./daemon.js";
import { happened } from "./events.js";
import { html } from "./ui.js";

/** When the running recording began, milliseconds since 1970; null without one. */
const since = signal(/** @type {number | null} */ (null));
/** The time now, while a recording runs. */
const now = signal(Date.now());

/** Asks whether one runs that began before this page listened. */
async function ask() {
  try {
    const { recording, recordings } = await read("recordings");
    since.value = recording === null ? null : (recordings.find(({ id }) => recording.endsWith(id))?.begun_unix_ms ?? Date.now());
  } catch {
    // That nobody answers is said elsewhere.
  }
}

/** Begins to follow recordings. */
export function watchRecording() {
  // Without a config there are no recordings to ask for.
  effect(() => void (contact.value && session.value?.has_config && ask()));
  effect(() => {
    const [last] = happened.value;
    if (last?.event === "recorder_started") since.value = last.unix_ms;
    if (last?.event === "recorder_finished" || last?.event === "recorder_stopped") since.value = null;
  });
  setInterval(() => since.peek() !== null && (now.value = Date.now()), 1000);
}

/** Red while a recording runs, with its time. */
export function Recording() {
  if (since.value === null) return null;
  // The daemon's clock may be ahead of this one.
  const seconds = Math.max(0, Math.floor((now.value - since.value) / 1000));
  const two = (/** @type {number} */ value) => `${value}`.padStart(2, "0");
  return html`<span class="rec"><b>REC</b> ${Math.floor(seconds / 60)}:${two(seconds % 60)}</span>`;
}
