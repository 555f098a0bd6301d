// Which parts of the stage the tracker sees and which are hidden, tile by tile. Once a second the
// page requests the pixels of one frame: `used`, which its poses rest on, and `hidden`, where the
// picture shows something else. The tracker does not look at plain parts, so nothing is marked
// there.
import { computed, effect, signal } from "./vendor/signals.js";
import { head, painters, pixelsWanted } from "./daemon.js";
import { drawAgain, extraMarks, hidden, parted } from "./picture.js";

/** @import { Head } from "./types.js" */
/** @typedef {{across: number, down: number, tiles: Int8Array}} Tiles UNKNOWN, SEEN or HIDDEN, row
 *   by row */

/** Tiles across the picture. Raised, each has fewer of the pixels that the daemon sends. */
const ACROSS = 16;
/** Milliseconds between two looks. Raised, marks are older; lowered, the tracker records more. */
const LOOKS_EVERY = 1000;
/** Pixels below which a tile is unknown. */
const MIN_PIXELS = 2;
/** A third of the picture is hidden if this share of its known tiles is, of at least this many. */
const MOSTLY = 0.7;
const MIN_TILES = 4;

export const [UNKNOWN, SEEN, HIDDEN] = [0, 1, 2];

/** The last look; null while the stage is not measured. */
export const tiles = signal(/** @type {Tiles | null} */ (null));

let lookedAt = 0;
const isDue = () => performance.now() - lookedAt >= LOOKS_EVERY;
const isTracked = (/** @type {Head | null} */ of) => of?.record.state === "tracking" && of.record.pose !== null;
/** Whether the next frame is to come with its pixels: without a measured pose there are none. */
const wantsPixels = () => isDue() && isTracked(head.peek());

/**
 * The majority of the pixels in each tile.
 * @param {number[]} used columns and rows, alternating
 * @param {number[]} covered likewise
 * @param {number[]} size of the picture
 * @returns {Tiles}
 */
export function tilesOf(used, covered, [width, height]) {
  const side = width / ACROSS;
  const down = Math.ceil(height / side);
  const count = (/** @type {number[]} */ places) => {
    const counts = new Uint16Array(ACROSS * down);
    for (let k = 0; k + 1 < places.length; k += 2) {
      const [column, row] = [places[k], places[k + 1]].map((px) => Math.floor((px + 0.5) / side));
      // A pixel beyond the picture's edge belongs to no tile.
      if (column < ACROSS && row < down) counts[row * ACROSS + column] += 1;
    }
    return counts;
  };
  const [seen, hides] = [count(used), count(covered)];
  const judged = Int8Array.from(seen, (own, k) => (own + hides[k] < MIN_PIXELS ? UNKNOWN : own >= hides[k] ? SEEN : HIDDEN));
  return { across: ACROSS, down, tiles: judged };
}

/**
 * The parts of the picture that are mostly hidden, as a sentence; empty if none is.
 * @param {Tiles | null} of
 */
export function hiddenParts(of) {
  if (of === null) return "";
  const parts = ["left", "middle", "right"].map((name, third) => {
    const own = [...of.tiles].filter((tile, k) => Math.floor((3 * (k % of.across)) / of.across) === third && tile !== UNKNOWN);
    return { name, isKnown: own.length >= MIN_TILES, isHidden: own.filter((tile) => tile === HIDDEN).length >= MOSTLY * own.length };
  });
  const known = parts.filter(({ isKnown }) => isKnown);
  const names = known.filter(({ isHidden }) => isHidden).map(({ name }) => name);
  if (names.length === 0) return "";
  if (names.length === known.length && known.length > 1) return "Most of the stage is hidden.";
  return names.length === 1 ? `The ${names[0]} third is hidden.` : `The ${names[0]} and the ${names[1]} third are hidden.`;
}

const now = computed(() => hiddenParts(tiles.value));
/** The sentence of the last look. It is shown if two looks agree: not for someone who walks by. */
let before = "";

/** @param {ImageBitmap} _picture @param {Head} of */
function paint(_picture, of) {
  if (!isTracked(of)) {
    tiles.value = null;
    hidden.value = before = "";
    return;
  }
  // The tracker had begun this frame when the pixels were requested: the next one has them.
  if (!isDue() || !of.used) return;
  lookedAt = performance.now();
  // A daemon that does not report hidden pixels still reports where it sees the stage.
  tiles.value = tilesOf(of.used, of.hidden ?? [], of.size);
  if (now.value === before) hidden.value = before;
  before = now.value;
}

/**
 * Draws a dot on each tile that is seen, a cross on each that is hidden.
 * @param {CanvasRenderingContext2D} context
 * @param {number} width
 * @param {(name: string) => string} colour
 */
function mark(context, width, colour) {
  const found = tiles.value;
  if (!parted.value || found === null) return;
  const side = width / found.across;
  const size = 0.12 * side;
  context.lineWidth = 2 * devicePixelRatio;
  found.tiles.forEach((tile, k) => {
    if (tile === UNKNOWN) return;
    const [x, y] = [((k % found.across) + 0.5) * side, (Math.floor(k / found.across) + 0.5) * side];
    context.strokeStyle = context.fillStyle = colour(tile === SEEN ? "tracking" : "lost");
    const shape = new Path2D();
    if (tile === SEEN) {
      shape.arc(x, y, size / 2, 0, 2 * Math.PI);
      context.fill(shape);
    } else {
      for (const way of [-1, 1]) {
        shape.moveTo(x - size, y - way * size);
        shape.lineTo(x + size, y + way * size);
      }
      context.stroke(shape);
    }
  });
}

/** Looks from now on; returns what ends it. */
export function watchSeen() {
  painters.add(paint);
  pixelsWanted.add(wantsPixels);
  extraMarks.add(mark);
  const stop = effect(() => {
    void [parted.value, tiles.value];
    drawAgain();
  });
  return () => {
    stop();
    painters.delete(paint);
    pixelsWanted.delete(wantsPixels);
    extraMarks.delete(mark);
    tiles.value = null;
    hidden.value = "";
  };
}
