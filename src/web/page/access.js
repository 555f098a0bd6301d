// Who may change something: the show lock, and the pairing of a browser on another machine.
import { computed, effect, signal } from "./vendor/signals.js";
import { useRef, useState } from "./vendor/hooks.js";
import { ask, parsed, post, reason, sentence, whenRefused } from "./ask.js";
import { contact } from "./daemon.js";
import { draft } from "./drafts.js";
import { html, typed } from "./ui.js";

/** Milliseconds between two looks at the session: another page may have locked it. */
const LOOKS_EVERY = 2000;
/** Milliseconds that the lock is held to release it: nobody does so by mistake. */
const HELD_FOR = 1000;
/** Letters of the name that a browser is listed by. */
const LONGEST_NAME = 60;

/** @import { Signal } from "./vendor/signals.js"
 * @import { Session } from "./types.js" */

/** How this browser stands; null until that is known. */
export const session = signal(/** @type {Session | null} */ (null));
/** Whether the box for the code is open. */
const isPairing = signal(false);
/** Why the lock was not turned, as a sentence. */
export const unturned = signal("");

/** Why nothing can be changed just now; null where it can. */
export const barred = computed(() => {
  if (contact.value === false) return "stagepose does not answer: nothing can be changed.";
  if (session.value?.needs_pairing) return "This browser is not paired: it can show everything, but change nothing.";
  if (session.value?.locked) return "The show lock is on: nothing can be changed. Hold “Locked” in the top bar for a second to release it.";
  return null;
});

/** The session as it came last: the same words say nothing new. */
let heard = "";

async function look() {
  if (document.hidden || contact.value === false) return;
  try {
    const text = await (await ask("session")).text();
    if (text === heard) return;
    heard = text;
    const found = /** @type {Session} */ (parsed(text));
    // A page of another version does not know what this daemon says.
    if (session.peek() !== null && session.peek()?.page !== found.page) location.reload();
    session.value = found;
  } catch {
    // That nobody answers is said elsewhere.
  }
}

/** Begins to look. */
export function watchAccess() {
  setInterval(look, LOOKS_EVERY);
  // At once when the daemon is there, or there again.
  effect(() => void (contact.value && look()));
  whenRefused.add((status, isChange) => {
    // What the page reads by itself opens no box.
    if (status === 401 && isChange) isPairing.value = true;
    if (status === 401 || status === 423) void look();
  });
}

/** @param {"lock" | "unlock"} which */
async function turn(which) {
  unturned.value = "";
  try {
    await post(which);
  } catch (why) {
    unturned.value = reason(why);
  }
  await look();
}

/** The show lock in the bar: a press locks, holding it for a second unlocks, by mouse or by key. */
export function Lock() {
  const timer = useRef(/** @type {ReturnType<typeof setTimeout> | undefined} */ (undefined));
  const [isHeld, setHeld] = useState(false);
  // The press that has just released the lock, or was too short for it, does not lock.
  const began = useRef(false);
  if (session.value === null) return null;
  const { locked } = session.value;
  const down = (/** @type {PointerEvent | KeyboardEvent} */ event) => {
    // The pointer stays this button's, wherever it trembles to.
    if (event instanceof PointerEvent) /** @type {HTMLElement} */ (event.currentTarget).setPointerCapture(event.pointerId);
    began.current = locked;
    if (!locked || isHeld) return;
    setHeld(true);
    timer.current = setTimeout(() => turn("unlock").then(() => setHeld(false)), HELD_FOR);
  };
  const up = () => {
    clearTimeout(timer.current);
    setHeld(false);
  };
  const isKey = (/** @type {KeyboardEvent} */ { key }) => key === " " || key === "Enter";
  return html`<button
      type="button"
      class="lock ${isHeld ? "held" : ""}"
      aria-pressed=${locked ? "true" : "false"}
      title=${locked ? "Hold for a second to release the show lock" : "Show lock: nothing can be changed while it is on"}
      onPointerDown=${down}
      onPointerUp=${up}
      onPointerCancel=${up}
      onKeyDown=${(/** @type {KeyboardEvent} */ event) => isKey(event) && !event.repeat && down(event)}
      onContextMenu=${(/** @type {Event} */ event) => event.preventDefault()}
      onKeyUp=${up}
      onBlur=${up}
      onClick=${() => !locked && !began.current && turn("lock")}
    >
      ${locked ? (isHeld ? "Hold …" : "Locked") : "Lock"}
    </button>`;
}

