// Which parts of the stage's artwork the picture shows, tile by tile: once a second the artwork is looked up where the pose and the lens put it, and compared with
// the camera's picture by correlation, which light and contrast do not change. It says what hides the stage.
// The tracker decides the same for itself, tile by tile, but the daemon tells only the pixels that
// count (used.js). Those that were asked, and left out because something else is seen there, it does
// not tell; without them a hidden part of the stage and a plain one are alike.
import { computed, effect, signal } from "./vendor/signals.js";
import { painters, scene } from "./daemon.js";
import { direction, turn, within } from "./lens.js";
import { drawAgain, extraMarks, hidden, parted } from "./picture.js";

/** @import { Camera, Head, Pose, Scene, Surface } from "./types.js" */
/** @typedef {{width: number, height: number, grey: Uint8ClampedArray}} Grey
 * @typedef {{levels: Grey[], surface: Surface}} Artwork the picture on a flat surface, each level half as large as the one before
 * @typedef {{across: number, down: number, tiles: Int8Array}} Tiles UNKNOWN, SEEN or HIDDEN, row by row */

/** Tiles across the picture, and samples along a side of one: details of 1/160 of a picture are compared. Raised, slower, and a small error of the pose counts. */
const ACROSS = 16;
const SIDE = 10;
/** Pixels along the largest artwork that is kept, and how often it is halved: to compare like with like from near and far. */
const LARGEST = 1024;
const LEVELS = 5;
/** Milliseconds between two looks. */
const LOOKS_EVERY = 1000;
/** Correlation from which on a tile is the artwork's: pictures of the fixture and of rendered stages have 0.8 and more, other things half of this and less. */
const ALIKE = 0.5;
/** Standard deviation in grey levels, of the artwork, below which a tile is too plain to tell. */
const PLAIN = 8;
/** The share of a tile's samples that must lie on one surface. */
const COVERED = 0.7;
/** A third of the picture is hidden where this share of its tiles is, of at least so many. */
const MOSTLY = 0.7;
const LEAST_TILES = 4;

export const [UNKNOWN, SEEN, HIDDEN] = [0, 1, 2];

/** The last look; null where there is none. */
export const tiles = signal(/** @type {Tiles | null} */ (null));

/** @type {Artwork[] | null} */
let artworks = null;
/** Directions of the samples, x and y at z = 1, row by row. @type {Float32Array | null} */
let rays = null;
/** The session that they are of. @type {Scene | null} */
let learnt = null;
let lookedAt = 0;
/** @type {OffscreenCanvas | null} */
let small = null;

/** A picture in grey, this wide. @param {ImageBitmap} picture @param {number} width @param {number} height @returns {Grey} */
function greyOf(picture, width, height) {
  if (small === null || small.width !== width || small.height !== height) small = new OffscreenCanvas(width, height);
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (small.getContext("2d", { willReadFrequently: true }));
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height);
  const grey = new Uint8ClampedArray(width * height);
  for (let k = 0; k < grey.length; k += 1) grey[k] = 0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2];
  return { width, height, grey };
}

/** What hangs on the flat surfaces. @param {Scene} of */
async function fetchArtworks({ stage }) {
  const flat = stage.surfaces.map((surface, k) => ({ surface, k })).filter(({ surface }) => !surface.mesh_m);
  return Promise.all(
    flat.map(async ({ surface, k }) => {
      const answer = await fetch(`./api/v1/surfaces/${k}/picture`, { cache: "no-store" });
      if (!answer.ok) throw new Error(`${answer.status}`);
      const picture = await createImageBitmap(await answer.blob());
      const scale = Math.min(1, LARGEST / Math.max(picture.width, picture.height));
      const levels = Array.from({ length: LEVELS }, (_, level) => {
        return greyOf(picture, ...(/** @type {[number, number]} */ ([picture.width, picture.height].map((side) => Math.max(1, Math.round((side * scale) / 2 ** level))))));
      });
      picture.close();
      return { surface, levels };
    }),
  );
}

