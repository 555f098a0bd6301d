// The Set view: scenery in the camera's own picture, what is on it, and how well it is aligned.
import { effect, signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { contact, frozen, head, scene, standing } from "./daemon.js";
import { MODES } from "./gl/compose.js";
import { again, clean, composeOn, fault, floorHeight, learn, measured, mode, share } from "./composite.js";
import { NumberField } from "./fields.js";
import { ACTIONS, action, handlesOn } from "./gizmo.js";
import { isTorn, keepMine, keepSet, saved, takeTheirs } from "./keeping.js";
import { load, models } from "./models.js";
import { add, alter, change, chosen, remove, set, undo } from "./things.js";
import { amount, html, typed } from "./ui.js";

/** What each mode shows. */
const SHOWS = {
  image: "The camera's picture alone.",
  set: "The set in the camera's picture.",
  mix: "The set half transparent.",
  wipe: "The set to the right of the line.",
  alone: "The set alone on black, for a keyer or a projector.",
};
const KINDS = /** @type {const} */ (["cone", "cube", "grid"]);
const AXES = { floor: ["Right", "Upstage", "Up"], surface: ["Right", "Up", "Out"] };

/** What went wrong with a file. */
const refused = signal(/** @type {string | null} */ (null));

function Picture() {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const figure = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => {
    const own = /** @type {HTMLCanvasElement} */ (canvas.current);
    const end = composeOn(own);
    const endHandles = handlesOn(own);
    const endKeeping = keepSet();
    // The set, the way it is shown and the stage change the picture also between frames.
    const stop = effect(() => {
      void [set.value, models.value, mode.value, share.value, clean.value];
      again();
    });
    const stopLearning = effect(() => {
      void [scene.value, set.value.floor_m];
      learn();
    });
    const left = () => (clean.value = document.fullscreenElement !== null);
    document.addEventListener("fullscreenchange", left);
    return () => {
      document.removeEventListener("fullscreenchange", left);
      stop();
      stopLearning();
      endKeeping();
      endHandles();
      end();
    };
  }, []);
  const [width, height] = head.value?.size ?? [16, 9];
  const room = { aspectRatio: width / height, maxWidth: `calc((100vh - 9rem) * ${width / height})` };
  return html`<div>
    <figure ref=${figure} class="picture composite" style=${room}>
      <canvas ref=${canvas} role="img" aria-label="The camera's picture with the set in it" />
      ${fault.value ? html`<figcaption>${fault.value}</figcaption>` : null}
    </figure>
    <div class="row">
      <${Modes} />
      <button type="button" onClick=${() => figure.current?.requestFullscreen?.()}>Full screen, clean</button>
    </div>
  </div>`;
}

function Modes() {
  const has = mode.value === "mix" || mode.value === "wipe";
  return html`<fieldset class="choice">
      <legend>Show</legend>
      ${MODES.map(
        (name) => html`<label key=${name} title=${SHOWS[name]}>
          <input type="radio" name="mode" value=${name} checked=${mode.value === name} onChange=${() => (mode.value = name)} />
          <span>${name}</span>
        </label>`,
      )}
    </fieldset>
    ${has
      ? html`<label class="slider"><span>${mode.value === "mix" ? "Strength" : "Line"}</span>
          <input type="range" min="0" max="1" step="0.01" value=${share.value} onInput=${(/** @type {Event} */ event) => (share.value = Number(typed(event)))} />
        </label>`
      : null}`;
}

/** The alignment as a number, and what it means. */
function Alignment() {
  // Where no frames come, the last number says nothing of now.
  const found = contact.value === false || (standing.value !== null && !frozen.value) ? null : measured.value;
  const none = contact.value === false ? "stagepose does not answer." : "Nothing is measured while the stage is not tracked.";
  const words = () => {
    if (found === null) return none;
    if (found.median === null) return "No part of the artwork is fully visible in the picture.";
    const covered = found.unlike > 0 ? ` ${found.unlike} more show something else: they may be hidden.` : "";
    return `Half of ${found.tiles} tiles of 32 px lie within ${amount(found.median, 2, "px")} of the camera's picture, nine of ten within ${amount(found.most, 2, "px")}; same frame (${found.sequence}).${covered}`;
  };
  return html`<section class="aligned" aria-labelledby="aligned">
    <h2 id="aligned">Alignment</h2>
    <p class="figure">${amount(found?.median, 2, "px")}</p>
    <p class="note">${words()}</p>
  </section>`;
}

