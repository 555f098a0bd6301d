// Step 5: which point of the surface lies where in the stage.
import { html, typed } from "../ui.js";
import { change, draft } from "./draft.js";
import { number } from "./lengths.js";

/** Points of the surface, by their names in the config. */
const POINTS = [
  { name: "bottom", title: "Centre of its bottom edge" },
  { name: "bottom left", title: "Bottom left corner" },
  { name: "bottom right", title: "Bottom right corner" },
  { name: "centre", title: "Its centre" },
  { name: "top left", title: "Top left corner" },
  { name: "top right", title: "Top right corner" },
  { name: "top", title: "Centre of its top edge" },
];
const AXES = ["to the right", "upstage", "up"];

/** @param {number} axis */
const typedAt = (axis) => (/** @type {Event} */ event) => change({ at: draft.peek().at.map((text, k) => (k === axis ? typed(event) : text)) });

export function Origin() {
  const { point, at } = draft.value;
  return html`<label class="field wide">
      <span>Point of the surface, as its audience sees it</span>
      <select data-first value=${point} onChange=${(/** @type {Event} */ event) => change({ point: typed(event) })}>
        ${POINTS.map(({ name, title }) => html`<option key=${name} value=${name}>${title}</option>`)}
      </select>
    </label>
    <p class="note">lies at these metres from the stage's origin. With 0, 0, 0 it is the origin.</p>
    <div class="fields">
      ${AXES.map(
        (name, axis) => html`<label key=${name} class="field">
          <span>${name}</span>
          <input inputmode="decimal" value=${at[axis]} aria-invalid=${number(at[axis]) === null ? "true" : "false"} onInput=${typedAt(axis)} />
          <span class="unit">m</span>
        </label>`,
      )}
    </div>`;
}
