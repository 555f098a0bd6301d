// What was chosen and typed, as it was typed. This browser keeps it: nothing is lost when the page
// is loaded anew, or the daemon ends.
import { effect, signal } from "../vendor/signals.js";
import { parsed } from "../ask.js";

const KEPT_AS = "stagepose.setup";

/** The steps in their order. */
export const STEPS = /** @type {const} */ ([
  { name: "camera", title: "Camera" },
  { name: "lens", title: "Lens" },
  { name: "stage", title: "Stage" },
  { name: "sizes", title: "Sizes" },
  { name: "origin", title: "Origin" },
  { name: "check", title: "Check" },
  { name: "outputs", title: "Outputs" },
]);

/** @import { Kept } from "../types.js" */
/** @import { Unit } from "./lengths.js" */
/** @typedef {typeof STEPS[number]["name"]} StepName */
/** @typedef {Kept & {name: string}} KeptFile a file at the daemon, and its name there */
/** @typedef {{kind: string, to: string}} OutputDraft */
/**
 * @typedef {{
 *   step: StepName,
 *   device: string | null,
 *   controls: Record<string, number> | null,
 *   lens: "guess" | "file", fov: string, calibration: KeptFile | null,
 *   door: "artwork" | "freeze", artwork: KeptFile | null, photo: KeptFile | null,
 *   corners: number[][], former: number[][][],
 *   unit: Unit, width: string, height: string,
 *   point: string, at: string[],
 *   outputs: OutputDraft[], kind: string, to: string,
 *   written: string | null, tag: string | null,
 * }} Draft `device`: the camera's name for the config, null for a played clip; `controls`: what is
 *   locked; `corners`: raw pixels, clockwise from the top left, and `former` the earlier ones;
 *   `written`: the config that this set-up wrote last, and its ETag
 */

/** @type {Draft} */
const EMPTY = {
  step: "camera",
  device: null,
  controls: null,
  lens: "guess",
  fov: "60",
  calibration: null,
  door: "artwork",
  artwork: null,
  photo: null,
  corners: [],
  former: [],
  unit: "m",
  width: "",
  height: "",
  point: "bottom",
  at: ["0", "0", "0"],
  outputs: [],
  kind: "freed",
  to: "",
  written: null,
  tag: null,
};

export const draft = signal(before());

/** @returns {Draft} */
function before() {
  try {
    const kept = /** @type {Partial<Draft> | null} */ (parsed(localStorage.getItem(KEPT_AS) ?? "null"));
    return { ...EMPTY, ...kept };
  } catch {
    return EMPTY;
  }
}

effect(() => {
  try {
    localStorage.setItem(KEPT_AS, JSON.stringify(draft.value));
  } catch {
    // A browser that keeps nothing has it until the page is loaded anew.
  }
});

/** Changes some of it. @param {Partial<Draft>} part */
export function change(part) {
  draft.value = { ...draft.peek(), ...part };
}

/** Forgets everything but where outputs go. */
export function startOver() {
  draft.value = EMPTY;
}

/** The step after this one; the last is followed by none. @param {StepName} name */
export function after(name) {
  return STEPS[STEPS.findIndex((step) => step.name === name) + 1]?.name ?? name;
}
