// What was chosen and typed, as it was typed. This browser keeps it, and the daemon (kept.js):
// nothing is lost when the page is loaded anew, the daemon ends, or another browser goes on.
import { computed, effect, signal } from "../vendor/signals.js";
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
/** @import { Table } from "./types.js" */
/** @typedef {typeof STEPS[number]["name"]} StepName */
/** @typedef {Kept & {name: string}} KeptFile a file at the daemon, and its name there */
/** @typedef {{kind: string, to: string, more?: Table}} OutputDraft */
/** @typedef {"artwork" | "freeze" | "poster"} Door */
/**
 * @typedef {{
 *   door: Door, artwork: KeptFile | null, photo: KeptFile | null,
 *   corners: number[][], former: number[][][],
 *   paper: string, seed: string,
 *   width: string, height: string,
 *   place: string[], turn: string,
 *   more: Table,
 * }} SurfaceDraft `corners`: raw pixels, clockwise from the top left, and `former` the earlier ones;
 *   `place`: where the centre is from that of the first surface, metres to its right, upstage and up,
 *   and `turn` its degrees about the vertical
 */
/** @typedef {{point: string, at: string[]}} PlacedPoint a point of the first surface, and where it is */
/**
 * @typedef {{
 *   step: StepName,
 *   device: string | null,
 *   controls: Record<string, number> | null,
 *   lens: "guess" | "file" | "board" | "config", fov: string, calibration: KeptFile | null,
 *   columns: string, rows: string, square: string,
 *   surfaces: SurfaceDraft[], surface: number,
 *   unit: Unit,
 *   origin: "point" | "points", point: string, at: string[], turn: string,
 *   clicked: number[] | null, points: PlacedPoint[],
 *   outputs: OutputDraft[], kind: string, to: string,
 *   more: {camera: Table, stage: Table, http: Table, tables: Table},
 *   written: string | null, tag: string | null,
 *   edited: number,
 * }} Draft `device`: the camera's name for the config, null for a played clip; `controls`: what is
 *   locked; `columns`, `rows`, `square`: the calibration board; `surface`: the one that is shown;
 *   `clicked`: a point of the first surface's picture, shares from its left and its top; `written`:
 *   the config that this set-up wrote last, and its ETag; `edited`: when it was changed last,
 *   milliseconds since 1970, 0 for never
 */

/** @type {SurfaceDraft} */
export const NEW_SURFACE = {
  door: "artwork",
  artwork: null,
  photo: null,
  corners: [],
  former: [],
  paper: "a3",
  seed: "1",
  width: "",
  height: "",
  place: ["0", "0", "0"],
  turn: "0",
  more: {},
};

/** @type {Draft} */
const EMPTY = {
  step: "camera",
  device: null,
  controls: null,
  lens: "guess",
  fov: "60",
  calibration: null,
  columns: "9",
  rows: "6",
  square: "24",
  surfaces: [NEW_SURFACE],
  surface: 0,
  unit: "m",
  origin: "point",
  point: "bottom",
  at: ["0", "0", "0"],
  turn: "0",
  clicked: null,
  points: ["bottom left", "bottom right", "top left"].map((point) => ({ point, at: ["", "", ""] })),
  outputs: [],
  kind: "freed",
  to: "",
  more: { camera: {}, stage: {}, http: {}, tables: {} },
  written: null,
  tag: null,
  edited: 0,
};

export const draft = signal(before());

/** @returns {Draft} */
function before() {
  try {
    const kept = /** @type {Partial<Draft> | null} */ (parsed(localStorage.getItem(KEPT_AS) ?? "null"));
    return whole(kept);
  } catch {
    return EMPTY;
  }
}

/** A draft with all that it lacks. @param {Partial<Draft> | null} kept @returns {Draft} */
export function whole(kept) {
  const surfaces = (kept?.surfaces ?? []).map((one) => ({ ...NEW_SURFACE, ...one }));
  return surfaces.length === 0 ? { ...EMPTY, ...kept, surfaces: EMPTY.surfaces, surface: 0 } : { ...EMPTY, ...kept, surfaces };
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
  // Where one looks is no change.
  const isLook = Object.keys(part).every((key) => key === "step" || key === "surface");
  draft.value = { ...draft.peek(), ...part, ...(isLook ? {} : { edited: Date.now() }) };
}

/** Takes another draft in place of this one; the step stays. @param {Draft} other */
export function takeDraft(other) {
  draft.value = { ...other, step: draft.peek().step, surface: Math.min(draft.peek().surface, other.surfaces.length - 1) };
}

/** The surface that is shown. */
export const shown = computed(() => draft.value.surfaces[draft.value.surface] ?? draft.value.surfaces[0]);

/** Changes some of the surface that is shown. @param {Partial<SurfaceDraft>} part */
export function changeSurface(part) {
  const { surfaces, surface } = draft.peek();
  change({ surfaces: surfaces.map((one, k) => (k === surface ? { ...one, ...part } : one)) });
}

/** Adds a surface, and shows it. */
export function addSurface() {
  const { surfaces } = draft.peek();
  change({ surfaces: [...surfaces, NEW_SURFACE], surface: surfaces.length });
}

/** Removes the surface that is shown, if it is not the only one. */
export function removeSurface() {
  const { surfaces, surface } = draft.peek();
  if (surfaces.length > 1) change({ surfaces: surfaces.filter((_, k) => k !== surface), surface: Math.max(0, surface - 1) });
}

/** Begins anew. */
export function startOver() {
  draft.value = { ...EMPTY, edited: Date.now() };
}

/** The step after this one; the last is followed by none. @param {StepName} name */
export function after(name) {
  return STEPS[STEPS.findIndex((step) => step.name === name) + 1]?.name ?? name;
}
