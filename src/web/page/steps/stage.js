// Step 3: how the surface looks, from its artwork or from a frozen picture with four corners.
import { signal } from "../vendor/signals.js";
import { barred } from "../access.js";
import { reason } from "../ask.js";
import { html } from "../ui.js";
import { ChooseFile } from "./choosefile.js";
import { Loupe, cornersFor } from "./corners.js";
import { change, draft } from "./draft.js";
import { freeze } from "./freeze.js";
import { pictureAt, putPicture } from "./upload.js";

/** @type {{door: "artwork" | "freeze", title: string}[]} */
const DOORS = [
  { door: "artwork", title: "Artwork" },
  { door: "freeze", title: "Freeze the picture" },
];

/** How freezing goes, or why it failed. */
const said = signal("");

function Artwork() {
  const { artwork } = draft.value;
  return html`<p>The picture that the surface shows, as it was printed or painted: the whole of it, straight from the front.</p>
    ${artwork === null ? null : html`<figure class="artwork"><img src=${pictureAt(artwork.name)} alt="The artwork" /><figcaption>${artwork.name}, ${artwork.width} x ${artwork.height} pixels</figcaption></figure>`}
    <${ChooseFile} label=${artwork === null ? "Choose picture …" : "Choose another picture …"} accept=".png,.jpg,.jpeg,.heic" take=${async (/** @type {File} */ file) => change({ artwork: await putPicture(file, file.name) })} isFirst />`;
}

async function take() {
  said.value = "Freezing …";
  try {
    const { blob, width, height, isMean } = await freeze();
    const stamp = new Date().toISOString().slice(0, 19).replace(/\D/g, "");
    const photo = await putPicture(blob, `stage-${stamp}.png`);
    const { corners, photo: before } = draft.peek();
    // A picture from the same place has its corners near the former ones.
    const isSame = before !== null && before.width === width && before.height === height && corners.length === 4;
    change({ photo, corners: isSame ? corners : cornersFor(width, height), former: [] });
    said.value = isMean ? "" : "The camera moves, so one frame was taken. A still camera gives a picture with less noise.";
  } catch (why) {
    said.value = reason(why);
  }
}

function Freeze() {
  const { photo } = draft.value;
  return html`<p>${photo === null ? "Point the camera so that the whole surface is seen, and keep it still." : "Place the four corners on those of the surface."}</p>
    <div class="row"><button type="button" data-first=${photo === null ? "" : null} disabled=${barred.value !== null} onClick=${take}>${photo === null ? "Freeze" : "Freeze again"}</button></div>
    <p role="status">${said.value}</p>
    ${photo === null ? null : html`<${Loupe} />`}`;
}

export function Stage() {
  const { door } = draft.value;
  return html`<fieldset class="choice">
      <legend>From</legend>
      ${DOORS.map((one) => html`<label key=${one.door}><input type="radio" name="door" checked=${door === one.door} onChange=${() => change({ door: one.door })} /><span>${one.title}</span></label>`)}
    </fieldset>
    ${door === "artwork" ? html`<${Artwork} />` : html`<${Freeze} />`}`;
}
