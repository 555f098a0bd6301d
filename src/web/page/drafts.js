// Keeps what was typed and not yet sent while this tab is open: it is there again after the page
// reloads itself, after an update of the daemon.
import { effect, signal } from "./vendor/signals.js";

/** A text that is kept. @param {string} name */
export function draft(name) {
  const kept = `stagepose.draft.${name}`;
  const text = signal(before(kept));
  effect(() => {
    try {
      sessionStorage.setItem(kept, text.value);
    } catch {
      // A browser that keeps nothing has it until the page is loaded anew.
    }
  });
  return text;
}

/** @param {string} kept */
function before(kept) {
  try {
    return sessionStorage.getItem(kept) ?? "";
  } catch {
    return "";
  }
}