/** Learns a session's stage. @param {Scene | null} known */
async function learn(known) {
  learnt = known;
  artworks = rays = tiles.value = null;
  if (known === null) return;
  try {
    const found = await fetchArtworks(known);
    if (learnt === known) artworks = found;
  } catch {
    // The daemon may still be reading them: the next look asks again.
    if (learnt === known) learnt = null;
  }
}

/** @param {Camera} camera */
function raysOf(camera) {
  const [columns, rows] = [ACROSS * SIDE, Math.round((ACROSS * SIDE * camera.height) / camera.width)];
  const all = new Float32Array(2 * columns * rows);
  for (let j = 0; j < rows; j += 1) {
    for (let i = 0; i < columns; i += 1) {
      const [x, y] = direction(camera, [((i + 0.5) / columns) * camera.width - 0.5, ((j + 0.5) / rows) * camera.height - 0.5]);
      all.set([x, y], 2 * (j * columns + i));
    }
  }
  return all;
}

/** How a camera sees a surface: where it stands in the surface's frame, and its axes there. @param {Pose} pose @param {Surface} surface */
function seenFrom(pose, surface) {
  const place = within(surface.pose, pose.position_m);
  const [x, y, z, w] = surface.pose.orientation_xyzw;
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => turn([-x, -y, -z, w], turn(pose.orientation_xyzw, axis)));
  return { place, axes };
}

/** Where on which artwork each sample is: its number (-1 for none), and its place across and down, 0 to 1. @param {Pose} pose */
function lookUp(pose) {
  const views = /** @type {Artwork[]} */ (artworks).map(({ surface }) => ({ ...seenFrom(pose, surface), size: surface.size_m }));
  const directions = /** @type {Float32Array} */ (rays);
  const count = directions.length / 2;
  const [which, u, v] = [new Int8Array(count).fill(-1), new Float32Array(count), new Float32Array(count)];
  for (let k = 0; k < count; k += 1) {
    const [x, y] = [directions[2 * k], directions[2 * k + 1]];
    let nearest = Infinity;
    views.forEach(({ place: [px, py, pz], axes: [a, b, c], size: [w, h] }, number) => {
      const far = -pz / (x * a[2] + y * b[2] + c[2]);
      // Before the camera, and from the front.
      if (!(far > 0 && far < nearest && pz > 0)) return;
      const [s, t] = [(px + far * (x * a[0] + y * b[0] + c[0])) / w + 0.5, 0.5 - (py + far * (x * a[1] + y * b[1] + c[1])) / h];
      if (s < 0 || s > 1 || t < 0 || t > 1) return;
      nearest = far;
      which[k] = number;
      u[k] = s;
      v[k] = t;
    });
  }
  return { which, u, v };
}

/** Grey at a place, between pixels. @param {Grey} of @param {number} u @param {number} v */
function at({ width, height, grey }, u, v) {
  const [x, y] = [Math.min(width - 1.001, Math.max(0, u * width - 0.5)), Math.min(height - 1.001, Math.max(0, v * height - 0.5))];
  const [i, j] = [Math.floor(x), Math.floor(y)];
  const [a, b, k, down] = [x - i, y - j, j * width + i, height > 1 ? width : 0];
  return (1 - b) * ((1 - a) * grey[k] + a * grey[k + 1]) + b * ((1 - a) * grey[k + down] + a * grey[k + down + 1]);
}

/** Looks at a picture. @param {ImageBitmap} picture @param {Camera} by its lens @param {Pose} pose @returns {Tiles} */
function look(picture, by, pose) {
  const columns = ACROSS * SIDE;
  rays ??= raysOf(by);
  const rows = rays.length / 2 / columns;
  const camera = greyOf(picture, columns, rows);
  const { which, u, v } = lookUp(pose);
  const down = Math.floor(rows / SIDE);
  const found = new Int8Array(ACROSS * down);
  for (let tile = 0; tile < found.length; tile += 1) {
    const first = Math.floor(tile / ACROSS) * SIDE * columns + (tile % ACROSS) * SIDE;
    const samples = Array.from({ length: SIDE * SIDE }, (_, k) => first + Math.floor(k / SIDE) * columns + (k % SIDE));
    found[tile] = judged(samples, camera, which, u, v);
  }
  return { across: ACROSS, down, tiles: found };
}

