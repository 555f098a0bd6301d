// A surface that is a printed poster: made by the daemon, printed, hung, and named here.
import { signal } from "../vendor/signals.js";
import { barred } from "../access.js";
import { content, reason, send } from "../ask.js";
import { html, typed } from "../ui.js";
import { changeSurface, draft, shown } from "./draft.js";
import { pictureAt } from "./upload.js";

/** Papers by their names for the daemon. */
const PAPERS = ["a4", "a3", "a2", "a1", "a0", "letter", "tabloid"];

/** How making it goes, or why it failed. */
const said = signal("");

/** @typedef {{file: string | null, width: number | null, height: number | null, size_m: number[] | null}} Sheet */

/** A length as it is typed. @param {number} metres */
function asTyped(metres) {
  const { unit } = draft.peek();
  if (unit === "ft") return `0' ${((metres / 0.3048) * 12).toFixed(2)}"`;
  return `${Number((unit === "cm" ? 100 * metres : metres).toFixed(unit === "cm" ? 1 : 3))}`;
}

/** The name of the sheet. */
const sheet = () => `poster-${shown.value.paper}-${shown.value.seed}`;

async function make() {
  said.value = "Painting it …";
  try {
    const name = sheet();
    /** @type {Sheet} */
    const made = await content(await send("PUT", `prints/${name}`));
    if (made.file === null || made.width === null || made.height === null || made.size_m === null) throw new Error("The poster has no picture. Make it again.");
    const [width, height] = made.size_m.map(asTyped);
    changeSurface({ artwork: { file: made.file, name: `${name}-picture.png`, width: made.width, height: made.height, fov_deg: null }, width, height, more: {} });
    said.value = "";
  } catch (why) {
    said.value = reason(why);
  }
}

/** A poster of another kind is to be made first. @param {{paper?: string, seed?: string}} part */
const choose = (part) => changeSurface({ ...part, artwork: null });

export function Poster() {
  const { paper, seed, artwork } = shown.value;
  const isSeed = /^\d{1,9}$/.test(seed);
  return html`<p>A printed picture that is found from near and far, for a stage without one. A larger one is found from farther away.</p>
    <div class="fields">
      <label class="field"><span>Paper</span>
        <select data-first value=${paper} onChange=${(/** @type {Event} */ event) => choose({ paper: typed(event) })}>
          ${PAPERS.map((name) => html`<option key=${name} value=${name} selected=${name === paper}>${name.toUpperCase()}</option>`)}
        </select>
      </label>
      <label class="field"><span>Number</span><input inputmode="numeric" value=${seed} aria-invalid=${isSeed ? "false" : "true"} onInput=${(/** @type {Event} */ event) => choose({ seed: typed(event).trim() })} /></label>
    </div>
    <p class="note">Each number is another picture. Two posters on one stage need two numbers.</p>
    ${artwork === null
      ? html`<div class="row"><button type="button" disabled=${!isSeed || barred.value !== null} onClick=${make}>Make the poster</button></div>`
      : html`<figure class="artwork"><img src=${pictureAt(artwork)} alt="The poster" /><figcaption>${sheet()}</figcaption></figure>
          <ol class="todo">
            <li><a class="button" href=${`./api/v1/prints/${sheet()}.pdf`} download>Download to print</a> at 100 %, on matt paper.</li>
            <li>Hold a ruler to the one on the sheet. If it is off, measure the picture, and type that in step 4.</li>
            <li>Glue it on something flat, and hang it upright where the camera sees it.</li>
          </ol>`}
    <p role="status">${said.value}</p>`;
}