/** @param {{thing: import("./things.js").Thing}} props */
function Chosen({ thing }) {
  const { id, on } = thing;
  const surfaces = scene.value?.stage.surfaces ?? [];
  const names = AXES[on === "floor" ? "floor" : "surface"];
  const three = (/** @type {"position_m" | "rotation_deg" | "size_m"} */ key, /** @type {string[]} */ labels, /** @type {{unit: string, step?: number, least?: number}} */ rest) =>
    labels.map((label, k) => {
      const onValue = (/** @type {number} */ value) => alter(id, { [key]: thing[key].map((old, axis) => (axis === k ? value : old)) });
      return html`<${NumberField} key=${`${id} ${key} ${k}`} label=${label} value=${thing[key][k]} ...${rest} onValue=${onValue} />`;
    });
  return html`<section class="chosen" aria-label=${thing.name}>
    <label class="field wide"><span>Name</span><input type="text" value=${thing.name} maxlength="60" onInput=${(/** @type {Event} */ event) => alter(id, { name: typed(event) })} /></label>
    <label class="field wide"><span>Stands on</span>
      <select value=${on} onChange=${(/** @type {Event} */ event) => alter(id, { on: typed(event) })}>
        <option value="floor" selected=${on === "floor"}>the floor</option>
        ${surfaces.map(({ name }, k) => html`<option key=${k} value=${`${k}`} selected=${on === `${k}`}>${name}</option>`)}
      </select>
    </label>
    <div class="fields">${three("position_m", names, { unit: "m" })}</div>
    <div class="fields">${three("rotation_deg", ["About x", "About y", "About z"], { unit: "°", step: 5 })}</div>
    <div class="fields">${three("size_m", ["Wide", "Deep", "High"], { unit: "m", least: 0.001 })}</div>
    <div class="row">
      <fieldset class="choice">
        <legend>Handles</legend>
        ${ACTIONS.map(
          ({ action: own, name }) => html`<label key=${own}>
            <input type="radio" name="action" value=${own} checked=${action.value === own} onChange=${() => (action.value = own)} />
            <span>${name}</span>
          </label>`,
        )}
      </fieldset>
    </div>
    <div class="row">
      <label class="field"><span>Colour</span><input type="color" value=${thing.colour} onInput=${(/** @type {Event} */ event) => alter(id, { colour: typed(event) })} /></label>
      <button type="button" aria-pressed=${thing.shown ? "true" : "false"} onClick=${() => alter(id, { shown: !thing.shown })}>Shown</button>
      <button type="button" onClick=${() => remove(id)}>Remove</button>
    </div>
    ${thing.kind === "model" && !models.value.has(thing.file ?? "") ? html`<p class="note">Its file ${thing.file} is missing: choose it again above.</p>` : null}
  </section>`;
}

/** @param {Event} event */
async function chosenFile({ target }) {
  const input = /** @type {HTMLInputElement} */ (target);
  const [file] = input.files ?? [];
  if (!file) return;
  refused.value = null;
  try {
    const { name, unkept } = await load(file);
    if (!set.value.objects.some((thing) => thing.file === name)) add("model", { file: name, name: name.replace(/\.glb$/i, "") });
    if (unkept !== null) refused.value = `${file.name} is loaded, but stagepose could not save it: ${unkept}`;
  } catch (why) {
    refused.value = why instanceof Error ? why.message : String(why);
  }
  input.value = "";
}

function Things() {
  const { objects } = set.value;
  const thing = objects.find(({ id }) => id === chosen.value);
  return html`<section class="things" aria-labelledby="things">
    <h2 id="things">On the set</h2>
    <div class="row">
      ${KINDS.map((kind) => html`<button key=${kind} type="button" onClick=${() => add(kind)}>+ ${kind}</button>`)}
      <label class="button">+ model (.glb)<input type="file" accept=".glb" onChange=${chosenFile} /></label>
      <button type="button" onClick=${undo}>Undo</button>
    </div>
    ${refused.value ? html`<p class="refused" role="alert">${refused.value}</p>` : null}
    ${objects.length === 0 ? html`<p class="note">The set is empty. Add a cone: it appears at the stage's origin.</p>` : null}
    <ul class="list">
      ${objects.map(
        ({ id, name }) => html`<li key=${id}>
          <button type="button" aria-pressed=${id === chosen.value ? "true" : "false"} onClick=${() => (chosen.value = id === chosen.value ? null : id)}>${name}</button>
        </li>`,
      )}
    </ul>
    ${thing ? html`<${Chosen} thing=${thing} />` : null}
    <div class="fields">
      <${NumberField} label="Floor's height" unit="m" value=${floorHeight()} onValue=${(/** @type {number} */ floor_m) => change({ floor_m })} />
    </div>
    <p class="note" role="status">${saved.value}</p>
    ${isTorn.value
      ? html`<div class="row">
          <button type="button" onClick=${keepMine}>Keep mine</button>
          <button type="button" onClick=${takeTheirs}>Take theirs</button>
        </div>`
      : null}
    <p class="note">Surfaces and the floor receive shadows, and surfaces hide what is behind them.</p>
  </section>`;
}

/** The view. */
export function SetPage() {
  return html`<main class=${contact.value === false ? "silent" : ""}>
    <link rel="stylesheet" href="./views.css" />
    <${Picture} />
    <div class="beside">
      <${Alignment} />
      <${Things} />
    </div>
  </main>`;
}
