// What the daemon says: asked for a few times a second. Silence is said within a second.
import { signal } from "./vendor/signals.js";

/** Milliseconds from one answer to the next question, and the longest wait for an answer: together below a second. */
const PAUSE = 300;
const PATIENCE = 600;

/** Whether the daemon answers; null until that is known. */
export const contact = signal(/** @type {boolean | null} */ (null));
/** The last answer of /api/v1/state. */
export const state = signal(/** @type {{state: string | null, sequence: number | null, age_s: number | null} | null} */ (null));
/** The last record, where there is one (contract C3 in docs/protocols.md). */
export const record = signal(/** @type {any} */ (null));

/** @param {string} path */
async function ask(path) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
  return answer.ok ? answer.json() : null;
}

async function goOn() {
  try {
    const [known, last] = await Promise.all([ask("/api/v1/state"), ask("/api/v1/pose")]);
    state.value = known;
    record.value = last;
    contact.value = true;
  } catch {
    contact.value = false;
  }
  setTimeout(goOn, PAUSE);
}

/** Begins to ask. */
export function listen() {
  goOn();
}
