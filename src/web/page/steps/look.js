// The camera's picture in the set-up; once the stage is tracked, with its outlines.
import { computed } from "../vendor/signals.js";
import { useEffect, useRef } from "../vendor/hooks.js";
import { contact, head, painters, standing } from "../daemon.js";
import { trouble } from "../events.js";
import { drawMarks, drawPicture } from "../picture.js";
import { html } from "../ui.js";

/** @import { Head } from "../types.js" */

/** Width over height of the pictures; that of a wide picture before the first. */
const aspect = computed(() => (head.value === null ? 16 / 9 : head.value.size[0] / head.value.size[1]));
/** Whether pictures come. */
const isLive = computed(() => contact.value !== false && head.value !== null && standing.value === null);

export function Look() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const marks = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const paint = (/** @type {ImageBitmap} */ picture, /** @type {Head} */ said) => {
      if (canvas.current) drawPicture(canvas.current, picture);
      if (marks.current) drawMarks(marks.current, said);
    };
    painters.add(paint);
    return () => void painters.delete(paint);
  }, []);
  return html`<figure class="picture" style=${{ aspectRatio: aspect.value, maxWidth: `calc((100vh - 12rem) * ${aspect.value})` }}>
    <canvas ref=${canvas} role="img" aria-label="What the camera sees" />
    <canvas ref=${marks} class="marks" aria-hidden="true" />
    ${isLive.value ? null : html`<figcaption>${trouble.value ?? "No picture comes."}</figcaption>`}
  </figure>`;
}
