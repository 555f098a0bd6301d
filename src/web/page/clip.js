// One recording: its timeline, the row that is shown, and playing it at its own pace or another.
import { signal } from "./vendor/signals.js";
import { ask, content, lines, parsed, read, reason } from "./ask.js";

/** Columns of a timeline that are asked for: an hour at 30 frames a second has one a second. */
const COLUMNS = 4000;
/** Rows whose stamps are fetched at once, and the maximum wait for a gap between two rows, ms. */
const STAMPS = 400;
const LONGEST_GAP = 2000;

/** @import { Column, PoseRecord, Retracked, Timeline } from "./types.js" */
/**
 * @typedef {{id: string} & Timeline} Clip
 * @typedef {{row: number, record: PoseRecord | null, today: PoseRecord | null, size: [number,
 *   number] | null}} Shown a row without a picture has no size; `today` is its record by today's
 *   config, if it was tracked again
 */

/** The recording that is open. */
export const clip = signal(/** @type {Clip | null} */ (null));
/** What today's config makes of it; null where that was not tried. */
export const retracked = signal(/** @type {Retracked | null} */ (null));
/** Whose outlines are drawn. */
export const whose = signal(/** @type {"recorded" | "today"} */ ("recorded"));
/** The row that is wanted, and what is shown of it. */
export const row = signal(0);
export const shown = signal(/** @type {Shown | null} */ (null));
export const playing = signal(false);
export const speed = signal(1);
/** What is the matter with the recording, or with the shown row. */
export const fault = signal("");
/** The message that there is no loss in that direction; it stays until another row is wanted. */
export const noLoss = signal("");
/**
 * Functions that draw a row's picture; null if the row has none.
 * @type {Set<(picture: ImageBitmap | null, shown: Shown) => void>}
 */
export const painters = new Set();

/** Ends what was begun for the recording before. */
let open_ = new AbortController();
let isFetching = false;
/** The tick that comes next: there is one at most. */
let ticking = 0;
/**
 * Stamps in milliseconds since the first, in blocks of STAMPS rows.
 * @type {Map<number, number[] | null>}
 */
const stamps = new Map();

/** Opens a recording. @param {string} id */
export async function open(id) {
  close();
  const { signal: own } = open_;
  try {
    const found = await read(`recordings/${id}/timeline?points=${COLUMNS}`, own);
    clip.value = { id, ...found };
    if (found.retracked) await learnRetracked();
    if (own.aborted) return;
    if (found.frames > 0) go(0);
    else fault.value = "This recording has no frames.";
  } catch (why) {
    if (!own.aborted) fault.value = reason(why);
  }
}

/** Fetches what today's config makes of the open recording, and of the row that is shown. */
export async function learnRetracked() {
  if (clip.value === null) return;
  const { signal: own } = open_;
  const found = await read(`recordings/${clip.value.id}/retracked?points=${COLUMNS}`, own).catch(() => null);
  if (own.aborted) return;
  retracked.value = found;
  const now = shown.value;
  const today = now && (await recordToday(now.row, own));
  if (now !== null && shown.value === now && !own.aborted) shown.value = { ...now, today };
}

/**
 * A row's record by today's config.
 * @param {number} number
 * @param {AbortSignal} own
 * @returns {Promise<PoseRecord | null>}
 */
async function recordToday(number, own) {
  if (clip.value === null || retracked.value === null) return null;
  const path = `recordings/${clip.value.id}/retracked/poses?from=${number}&count=1`;
  return ask(path, { signal: own }).then((answer) => content(answer), () => null);
}

/** Closes it. */
export function close() {
  open_.abort();
  open_ = new AbortController();
  stamps.clear();
  clip.value = shown.value = retracked.value = null;
  whose.value = "recorded";
  row.value = 0;
  playing.value = false;
  fault.value = noLoss.value = "";
}

/** Goes to a row. @param {number} to */
export function go(to) {
  if (clip.value === null || clip.value.frames === 0) return;
  noLoss.value = "";
  row.value = Math.min(clip.value.frames - 1, Math.max(0, Math.round(to)));
  void fetchShown();
}

/**
 * Fetches the wanted row, then another if that is wanted by now: a slow network shows fewer rows,
 * never older ones.
 */
async function fetchShown() {
  if (isFetching) return;
  isFetching = true;
  const { signal: own } = open_;
  while (clip.value !== null && shown.value?.row !== row.value) {
    const { picture, said } = await frame(clip.value.id, row.value, own);
    if (own.aborted) {
      picture?.close();
      break;
    }
    for (const paint of painters) paint(picture, said);
    picture?.close();
    shown.value = said;
  }
  isFetching = false;
  // Another recording was opened meanwhile.
  if (own.aborted && clip.value !== null) void fetchShown();
}

/**
 * @param {string} id
 * @param {number} number
 * @param {AbortSignal} own
 * @returns {Promise<{picture: ImageBitmap | null, said: Shown}>}
 */