/** @param {number[]} samples @param {Grey} camera @param {Int8Array} which @param {Float32Array} u @param {Float32Array} v */
function judged(samples, camera, which, u, v) {
  const number = which[samples[samples.length / 2 + SIDE / 2]];
  const own = samples.filter((k) => which[k] === number);
  if (number < 0 || own.length < COVERED * samples.length) return UNKNOWN;
  const { levels } = /** @type {Artwork[]} */ (artworks)[number];
  // The level of which a pixel is as large as a sample.
  const [from, to] = [own[0], own[own.length - 1]];
  const step = Math.hypot((u[to] - u[from]) * levels[0].width, (v[to] - v[from]) * levels[0].height) / (SIDE * Math.SQRT2);
  const level = levels[Math.min(LEVELS - 1, Math.max(0, Math.round(Math.log2(Math.max(step, 1e-6)))))];
  let [n, a, b, aa, bb, ab] = [own.length, 0, 0, 0, 0, 0];
  for (const k of own) {
    const [x, y] = [camera.grey[k], at(level, u[k], v[k])];
    a += x;
    b += y;
    aa += x * x;
    bb += y * y;
    ab += x * y;
  }
  const [va, vb] = [aa / n - (a / n) ** 2, bb / n - (b / n) ** 2];
  if (vb < PLAIN * PLAIN) return UNKNOWN;
  return (ab / n - (a / n) * (b / n)) / Math.sqrt(Math.max(va, 1) * vb) >= ALIKE ? SEEN : HIDDEN;
}

/** The parts of the picture that are mostly hidden, as a sentence; empty where none is. @param {Tiles | null} of */
export function hiddenParts(of) {
  if (of === null) return "";
  const parts = ["left", "middle", "right"].map((name, third) => {
    const own = [...of.tiles].filter((_, k) => Math.floor((3 * (k % of.across)) / of.across) === third && of.tiles[k] !== UNKNOWN);
    return { name, isTold: own.length >= LEAST_TILES, isHidden: own.filter((tile) => tile === HIDDEN).length >= MOSTLY * own.length };
  });
  const told = parts.filter(({ isTold }) => isTold);
  const names = told.filter(({ isHidden }) => isHidden).map(({ name }) => name);
  if (names.length === 0) return "";
  if (names.length === told.length && told.length > 1) return "Most of the stage is hidden.";
  return names.length === 1 ? `The ${names[0]} third is hidden.` : `The ${names[0]} and the ${names[1]} third are hidden.`;
}

const now = computed(() => hiddenParts(tiles.value));
/** What the look before found: two must agree, for somebody who walks by is not worth a sentence. */
let before = "";

/** @param {ImageBitmap} picture @param {Head} said */
function paint(picture, said) {
  const { record } = said;
  if (record.state !== "tracking" || !record.pose) {
    tiles.value = null;
    hidden.value = before = "";
    return;
  }
  const time = performance.now();
  if (time - lookedAt < LOOKS_EVERY) return;
  lookedAt = time;
  if (learnt !== scene.value) void learn(scene.value);
  if (!artworks?.length || !scene.value) return;
  tiles.value = look(picture, scene.value.camera, record.pose);
  if (now.value === before) hidden.value = before;
  before = now.value;
}

/** A dot on each tile that shows the artwork, a cross on each that hides it. @param {CanvasRenderingContext2D} context @param {number} width
 * @param {(name: string) => string} colour */
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

/** Looks from now on; what it returns ends it. */
export function watchSeen() {
  painters.add(paint);
  extraMarks.add(mark);
  const stop = effect(() => {
    void [parted.value, tiles.value];
    drawAgain();
  });
  return () => {
    stop();
    painters.delete(paint);
    extraMarks.delete(mark);
    tiles.value = null;
    hidden.value = "";
  };
}
