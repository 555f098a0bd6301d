// The four corners of the surface in the frozen picture: dragged, or moved by keys, under a loupe.
import { computed, signal } from "../vendor/signals.js";
import { useEffect, useRef } from "../vendor/hooks.js";
import { theme } from "../theme.js";
import { emptied, html } from "../ui.js";
import { changeSurface, shown } from "./draft.js";
import { snapped } from "./edges.js";
import { pictureAt } from "./upload.js";

/** Their names, in the config's order. */
const NAMES = ["top left", "top right", "bottom right", "bottom left"];
/** Pixels that an arrow key moves a corner by, also with Shift and with Alt. */
const [STEP, LARGE, SMALL] = [1, 10, 0.1];
/** Screen pixels of a picture's pixel in the loupe. */
const ENLARGES = 8;
/** Earlier corners that are kept. */
const FORMER = 500;
/** Where corners begin, as shares of the picture. */
const BEGIN = [[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]];

/** The corner in the loupe. */
const chosen = signal(0);
/** The picture as the browser has it. */
const picture = signal(/** @type {HTMLImageElement | null} */ (null));
/** How well the corners lie on edges; empty before they were moved there. */
const snap = signal("");
/** Where each corner lies, percent of the picture; pixels' centres are half a pixel into them. */
const places = computed(() => {
  const { photo, corners } = shown.value;
  return photo === null ? [] : corners.map(([x, y]) => [(100 * (x + 0.5)) / photo.width, (100 * (y + 0.5)) / photo.height]);
});

/** Corners for a picture of this size. @param {number} width @param {number} height */
export const cornersFor = (width, height) => BEGIN.map(([x, y]) => [Math.round(x * width), Math.round(y * height)]);

/** @param {number[][]} corners */
function place(corners) {
  const { corners: before, former } = shown.peek();
  changeSurface({ corners, former: [...former, before].slice(-FORMER) });
  snap.value = "";
}

/** The picture's grey levels. @param {HTMLImageElement} of */
function grey(of) {
  const [width, height] = [of.naturalWidth, of.naturalHeight];
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  if (context === null) return null;
  context.drawImage(of, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  return { grey: Float32Array.from({ length: width * height }, (_, k) => 0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2]), width, height };
}

/** Moves the corners to where the edges near the sides meet. */
function snapAll() {
  const levels = picture.value === null ? null : grey(picture.value);
  if (levels === null) return;
  const found = snapped(levels, shown.peek().corners);
  const missed = NAMES.filter((_, k) => found[k] === null);
  if (missed.length < NAMES.length) place(shown.peek().corners.map((corner, k) => found[k]?.at.map((value) => Number(value.toFixed(2))) ?? corner));
  const sigma = Math.max(...found.map((one) => one?.sigma ?? 0));
  const stay = missed.length === 0 ? "" : ` No edges are seen at ${missed.join(", ")}: place by hand, within 8 px of the edge to snap.`;
  snap.value = missed.length === NAMES.length ? stay.trim() : `Snapped to the edges, ± ${sigma.toFixed(2)} px.${stay}`;
}

/** Goes back to the corners before the last change. */
function undo() {
  const { former } = shown.peek();
  const before = former.at(-1);
  if (before) changeSurface({ corners: before, former: former.slice(0, -1) });
  snap.value = "";
}

/**
 * Moves a corner, within the picture.
 * @param {number[][]} corners
 * @param {number} k
 * @param {number} dx
 * @param {number} dy
 */
function moved(corners, k, dx, dy) {
  const { width, height } = shown.peek().photo ?? { width: 1, height: 1 };
  const within = (/** @type {number} */ value, /** @type {number} */ length) => Number(Math.min(Math.max(value, -0.5), length - 0.5).toFixed(2));
  return corners.map(([x, y], at) => (at === k ? [within(x + dx, width), within(y + dy, height)] : [x, y]));
}

/** @param {KeyboardEvent} event @param {number} k */
function byKey(event, k) {
  if ((event.ctrlKey || event.metaKey) && event.key === "z") {
    event.preventDefault();
    return undo();
  }
  if (event.key === "s" && !event.ctrlKey && !event.metaKey) return snapAll();
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (way === undefined) return;
  event.preventDefault();
  const by = event.shiftKey ? LARGE : event.altKey ? SMALL : STEP;
  place(moved(shown.peek().corners, k, by * way[0], by * way[1]));
}

