// The daemon keeps the set beside its config, for every browser. What cannot be saved now stays in
// this browser and is saved as soon as possible. If another browser changed the set meanwhile, the
// user chooses.
import { effect, signal } from "./vendor/signals.js";
import { barred } from "./access.js";
import { Refused, ask, content, parsed, reason, send } from "./ask.js";
import { fetchModels } from "./models.js";
import { asSet, replace, set } from "./things.js";

/** Milliseconds after the last change until it is saved. */
const SAVES_AFTER = 500;
/** What this browser and the daemon last agreed on. */
const AGREED_AS = "stagepose.set.agreed";

/** @typedef {{text: string, tag: string | null}} Agreed */

/** How it stands, as a sentence. */
export const saved = signal("");
/** Whether another browser has changed the set while this one did. */
export const isTorn = signal(false);

/** @type {Agreed | null} */
let agreed = null;
/** The daemon's set, where it is not this one's. @type {Agreed | null} */
let theirs = null;
let isBusy = false;

const text = () => JSON.stringify(set.peek());

/** @param {Agreed | null} on */
function agree(on) {
  agreed = on;
  theirs = null;
  isTorn.value = false;
  try {
    localStorage.setItem(AGREED_AS, JSON.stringify(on));
  } catch {
    // A browser that keeps nothing asks the daemon each time.
  }
}

/** @returns {Agreed | null} */
function agreedBefore() {
  try {
    return /** @type {Agreed | null} */ (parsed(localStorage.getItem(AGREED_AS) ?? "null"));
  } catch {
    return null;
  }
}

/** The daemon's set, and who is right where there are two. */
async function load() {
  const answer = await ask("set");
  const tag = answer.headers.get("ETag");
  const found = asSet(await content(answer));
  if (found === null) {
    saved.value = "Not saved: the daemon has a set that this page cannot read. Move set.json away from the folder of the config.";
    return;
  }
  const of = { text: JSON.stringify(found), tag };
  const before = agreedBefore();
  const isMineNew = text() !== before?.text && set.peek().objects.length > 0;
  if (of.text === text()) agree(of);
  else if (!isMineNew) {
    replace(found);
    agree(of);
  } else if (found.objects.length === 0 || tag === before?.tag) agreed = of;
  else tear(of);
}

/** @param {Agreed} of the daemon's */
function tear(of) {
  theirs = of;
  isTorn.value = true;
  saved.value = "Not saved: another browser changed the set.";
}

/** Saves what is not saved. */
async function save() {
  if (isBusy || isTorn.value) return;
  isBusy = true;
  try {
    if (agreed === null) await load();
    while (agreed !== null && !isTorn.value && agreed.text !== text()) {
      const now = text();
      saved.value = "Saving …";
      /** @type {Record<string, string>} */
      const held = agreed.tag === null ? {} : { "If-Match": agreed.tag };
      const answer = await send("PUT", "set", parsed(now), held);
      agree({ text: now, tag: answer.headers.get("ETag") });
    }
    if (agreed?.text === text()) saved.value = "Saved beside the config.";
  } catch (why) {
    if (why instanceof Refused && why.status === 412) await meet();
    else saved.value = `Not saved yet; this browser keeps it. ${reason(why)}`;
  }
  isBusy = false;
}

/** Somebody else has saved meanwhile. */
async function meet() {
  try {
    const answer = await ask("set");
    tear({ text: JSON.stringify(asSet(await content(answer))), tag: answer.headers.get("ETag") });
  } catch (why) {
    saved.value = `Not saved yet; this browser keeps it. ${reason(why)}`;
  }
}

/** This browser's set takes the place of the other. */
export function keepMine() {
  agree(theirs);
  void save();
}

/** The other's set takes the place of this one. */
export function takeTheirs() {
  const found = asSet(parsed(theirs?.text ?? "null"));
  if (found === null) return;
  const of = theirs;
  replace(found);
  agree(of);
  saved.value = "Saved beside the config.";
}

/** Keeps the set from now on; what it returns ends it. */
export function keepSet() {
  agreed = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  const stop = effect(() => {
    // After each change, and as soon as something can be changed again.
    void [set.value, barred.value];
    clearTimeout(timer);
    timer = setTimeout(save, agreed === null ? 0 : SAVES_AFTER);
  });
  const stopModels = effect(() => void fetchModels(set.value.objects.flatMap(({ file }) => (file === undefined ? [] : [file]))));
  return () => {
    clearTimeout(timer);
    stop();
    stopModels();
    if (agreed !== null) void save();
  };
}
