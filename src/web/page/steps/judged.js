// What the daemon says of the draft, before anything is written: each finding at its step.
import { computed, effect, signal } from "../vendor/signals.js";
import { barred, session } from "../access.js";
import { content, reason, send } from "../ask.js";
import { config } from "./config.js";

/** @import { Finding } from "../types.js" */
/** @import { StepName } from "./draft.js" */

/** Milliseconds after the last change until the daemon is asked. */
const ASKS_AFTER = 400;

/** Findings about the draft; empty before it is complete. */
const findings = signal(/** @type {Finding[]} */ ([]));
/** Why the daemon was not asked; empty if it was. */
export const unasked = signal("");

/** Where what a key says is changed. @type {[RegExp, StepName][]} */
const PLACES = [
  [/output/, "outputs"],
  [/origin/, "origin"],
  [/size_m/, "sizes"],
  [/surface|image|photo|corners/, "stage"],
  [/device|controls|fps|format/, "camera"],
  [/camera|calibration|fov/, "lens"],
];

/** @param {Finding} of @returns {StepName} */
function stepOf({ key, sentence }) {
  if (key === null) return /from its corners and the lens|size_m/.test(sentence) ? "sizes" : "check";
  return PLACES.find(([pattern]) => pattern.test(key))?.[1] ?? "check";
}

/** Findings by step; also of the config that the daemon refused to use. */
export const found = computed(() => {
  /** @type {Partial<Record<StepName, Finding[]>>} */
  const by = {};
  // That there is no config yet is no finding: it is being made.
  const refused = (session.value?.findings ?? []).filter(({ sentence }) => !sentence.includes("there is no config yet"));
  for (const finding of [...findings.value, ...refused]) (by[stepOf(finding)] ??= []).push(finding);
  return by;
});

/** @param {string} text */
async function judge(text) {
  try {
    /** @type {{findings: Finding[]}} */
    const said = await content(await send("POST", "config/check", new Blob([text], { type: "text/plain" })));
    if (config.peek() === text) findings.value = said.findings;
    unasked.value = "";
  } catch (why) {
    unasked.value = reason(why);
  }
}

/** Asks from now on; what it returns ends it. */
export function watchFindings() {
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  const stop = effect(() => {
    const text = config.value;
    const why = barred.value;
    clearTimeout(timer);
    unasked.value = why ?? "";
    if (text === null) findings.value = [];
    else if (why === null) timer = setTimeout(() => judge(text), ASKS_AFTER);
  });
  return () => {
    clearTimeout(timer);
    stop();
  };
}