/** @param {{k: number}} props */
function Handle({ k }) {
  // A drag moves the corner by as much, wherever the finger took hold: it does not hide the corner.
  const from = useRef(/** @type {{x: number, y: number, corners: number[][]} | null} */ (null));
  const down = (/** @type {PointerEvent} */ event) => {
    const { currentTarget, clientX: x, clientY: y, pointerId } = event;
    /** @type {HTMLElement} */ (currentTarget).setPointerCapture(pointerId);
    from.current = { x, y, corners: shown.peek().corners };
    place(shown.peek().corners);
  };
  const move = (/** @type {PointerEvent} */ { currentTarget, clientX, clientY }) => {
    const parent = /** @type {HTMLElement} */ (currentTarget).parentElement;
    if (from.current === null || parent === null) return;
    const scale = (shown.peek().photo?.width ?? 1) / parent.clientWidth;
    changeSurface({ corners: moved(from.current.corners, k, (clientX - from.current.x) * scale, (clientY - from.current.y) * scale) });
  };
  const [x, y] = places.value[k] ?? [0, 0];
  const at = (shown.value.corners[k] ?? []).map((value) => value.toFixed(1)).join(", ");
  return html`<button
    type="button"
    class="handle"
    data-first=${k === 0 ? "" : null}
    aria-label=${`Corner ${k + 1}, ${NAMES[k]}, at ${at}`}
    style=${{ left: `${x}%`, top: `${y}%` }}
    onFocus=${() => (chosen.value = k)}
    onKeyDown=${(/** @type {KeyboardEvent} */ event) => byKey(event, k)}
    onPointerDown=${down}
    onPointerMove=${move}
    onPointerUp=${() => (from.current = null)}
    onPointerCancel=${() => (from.current = null)}
  />`;
}

/** Draws the sides, with a dark border to show on any ground. @param {HTMLCanvasElement} on */
function drawOutline(on) {
  const drawn = emptied(on);
  if (!drawn) return;
  const { context, width, height, colour } = drawn;
  const line = new Path2D();
  for (const [x, y] of places.value) line.lineTo((x / 100) * width, (y / 100) * height);
  line.closePath();
  for (const [stroke, wide] of /** @type {const} */ ([["rgb(0 0 0 / 55%)", 4], [colour("accent"), 2]])) {
    context.strokeStyle = stroke;
    context.lineWidth = wide * devicePixelRatio;
    context.stroke(line);
  }
}

/** Draws what is around the chosen corner, enlarged. @param {HTMLCanvasElement} on */
function drawLoupe(on) {
  const drawn = emptied(on);
  const corner = shown.value.corners[chosen.value];
  if (!drawn || corner === undefined || picture.value === null) return;
  const { context, width, height, colour } = drawn;
  const [scale, x, y] = [ENLARGES * devicePixelRatio, corner[0] + 0.5, corner[1] + 0.5];
  context.imageSmoothingEnabled = false;
  context.drawImage(picture.value, width / 2 - x * scale, height / 2 - y * scale, picture.value.naturalWidth * scale, picture.value.naturalHeight * scale);
  context.strokeStyle = colour("accent");
  context.lineWidth = devicePixelRatio;
  context.beginPath();
  context.moveTo(width / 2, 0);
  context.lineTo(width / 2, height);
  context.moveTo(0, height / 2);
  context.lineTo(width, height / 2);
  context.stroke();
}

/** The frozen picture with the corners in it. */
export function Frozen() {
  const marks = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const { photo } = shown.value;
  useEffect(() => {
    const canvas = marks.current;
    if (canvas === null) return;
    const sized = new ResizeObserver(() => drawOutline(canvas));
    sized.observe(canvas);
    return () => sized.disconnect();
  }, [photo?.name]);
  useEffect(() => {
    if (marks.current) drawOutline(marks.current);
  }, [shown.value.corners, theme.value]);
  if (photo === null) return null;
  const aspect = photo.width / photo.height;
  return html`<figure class="picture corners" style=${{ aspectRatio: aspect, maxWidth: `calc((100vh - 12rem) * ${aspect})` }}>
    <img src=${pictureAt(photo)} alt="The frozen picture" onLoad=${(/** @type {Event} */ { target }) => (picture.value = /** @type {HTMLImageElement} */ (target))} draggable=${false} />
    <canvas ref=${marks} class="marks" aria-hidden="true" />
    ${NAMES.map((name, k) => html`<${Handle} key=${name} k=${k} />`)}
  </figure>`;
}

/** The loupe, and what the keys do. */
export function Loupe() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    if (canvas.current) drawLoupe(canvas.current);
  }, [shown.value.corners, chosen.value, picture.value, theme.value]);
  const corner = shown.value.corners[chosen.value] ?? [0, 0];
  return html`<div class="loupe">
    <canvas ref=${canvas} role="img" aria-label="The chosen corner, enlarged" />
    <div>
      <p>Corner ${chosen.value + 1}, ${NAMES[chosen.value]}: ${corner.map((value) => value.toFixed(1)).join(", ")} px</p>
      <p class="note">Drag a corner, or move it with the arrow keys: 1 px, with Shift 10, with Alt 0.1. Tab goes to the next one, S snaps to edges.</p>
      <div class="row"><button type="button" onClick=${snapAll}>Snap to edges</button><button type="button" disabled=${shown.value.former.length === 0} onClick=${undo}>Undo</button></div>
      <p role="status">${snap.value}</p>
    </div>
  </div>`;
}
