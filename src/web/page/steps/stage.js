// Step 3: how each surface looks, from its artwork, a poster, or a frozen picture with four corners;
// and the walk that measures how all of it stands.
import { signal } from "../vendor/signals.js";
import { barred } from "../access.js";
import { reason } from "../ask.js";
import { html, typed } from "../ui.js";
import { ChooseFile } from "./choosefile.js";
import { nameOf } from "./config.js";
import { Loupe, cornersFor } from "./corners.js";
import { addSurface, change, changeSurface, draft, removeSurface, shown } from "./draft.js";
import { freeze } from "./freeze.js";
import { number } from "./lengths.js";
import { Poster } from "./poster.js";
import { pictureAt, putPicture } from "./upload.js";
import { Walk } from "./walk.js";

/** @import { Door } from "./draft.js" */

/** @type {{door: Door, title: string}[]} */
const DOORS = [
  { door: "artwork", title: "Artwork" },
  { door: "freeze", title: "Freeze the picture" },
  { door: "poster", title: "Poster" },
];

/** How freezing goes, or why it failed. */
const said = signal("");
/** Whether the walk is shown in place of a surface. */
export const walks = signal(false);

function Artwork() {
  const { artwork } = shown.value;
  const isShown = artwork !== null && pictureAt(artwork) !== null;
  return html`<p>The picture that the surface shows, as it was printed or painted: the whole of it, straight from the front.</p>
    ${artwork === null ? null : html`<figure class="artwork">${isShown ? html`<img src=${pictureAt(artwork)} alt="The artwork" />` : null}<figcaption>${artwork.name}${artwork.width > 0 ? `, ${artwork.width} x ${artwork.height} pixels` : ""}</figcaption></figure>`}
    <${ChooseFile} label=${artwork === null ? "Choose picture …" : "Choose another picture …"} accept=".png,.jpg,.jpeg,.heic" take=${async (/** @type {File} */ file) => changeSurface({ artwork: await putPicture(file, file.name), more: withoutShape() })} isFirst />`;
}

/** What a config says of a surface beside the steps, without a shape that another picture had. */
function withoutShape() {
  return Object.fromEntries(Object.entries(shown.peek().more).filter(([key]) => key !== "shape"));
}

async function take() {
  said.value = "Freezing …";
  try {
    const { blob, width, height, isMean } = await freeze();
    const stamp = new Date().toISOString().slice(0, 19).replace(/\D/g, "");
    const photo = await putPicture(blob, `stage-${stamp}.png`);
    const { corners, photo: before } = shown.peek();
    // A picture from the same place has its corners near the former ones.
    const isSame = before !== null && before.width === width && before.height === height && corners.length === 4;
    changeSurface({ photo, corners: isSame ? corners : cornersFor(width, height), former: [], more: withoutShape() });
    said.value = isMean ? "" : "The camera moves, so one frame was taken. A still camera gives a picture with less noise.";
  } catch (why) {
    said.value = reason(why);
  }
}

function Freeze() {
  const { photo } = shown.value;
  return html`<p>${photo === null ? "Point the camera so that the whole surface is seen, and keep it still." : "Place the four corners on those of the surface."}</p>
    <div class="row"><button type="button" data-first=${photo === null ? "" : null} disabled=${barred.value !== null} onClick=${take}>${photo === null ? "Freeze" : "Freeze again"}</button></div>
    <p role="status">${said.value}</p>
    ${photo === null ? null : html`<${Loupe} />`}`;
}

/** The surfaces there are, where there are several, and how one is added. */
function Surfaces() {
  const { surfaces, surface } = draft.value;
  return html`<div class="row surfaces">
    ${surfaces.length === 1
      ? null
      : surfaces.map((_, k) => html`<button key=${k} type="button" class="tab" aria-pressed=${!walks.value && k === surface ? "true" : "false"} onClick=${() => ((walks.value = false), change({ surface: k }))}>${nameOf(k)}</button>`)}
    <button type="button" class="quiet" onClick=${() => ((walks.value = false), addSurface())}>+ Surface</button>
    ${surfaces.length === 1 || walks.value ? null : html`<button type="button" class="quiet danger" onClick=${removeSurface}>Remove ${nameOf(surface)}</button>`}
    <button type="button" class="tab" aria-pressed=${walks.value ? "true" : "false"} onClick=${() => (walks.value = !walks.value)}>Walk</button>
  </div>`;
}

const AXES = ["to its right", "upstage", "up"];

/** Where a further surface is. */
function Place() {
  const { place, turn } = shown.value;
  const typedAt = (/** @type {number} */ axis) => (/** @type {Event} */ event) => changeSurface({ place: place.map((text, k) => (k === axis ? typed(event) : text)) });
  const field = (/** @type {string} */ name, /** @type {string} */ value, /** @type {(event: Event) => void} */ act, /** @type {string} */ unit) => html`<label key=${name} class="field">
    <span>${name}</span>
    <input inputmode="decimal" value=${value} aria-invalid=${number(value) === null ? "true" : "false"} onInput=${act} />
    <span class="unit">${unit}</span>
  </label>`;
  return html`<h3>Where its centre is, from that of ${nameOf(0)}</h3>
    <div class="fields">${AXES.map((name, axis) => field(name, place[axis], typedAt(axis), "m"))}</div>
    <div class="fields">${field("Turned to the left", turn, (event) => changeSurface({ turn: typed(event) }), "°")}</div>
    <p class="note">As measured by tape. A walk measures it to the millimetre.</p>`;
}

export function Stage() {
  const { door } = shown.value;
  if (walks.value) return html`<${Surfaces} /><${Walk} />`;
  return html`<${Surfaces} />
    <fieldset class="choice">
      <legend>From</legend>
      ${DOORS.map((one) => html`<label key=${one.door}><input type="radio" name="door" checked=${door === one.door} onChange=${() => changeSurface({ door: one.door, ...(one.door === "poster" ? { artwork: null } : {}) })} /><span>${one.title}</span></label>`)}
    </fieldset>
    ${door === "artwork" ? html`<${Artwork} />` : door === "poster" ? html`<${Poster} />` : html`<${Freeze} />`}
    ${draft.value.surface === 0 ? null : html`<${Place} />`}`;
}
