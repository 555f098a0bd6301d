// The draft at the daemon: every browser goes on from it, and none replaces another's unseen.
import { effect, signal } from "../vendor/signals.js";
import { barred, session } from "../access.js";
import { Refused, ask, content, send } from "../ask.js";
import { html } from "../ui.js";
import { draft, takeDraft, whole } from "./draft.js";
import { readBack } from "./fromconfig.js";

/** @import { Draft } from "./draft.js" */

/** Milliseconds after the last change until it is kept. */
const AFTER = 500;
/** Milliseconds until another try, where the daemon was away. */
const AGAIN = 3000;

/** Another browser's draft, where both were changed. */
const other = signal(/** @type {Draft | null} */ (null));
/** How keeping goes. */
export const keeps = signal(/** @type {"kept" | "waits" | "here"} */ ("here"));

/** The ETag of the daemon's draft, null before it is known, and when the draft that it has was edited. */
let tag = /** @type {string | null} */ (null);
let keptEdit = 0;
/** Whether the daemon is being asked. */
let isBusy = false;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let timer;

/** What the daemon has; null if it has none. @returns {Promise<Draft | null>} */
async function fetched() {
  const answer = await ask("setup/draft");
  /** @type {Partial<Draft> | null} */
  const found = await content(answer);
  tag = answer.headers.get("ETag");
  return found === null ? null : whole(found);
}

/** Takes the daemon's draft, or gives it this one: whichever was changed last. */
async function meet() {
  const found = await fetched();
  const own = draft.peek();
  if (found !== null && found.edited > own.edited) {
    keptEdit = found.edited;
    takeDraft(found);
  } else if (found !== null) keptEdit = found.edited;
  else if (own.edited === 0 && session.peek()?.has_config) await readBack();
}

async function keep() {
  const own = draft.peek();
  if (barred.peek() !== null || other.peek() !== null) return;
  clearTimeout(timer);
  if (isBusy) {
    timer = setTimeout(keep, AFTER);
    return;
  }
  isBusy = true;
  try {
    if (tag === null) await meet();
    if (draft.peek().edited <= keptEdit) {
      keeps.value = "kept";
      return;
    }
    const { edited } = draft.peek();
    const { surfaces, ...rest } = draft.peek();
    // How corners were moved is this browser's.
    const sent = { ...rest, surfaces: surfaces.map((one) => ({ ...one, former: [] })) };
    const answer = await send("PUT", "setup/draft", sent, tag === null ? {} : { "If-Match": tag });
    [tag, keptEdit] = [answer.headers.get("ETag"), edited];
    keeps.value = "kept";
  } catch (why) {
    keeps.value = "waits";
    if (why instanceof Refused && why.status === 412) {
      const found = await fetched().catch(() => null);
      if (found !== null && own.edited > 0) other.value = found;
      return;
    }
    timer = setTimeout(keep, AGAIN);
  } finally {
    isBusy = false;
  }
}

/** Keeps the draft from now on; what it returns ends it. */
export function watchDraft() {
  tag = null;
  const stop = effect(() => {
    // Also once the lock is off, the daemon back, or known to have a config.
    void [draft.value.edited, barred.value, other.value, session.value?.has_config];
    clearTimeout(timer);
    timer = setTimeout(keep, tag === null ? 0 : AFTER);
  });
  return () => {
    clearTimeout(timer);
    stop();
  };
}

/** @param {boolean} isTheirs */
function settle(isTheirs) {
  const theirs = other.peek();
  if (theirs !== null && isTheirs) {
    keptEdit = theirs.edited;
    takeDraft(theirs);
  } else keptEdit = 0;
  other.value = null;
}

/** Asks which of two drafts counts. */
export function Two() {
  if (other.value === null) return null;
  return html`<section class="barred two" role="alert">
    <p>Another browser changed this set-up as well. What is typed here stays until you choose.</p>
    <div class="row"><button type="button" onClick=${() => settle(false)}>Keep what is here</button><button type="button" onClick=${() => settle(true)}>Take the other</button></div>
  </section>`;
}
