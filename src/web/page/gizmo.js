// Handles that move, rotate and size the chosen thing in the picture. The pointer's place is
// undistorted to where the set is drawn.
import { effect, signal } from "./vendor/signals.js";
import { Raycaster, TransformControls, Vector2 } from "./vendor/three.js";
import { again, compositor, learn } from "./composite.js";
import { undistorted } from "./gl/lens.js";
import { thingOf } from "./gl/set.js";
import { alter, chosen, set } from "./things.js";

/** What the handles do. */
export const ACTIONS = /** @type {const} */ ([
  { action: "translate", name: "Move" },
  { action: "rotate", name: "Turn" },
  { action: "scale", name: "Size" },
]);
/** What they do now. */
export const action = signal(/** @type {"translate" | "rotate" | "scale"} */ ("translate"));

/** @import { Object3D } from "./vendor/three.js"
 * @typedef {Pick<PointerEvent, "x" | "y" | "button">} Pointer */

/**
 * The handles read only these fields of an event, whatever their declarations say.
 * @param {Pointer} pointer
 */
const asEvent = (pointer) => /** @type {PointerEvent} */ (pointer);

/**
 * Lets the pointer choose and move things; returns what ends it.
 * @param {HTMLCanvasElement} canvas
 */
export function handlesOn(canvas) {
  const over = compositor;
  if (over === null) return () => {};
  const controls = new TransformControls(over.set.camera);
  controls.setSpace("local");
  const helper = controls.getHelper();
  over.set.scene.add(helper);
  over.handles.push({ root: helper, isHeld: () => controls.object !== undefined });
  const rays = new Raycaster();
  /**
   * The pointer's place in the pinhole's picture, -1 to 1, as the handles get it.
   * @param {PointerEvent} event
   * @returns {Pointer | null}
   */
  const at = (event) => {
    const { camera } = over.known ?? {};
    if (!camera || !over.pinhole) return null;
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const raw = [((event.clientX - left) / width) * camera.width - 0.5, ((event.clientY - top) / height) * camera.height - 0.5];
    const towards = undistorted(camera, raw);
    if (towards === null) return null;
    const { fx, fy, cx, cy, width: w, height: h } = over.pinhole;
    return { x: (2 * (fx * towards[0] + cx + 0.5)) / w - 1, y: 1 - (2 * (fy * towards[1] + cy + 0.5)) / h, button: event.button };
  };
  const down = (/** @type {PointerEvent} */ event) => {
    const pointer = at(event);
    if (pointer === null || event.button !== 0) return;
    over.set.scene.updateMatrixWorld();
    controls.pointerHover(asEvent(pointer));
    controls.pointerDown(asEvent(pointer));
    canvas.setPointerCapture(event.pointerId);
    if (!controls.dragging) choose(pointer);
  };
  const move = (/** @type {PointerEvent} */ event) => {
    const pointer = at(event);
    if (pointer === null) return;
    if (controls.dragging) controls.pointerMove(asEvent({ ...pointer, button: -1 }));
    else controls.pointerHover(asEvent(pointer));
    again();
  };
  const up = (/** @type {PointerEvent} */ event) => {
    const pointer = at(event);
    if (controls.dragging && controls.object) kept(controls.object);
    if (pointer !== null) controls.pointerUp(asEvent(pointer));
    again();
  };
  /** @param {Pointer} pointer */
  const choose = ({ x, y }) => {
    rays.setFromCamera(new Vector2(x, y), over.set.camera);
    const [hit] = rays.intersectObjects(over.set.things.children, true);
    /** @type {Object3D | null} */
    let found = hit?.object ?? null;
    while (found && thingOf(found) === null) found = found.parent;
    chosen.value = found && thingOf(found);
  };
  controls.addEventListener("objectChange", () => controls.object && kept(controls.object));
  const stop = effect(() => {
    controls.setMode(action.value);
    const held = chosen.value !== null && set.value ? over.set.held.get(chosen.value) : undefined;
    if (held) controls.attach(held.holder.children[0]);
    else controls.detach();
    // Handles appear with the next picture, or now where it stands still.
    learn();
  });
  canvas.addEventListener("pointerdown", down);
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("pointerup", up);
  return () => {
    stop();
    canvas.removeEventListener("pointerdown", down);
    canvas.removeEventListener("pointermove", move);
    canvas.removeEventListener("pointerup", up);
    controls.detach();
    over.set.scene.remove(helper);
    over.handles.length = 0;
  };
}

/** Takes over where the handles have put a thing. @param {Object3D} body */
function kept(body) {
  const thing = thingOf(body);
  if (thing === null) return;
  const round = (/** @type {number} */ value) => Math.round(value * 1e4) / 1e4;
  const { position, rotation, scale } = body;
  alter(thing, {
    position_m: [position.x, position.y, position.z].map(round),
    rotation_deg: [rotation.x, rotation.y, rotation.z].map((radians) => round((radians * 180) / Math.PI)),
    size_m: [scale.x, scale.y, scale.z].map((value) => Math.max(0.001, round(Math.abs(value)))),
  });
}