/** Says why the controls below do nothing, with the way out. */
export function Barred() {
  if (barred.value === null) return null;
  return html`<p class="barred">
    ${barred.value} ${session.value?.needs_pairing ? html`<button type="button" onClick=${() => (isPairing.value = true)}>Pair …</button>` : null}
  </p>`;
}

/**
 * A button that changes something.
 * @param {{act: () => void, children: unknown, off?: boolean}} props
 */
export function Change({ act, children, off = false }) {
  return html`<button type="button" disabled=${off || barred.value !== null} onClick=${act}>${children}</button>`;
}

/**
 * A link to a file of the daemon; only a paired browser gets it.
 * @param {{path: string, name?: string, children: unknown}} props
 */
export function Download({ path, name, children }) {
  if (session.value?.needs_pairing) return html`<button type="button" aria-label=${name} onClick=${() => (isPairing.value = true)}>${children}</button>`;
  return html`<a class="button" href=${`./api/v1/${path}`} download aria-label=${name}>${children}</a>`;
}

/** Says what is wrong with the config in the file, where it is not used. */
export function ConfigFault() {
  const findings = session.value?.findings ?? [];
  if (findings.length === 0) return null;
  return html`<section class="barred config" role="alert">
    <p>
      ${session.value?.has_config ? "The config file has an error. The previous config stays active." : "No usable config: nothing is tracked."}
      ${findings.map(({ line, sentence: words, mend }) => ` ${[line ? `Line ${line}: ${words}` : words, mend].filter(Boolean).map((part) => sentence(`${part}`)).join(" ")}`)}
      ${session.value?.has_config ? null : html` <a href=${"#setup"}>Set the stage up</a>`}
    </p>
  </section>`;
}

/** What is typed in the box is kept while it is closed. */
const code = draft("code");
const name = draft("name");
const tried = signal("");

/** @param {Event} event */
async function pair(event) {
  event.preventDefault();
  tried.value = "";
  try {
    await post("pair", { code: code.value.replace(/\s/g, ""), name: name.value.trim() || "A browser" });
    code.value = "";
    isPairing.value = false;
  } catch (why) {
    tried.value = reason(why);
  }
  await look();
}

/** The box for the code, where this browser may not yet do what it was asked to. */
export function Pairing() {
  if (!isPairing.value || session.value?.needs_pairing === false) return null;
  const into = (/** @type {Signal<string>} */ kept) => (/** @type {Event} */ event) => (kept.value = typed(event));
  return html`<section class="pairing" aria-labelledby="pairing">
    <h2 id="pairing">Pair this browser</h2>
    <p>On the daemon's machine, <code>stagepose pair</code> prints a code of eight digits. It works once.</p>
    <form onSubmit=${pair}>
      <label class="field"><span>Code</span><input inputmode="numeric" autocomplete="one-time-code" maxlength="20" required value=${code.value} onInput=${into(code)} /></label>
      <label class="field"><span>Name of this browser</span><input maxlength=${LONGEST_NAME} placeholder="Anna's tablet" value=${name.value} onInput=${into(name)} /></label>
      <div class="row">
        <button type="submit">Pair</button>
        <button type="button" onClick=${() => (isPairing.value = false)}>Not now</button>
      </div>
    </form>
    ${tried.value ? html`<p class="refused" role="alert">${tried.value}</p>` : null}
  </section>`;
}