async function frame(id, number, own) {
  try {
    const [answer, today] = await Promise.all([ask(`recordings/${id}/frame/${number}`, { signal: own }), recordToday(number, own)]);
    const record = /** @type {PoseRecord | null} */ (parsed(decodeURIComponent(answer.headers.get("X-Stagepose-Record") ?? "null")));
    const picture = await createImageBitmap(await answer.blob());
    fault.value = "";
    return { picture, said: { row: number, record, today, size: [picture.width, picture.height] } };
  } catch (why) {
    if (!own.aborted) fault.value = why instanceof DOMException ? "This row's picture cannot be read." : reason(why);
    return { picture: null, said: { row: number, record: null, today: null, size: null } };
  }
}

/** Milliseconds of a row since the first; undefined while that is not known. @param {number} of */
function stampOf(of) {
  const from = of - (of % STAMPS);
  if (!stamps.has(from)) void fetchStamps(from);
  return stamps.get(from)?.[of - from];
}

/** @param {number} from */
async function fetchStamps(from) {
  if (clip.value === null) return;
  const { signal: own } = open_;
  const { id, first_ns } = clip.value;
  stamps.set(from, null);
  try {
    const records = /** @type {PoseRecord[]} */ (await lines(`recordings/${id}/poses?from=${from}&count=${STAMPS}`, own));
    if (!own.aborted) stamps.set(from, records.map(({ timestamp_ns }) => (timestamp_ns - (first_ns ?? 0)) / 1e6));
  } catch (why) {
    if (own.aborted) return;
    playing.value = false;
    stamps.delete(from);
    fault.value = reason(why);
  }
}

/** Begins to play, or stops; at the end it begins anew. */
export function togglePlaying() {
  if (clip.value === null || clip.value.frames === 0) return;
  playing.value = !playing.value;
  if (!playing.value) return;
  if (row.value === clip.value.frames - 1) go(0);
  const { signal: own } = open_;
  /** @type {number | undefined} */
  let at;
  /** @type {number | undefined} */
  let last;
  let reached = row.value;
  const tick = (/** @type {number} */ now) => {
    if (!playing.value || own.aborted || clip.value === null) return;
    // Somebody has gone elsewhere meanwhile.
    if (row.value !== reached) at = undefined;
    at ??= stampOf(row.value);
    if (at !== undefined) at += speed.value * (now - (last ?? now));
    last = now;
    reached = at === undefined ? row.value : advanced(row.value, at, (stamp) => (at = stamp));
    if (reached !== row.value) go(reached);
    if (reached === clip.value.frames - 1) playing.value = false;
    else ticking = requestAnimationFrame(tick);
  };
  // One of before may still be on its way.
  cancelAnimationFrame(ticking);
  ticking = requestAnimationFrame(tick);
}

/**
 * The last row whose time has come, played `from`.
 * @param {number} from
 * @param {number} at
 * @param {(stamp: number) => void} set receives the time if it is not `at`
 */
function advanced(from, at, set) {
  const { frames } = /** @type {Clip} */ (clip.value);
  let now = from;
  while (now + 1 < frames) {
    const next = stampOf(now + 1);
    // Stamps that are on their way stop the time.
    if (next === undefined) {
      set(Math.min(at, stampOf(now) ?? at));
      break;
    }
    if (next > at) {
      if (next - at > LONGEST_GAP * speed.value) set(next - LONGEST_GAP * speed.value);
      break;
    }
    now += 1;
  }
  // Those that come soon.
  stampOf(Math.min(frames - 1, now + STAMPS / 2));
  return now;
}

/** Whether the stage was not known in some row of a column. @param {Column} column */
export function isLost({ states }) {
  return Object.keys(states).some((state) => state !== "tracking" && state !== "coasting");
}

/**
 * The first column of the next or the previous loss.
 * @param {Column[]} columns
 * @param {number} from a row
 * @param {1 | -1} way
 */
export function loss(columns, from, way) {
  const begins = columns.filter((column, k) => isLost(column) && (k === 0 || !isLost(columns[k - 1])));
  return way === 1 ? begins.find((column) => column.row > from) : begins.filter((column) => column.row + column.rows - 1 < from).at(-1);
}

/**
 * Goes to the first row of the next or the previous loss; returns whether there is one.
 * @param {1 | -1} way
 */
export async function goToLoss(way) {
  if (clip.value === null) return;
  const { id, columns } = clip.value;
  const column = loss(columns, row.value, way);
  if (column === undefined) {
    noLoss.value = way === 1 ? "There is no loss after this row." : "There is no loss before this row.";
    return;
  }
  playing.value = false;
  fault.value = "";
  go(column.row);
  if (column.rows === 1) return;
  const { signal: own } = open_;
  const records = /** @type {PoseRecord[]} */ (await lines(`recordings/${id}/poses?from=${column.row}&count=${column.rows}`, own).catch(() => []));
  const first = records.findIndex(({ state }) => state !== "tracking" && state !== "coasting");
  if (!own.aborted && first > 0) go(column.row + first);
}
