// The page's views, and which is shown: the part of the address after the hash, so that links and
// the back button work.
import { signal } from "./vendor/signals.js";

/** The views that there are, with their keys. */
export const PAGES = [
  { name: "live", title: "Live", key: "1" },
  { name: "setup", title: "Setup", key: "2" },
  { name: "set", title: "Set", key: "3" },
  { name: "recordings", title: "Recordings", key: "4" },
  { name: "health", title: "Health", key: "5" },
];

/**
 * @typedef {{key: string, name: string, does: string, act: () => unknown}} Key what a single key
 *   does; one without a name is another key for the previous action
 */

/** Keys of the view that is shown, beside those of the page. */
export const viewKeys = signal(/** @type {Key[]} */ ([]));

/** The view that is shown. */
export const shown = signal(named());

function named() {
  const name = location.hash.slice(1);
  return PAGES.some((page) => page.name === name) ? name : "live";
}

addEventListener("hashchange", () => (shown.value = named()));

/** Shows a view. @param {string} name */
export function show(name) {
  location.hash = name;
}
