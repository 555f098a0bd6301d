// What is on the set. This browser keeps it with every change, so that no input is lost, and so
// does the daemon (keeping.js).
import { effect, signal } from "./vendor/signals.js";
import { parsed } from "./ask.js";

/**
 * @typedef {"cone" | "cube" | "grid" | "model"} Kind
 * @typedef {{id: string, kind: Kind, name: string, on: string, position_m: number[], rotation_deg:
 *   number[], size_m: number[], colour: string, shown: boolean, file?: string}} Thing `on` is
 *   "floor" or a surface's number; position, rotation (about z, then y, then x) and size are in
 *   that frame
 * @typedef {{objects: Thing[], floor_m: number | null}} Kept `floor_m` is the floor's height, or
 *   null for the stage's lowest point
 */

const KEPT_AS = "stagepose.set";
/** Former sets that can be had back. */
const REMEMBERED = 100;

/**
 * What a thing of each kind is at first.
 * @type {Record<Kind, {name: string, size_m: number[], colour: string}>}
 */
const FIRST = {
  cone: { name: "Cone", size_m: [0.4, 0.4, 0.6], colour: "#e8762d" },
  cube: { name: "Cube", size_m: [0.5, 0.5, 0.5], colour: "#3d8bd4" },
  grid: { name: "Grid", size_m: [4, 4, 1], colour: "#ff9d2e" },
  model: { name: "Model", size_m: [1, 1, 1], colour: "#ffffff" },
};

/** @returns {Kept} */
function kept() {
  try {
    const text = localStorage.getItem(KEPT_AS);
    const found = text === null ? null : parsed(text);
    const set = asSet(found);
    if (set !== null) return set;
  } catch {
    // A browser that keeps nothing, or something else, begins with an empty set.
  }
  return { objects: [], floor_m: null };
}

/**
 * A set in this page's form; null if it is not one.
 * @param {unknown} found
 * @returns {Kept | null}
 */
export function asSet(found) {
  const { objects, floor_m } = fields(found);
  if (!Array.isArray(objects) || !objects.every(isThing)) return null;
  return { objects, floor_m: typeof floor_m === "number" && Number.isFinite(floor_m) ? floor_m : null };
}

/**
 * The fields of an object; none if it is not an object.
 * @param {unknown} one
 * @returns {Record<string, unknown>}
 */
function fields(one) {
  return one instanceof Object ? { ...one } : {};
}

/** @param {unknown} one @returns {one is Thing} */
function isThing(one) {
  const { id, kind, position_m, rotation_deg, size_m } = fields(one);
  const threes = [position_m, rotation_deg, size_m];
  return typeof id === "string" && typeof kind === "string" && Object.hasOwn(FIRST, kind) && threes.every((three) => Array.isArray(three) && three.length === 3 && three.every(Number.isFinite));
}

/** The set as it is now. */
export const set = signal(kept());
/** The thing that is being changed. */
export const chosen = signal(/** @type {string | null} */ (null));
/** @type {Kept[]} */
const former = [];

effect(() => {
  try {
    localStorage.setItem(KEPT_AS, JSON.stringify(set.value));
  } catch {
    // As above.
  }
});

/** Changes the set; `undo` has the former one back. @param {Partial<Kept>} by */
export function change(by) {
  former.push(set.value);
  if (former.length > REMEMBERED) former.shift();
  set.value = { ...set.value, ...by };
}

/** Takes over the set that the daemon has. @param {Kept} other */
export function replace(other) {
  former.length = 0;
  set.value = other;
  if (!other.objects.some(({ id }) => id === chosen.value)) chosen.value = null;
}

/** The set as it was before the last change. */
export function undo() {
  const last = former.pop();
  if (last !== undefined) set.value = last;
}

/** Metres between new things. */
const BESIDE = 1.2;

/** A new thing, which is then chosen. @param {Kind} kind @param {Partial<Thing>} [with_] */
export function add(kind, with_ = {}) {
  const { name, size_m, colour } = FIRST[kind];
  const id = `${Date.now().toString(36)}${Math.floor(Math.random() * 1e9).toString(36)}`;
  const count = set.value.objects.filter((thing) => thing.kind === kind).length;
  // Beside the ones that are there already.
  const beside = [Math.ceil(set.value.objects.length / 2) * BESIDE * (set.value.objects.length % 2 === 0 ? -1 : 1) || 0, 0, 0];
  const thing = { id, kind, name: count === 0 ? name : `${name} ${count + 1}`, on: "floor", position_m: beside, rotation_deg: [0, 0, 0], size_m: [...size_m], colour, shown: true };
  change({ objects: [...set.value.objects, { ...thing, ...with_ }] });
  chosen.value = id;
}

/** Changes a thing. @param {string} id @param {Partial<Thing>} by */
export function alter(id, by) {
  change({ objects: set.value.objects.map((thing) => (thing.id === id ? { ...thing, ...by } : thing)) });
}

/** Takes a thing off the set. @param {string} id */
export function remove(id) {
  change({ objects: set.value.objects.filter((thing) => thing.id !== id) });
  if (chosen.value === id) chosen.value = null;
}
