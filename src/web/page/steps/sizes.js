// Step 4: width and height of what the picture shows.
import { html, typed } from "../ui.js";
import { nameOf, picture } from "./config.js";
import { change, changeSurface, draft, shown } from "./draft.js";
import { EXAMPLES, UNITS } from "./lengths.js";
import { isSide, size } from "./sides.js";

/** @import { Unit } from "./lengths.js" */

/**
 * The share by which the tape may differ from the artwork. Beyond it one of them is wrong, or the
 * print was stretched.
 */
const ALIKE = 0.01;

/** What the artwork says of the sizes; empty if they agree, or without artwork. */
function doubt() {
  const seen = picture(shown.value);
  const [width, height] = size(draft.value);
  if (shown.value.door === "freeze" || seen === null || seen.height === 0 || width === null || height === null || !isSide(width) || !isSide(height)) return "";
  const [drawn, taped] = [seen.width / seen.height, width / height];
  if (Math.abs(Math.log(drawn / taped)) < ALIKE) return "";
  if (Math.abs(Math.log(drawn * taped)) < ALIKE) return "The artwork is as wide as you say that it is high. Exchange width and height.";
  return `The artwork is ${drawn.toFixed(3)} times as wide as high, the tape says ${taped.toFixed(3)}. Measure again, edge to edge of what the artwork shows: with this width the height would be ${(width / drawn).toFixed(3)} m. If the print was stretched, both may be right.`;
}

/** @param {{name: "width" | "height", label: string, isFirst?: boolean}} props */
function Length({ name, label, isFirst = false }) {
  const { unit } = draft.value;
  const metres = size(draft.value)[name === "width" ? 0 : 1];
  return html`<label class="field wide">
    <span>${label}</span>
    <input data-first=${isFirst ? "" : null} inputmode=${unit === "ft" ? "text" : "decimal"} placeholder=${EXAMPLES[unit]} value=${shown.value[name]} aria-invalid=${shown.value[name] !== "" && !isSide(metres) ? "true" : "false"} onInput=${(/** @type {Event} */ event) => changeSurface({ [name]: typed(event) })} />
    <span class="unit">${unit === "ft" ? (metres === null ? "ft in" : `${metres.toFixed(3)} m`) : unit}</span>
  </label>`;
}

export function Sizes() {
  const said = doubt();
  const { surfaces, surface } = draft.value;
  return html`${surfaces.length === 1 ? null : html`<div class="row">${surfaces.map((_, k) => html`<button key=${k} type="button" class="tab" aria-pressed=${k === surface ? "true" : "false"} onClick=${() => change({ surface: k })}>${nameOf(k)}</button>`)}</div>`}
    <${Length} name="width" label="Width" isFirst />
    <${Length} name="height" label="Height" />
    <label class="field wide">
      <span>Measured in</span>
      <select value=${draft.value.unit} onChange=${(/** @type {Event} */ event) => change({ unit: /** @type {Unit} */ (typed(event)) })}>
        ${UNITS.map(({ unit, title }) => html`<option key=${unit} value=${unit}>${title}</option>`)}
      </select>
    </label>
    ${said === "" ? null : html`<p class="warned" role="status">${said}</p>`}
    <p class="note">All distances of the pose are in this measure: an error of 1 % here is 1 % there.</p>`;
}
