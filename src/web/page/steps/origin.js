// Step 5: where the stage's origin is: from one point of the first surface and a turn, from three
// measured points, or by a click on a picture. Everything moves together.
import { signal } from "../vendor/signals.js";
import { html, typed } from "../ui.js";
import { nameOf, picture } from "./config.js";
import { change, draft } from "./draft.js";
import { number } from "./lengths.js";
import { CLICKED, POINTS, contradiction, placed } from "./placing.js";
import { clicking } from "./ghost.js";
import { isSide, size } from "./sides.js";
import { pictureAt } from "./upload.js";

const AXES = ["to the right", "upstage", "up"];
/** The share by which three points may contradict the sizes before it is said. */
const ALIKE = 0.005;

/** Whether the picture of the surface is shown to click a point on it. */
const picks = signal(false);

/** @param {{texts: string[], act: (texts: string[]) => void, isFirst?: boolean}} props */
function Metres({ texts, act, isFirst = false }) {
  return html`<div class="fields">
    ${AXES.map(
      (name, axis) => html`<label key=${name} class="field">
        <span>${name}</span>
        <input data-first=${isFirst && axis === 0 ? "" : null} inputmode="decimal" value=${texts[axis]} aria-invalid=${texts[axis] !== "" && number(texts[axis]) === null ? "true" : "false"} onInput=${(/** @type {Event} */ event) => act(texts.map((text, k) => (k === axis ? typed(event) : text)))} />
        <span class="unit">m</span>
      </label>`,
    )}
  </div>`;
}

/** @param {{value: string, act: (name: string) => void, isFirst?: boolean, label: string}} props */
function Which({ value, act, isFirst = false, label }) {
  return html`<label class="field wide">
    <span>${label}</span>
    <select data-first=${isFirst ? "" : null} value=${value} onChange=${(/** @type {Event} */ event) => act(typed(event))}>
      ${POINTS.map(({ name, title }) => html`<option key=${name} value=${name} selected=${name === value}>${title}</option>`)}
      ${value === CLICKED ? html`<option value=${CLICKED} selected>The clicked point</option>` : null}
    </select>
  </label>`;
}

/** Takes the clicked point of the surface's picture. @param {MouseEvent} event */
function pick(event) {
  const box = /** @type {HTMLElement} */ (event.currentTarget).getBoundingClientRect();
  // By key the middle is taken.
  const isKey = event.detail === 0;
  const share = (/** @type {number} */ at, /** @type {number} */ from, /** @type {number} */ length) => Math.min(Math.max((at - from) / length, 0), 1);
  change({ point: CLICKED, clicked: isKey ? [0.5, 0.5] : [share(event.clientX, box.left, box.width), share(event.clientY, box.top, box.height)] });
}

/** The first surface's picture, to click a point on it. */
function Picture() {
  const [first] = draft.value.surfaces;
  const seen = picture(first);
  const at = seen === null || first.door === "freeze" ? null : pictureAt(seen);
  if (at === null) return null;
  const { point, clicked } = draft.value;
  return html`<details open=${picks.value} onToggle=${(/** @type {Event} */ { target }) => (picks.value = /** @type {HTMLDetailsElement} */ (target).open)}>
    <summary>Click a point on the picture</summary>
    <button type="button" class="pick" aria-label="The surface's picture: click the point" onClick=${pick}>
      <img src=${at} alt="" draggable=${false} />
      ${point === CLICKED && clicked !== null ? html`<span class="cross" style=${{ left: `${100 * clicked[0]}%`, top: `${100 * clicked[1]}%` }}></span>` : null}
    </button>
  </details>`;
}

function ByPoint() {
  const { point, at, turn } = draft.value;
  return html`<${Which} label="Point of the surface, as its audience sees it" value=${point} act=${(/** @type {string} */ name) => change({ point: name })} isFirst />
    <p class="note">lies at these metres from the stage's origin. With 0, 0, 0 it is the origin. If the floor is 0, “up” of a bottom point is its height above the floor.</p>
    <${Metres} texts=${at} act=${(/** @type {string[]} */ texts) => change({ at: texts })} />
    <div class="fields">
      <label class="field"><span>Turned to the left</span>
        <input inputmode="decimal" value=${turn} aria-invalid=${number(turn) === null ? "true" : "false"} onInput=${(/** @type {Event} */ event) => change({ turn: typed(event) })} />
        <span class="unit">°</span>
      </label>
    </div>
    <p class="note">0° faces the audience. Turned to the left, seen from above against the clock, its right side goes upstage.</p>
    <${Picture} />`;
}

function ByPoints() {
  const { points } = draft.value;
  const all = placed(draft.value);
  const sides = size(draft.value, 0);
  const off = all !== null && sides.every(isSide) ? contradiction(all, sides.map(Number)) : null;
  return html`<p>Three points of ${nameOf(0).toLowerCase()} as they were measured in the venue, by a total station or by tape.</p>
    ${points.map(
      ({ point, at }, k) => html`<${Which} key=${`which ${k}`} label=${`Point ${k + 1}`} value=${point} isFirst=${k === 0} act=${(/** @type {string} */ name) => change({ points: points.map((one, of) => (of === k ? { ...one, point: name } : one)) })} />
        <${Metres} key=${`at ${k}`} texts=${at} act=${(/** @type {string[]} */ texts) => change({ points: points.map((one, of) => (of === k ? { ...one, at: texts } : one)) })} />`,
    )}
    ${off !== null && off.share > ALIKE
      ? html`<p class="warned" role="status">From ${off.names.join(" to ")} it is ${off.typed.toFixed(3)} m by these points, and ${off.known.toFixed(3)} m by the sizes. Measure again.</p>`
      : null}`;
}

/** @type {{origin: "point" | "points", title: string}[]} */
const WAYS = [
  { origin: "point", title: "One point" },
  { origin: "points", title: "Three points" },
];

export function Origin() {
  const { origin } = draft.value;
  return html`<fieldset class="choice">
      <legend>By</legend>
      ${WAYS.map((one) => html`<label key=${one.origin}><input type="radio" name="origin" checked=${origin === one.origin} onChange=${() => change({ origin: one.origin })} /><span>${one.title}</span></label>`)}
    </fieldset>
    ${origin === "point" ? html`<${ByPoint} />` : html`<${ByPoints} />`}
    ${clicking.value === null
      ? null
      : html`<p class="note">${clicking.value}</p>`}`;
}
