// The camera's picture in the set-up; once the stage is tracked, with its outlines. While the origin
// is set it has a cube there, and takes clicks.
import { computed } from "../vendor/signals.js";
import { useEffect, useRef } from "../vendor/hooks.js";
import { contact, head, painters, standing } from "../daemon.js";
import { trouble } from "../events.js";
import { drawMarks, drawPicture } from "../picture.js";
import { html } from "../ui.js";
import { draft } from "./draft.js";
import { drawCube, moveThere } from "./ghost.js";
import { drawBoard } from "./boardmarks.js";

/** @import { Head } from "../types.js" */

/** Width over height of the pictures; that of a wide picture before the first. */
const aspect = computed(() => (head.value === null ? 16 / 9 : head.value.size[0] / head.value.size[1]));
/** Whether pictures come. */
const isLive = computed(() => contact.value !== false && head.value !== null && standing.value === null);

export function Look() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const marks = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const more = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const paint = (/** @type {ImageBitmap} */ picture, /** @type {Head} */ said) => {
      if (canvas.current) drawPicture(canvas.current, picture);
      if (marks.current) drawMarks(marks.current, said);
      const { step, lens } = draft.peek();
      if (more.current && step === "origin") drawCube(more.current, said);
      else if (more.current && step === "lens" && lens === "board") drawBoard(more.current, said);
      else if (more.current && more.current.width > 0) more.current.width = 0;
    };
    painters.add(paint);
    return () => void painters.delete(paint);
  }, []);
  const takesClicks = draft.value.step === "origin";
  return html`<figure class="picture ${takesClicks ? "clicked" : ""}" style=${{ aspectRatio: aspect.value, maxWidth: `calc((100vh - 12rem) * ${aspect.value})` }} onClick=${takesClicks ? moveThere : null}>
    <canvas ref=${canvas} role="img" aria-label="What the camera sees" />
    <canvas ref=${marks} class="marks" aria-hidden="true" />
    <canvas ref=${more} class="marks" aria-hidden="true" />
    ${isLive.value ? null : html`<figcaption>${trouble.value ?? "No picture comes."}</figcaption>`}
  </figure>`;
}
