// The page's colours: dark, light, or stage (amber on black, for a dark house). This browser keeps
// the choice.
import { effect, signal } from "./vendor/signals.js";

/** The themes' names, as style.css knows them. */
export const THEMES = ["dark", "light", "stage"];
const KEPT_AS = "stagepose.theme";

/** What was chosen before; else what the browser's user prefers. */
function first() {
  try {
    const kept = localStorage.getItem(KEPT_AS);
    if (kept !== null && THEMES.includes(kept)) return kept;
  } catch {
    // A browser that keeps nothing has no choice to remember.
  }
  return matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
}

/** The theme in use. */
export const theme = signal(first());

effect(() => {
  document.documentElement.dataset.theme = theme.value;
  try {
    localStorage.setItem(KEPT_AS, theme.value);
  } catch {
    // As above.
  }
});

let before = "dark";

/** Stage colours on, or back to what was there before. */
export function toggleStage() {
  if (theme.value !== "stage") before = theme.value;
  theme.value = theme.value === "stage" ? before : "stage";
}
