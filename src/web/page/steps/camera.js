// Step 1: which camera, with its live picture before there is any config.
import { signal } from "../vendor/signals.js";
import { useEffect } from "../vendor/hooks.js";
import { barred } from "../access.js";
import { post, read, reason } from "../ask.js";
import { html } from "../ui.js";
import { means } from "./config.js";
import { change, draft } from "./draft.js";
import { automatic, locked } from "./locks.js";
import { warnings, watchPictures } from "./warnings.js";

/** @import { Means } from "../types.js" */

/** Why the cameras are not known, or one is not shown. */
const fault = signal("");

async function look() {
  try {
    means.value = await read("setup");
    fault.value = "";
  } catch (why) {
    fault.value = reason(why);
  }
}

/** Asks for the picture of the chosen camera. @param {string | null} device */
async function show(device) {
  if (barred.peek() !== null) return;
  await post("setup/camera", { device }).catch((/** @type {unknown} */ why) => (fault.value = reason(why)));
}

/** Looks for cameras, and shows the one that was chosen before. */
export async function findCameras() {
  await look();
  const { device } = draft.peek();
  if (device !== null && means.peek()?.shown !== device) await show(device);
}

/** @param {string} device */
function choose(device) {
  change({ device, controls: null });
  void show(device);
}

/** Takes the camera's exposure, focus and white balance as they are now. @param {boolean} on */
async function lock(on) {
  if (!on) return change({ controls: null });
  // They may have changed since they were listed.
  await look();
  const camera = means.peek()?.cameras.find(({ device }) => device === draft.peek().device);
  if (camera) change({ controls: locked(camera.controls) });
}

/** @param {{camera: Means["cameras"][number]}} props */
function Choice({ camera: { name, device, held_by } }) {
  return html`<label class="choice-line">
    <input type="radio" name="camera" checked=${draft.value.device === device} onChange=${() => choose(device)} />
    <span><b>${name}</b> <small>${device}</small>${held_by.length > 0 ? html`<small class="refused">In use by ${held_by.join(", ")}. Close it to see the picture.</small>` : null}</span>
  </label>`;
}

function Lock() {
  const camera = means.value?.cameras.find(({ device }) => device === draft.value.device);
  if (!camera || Object.keys(locked(camera.controls)).length === 0) return null;
  const { controls } = draft.value;
  return html`<label class="choice-line">
      <input type="checkbox" checked=${controls !== null} onChange=${(/** @type {Event} */ { target }) => lock(/** @type {HTMLInputElement} */ (target).checked)} />
      <span>Lock exposure, focus and white balance as they are now</span>
    </label>
    ${controls === null ? html`<p class="note">A camera that focuses by itself changes its lens, and the pose with it.</p>` : html`<p class="note">${Object.entries(controls).map(([name, value]) => `${name} = ${value}`).join(", ")}</p>`}`;
}

/** What is wrong with the pictures, and which automatics run. */
function Warnings() {
  useEffect(() => watchPictures(), []);
  const camera = means.value?.cameras.find(({ device }) => device === draft.value.device);
  const runs = camera && draft.value.controls === null ? automatic(camera.controls) : [];
  const all = [...warnings.value, ...(runs.length === 0 ? [] : [`The camera sets by itself: ${runs.join(", ")}. Lock it, or poses change when it does.`])];
  if (all.length === 0) return null;
  return html`<div role="status"><ul class="findings">${all.map((words) => html`<li key=${words} class="warning">${words}</li>`)}</ul></div>`;
}

export function Camera() {
  useEffect(() => void findCameras(), [barred.value]);
  const { cameras, plays } = means.value ?? { cameras: [], plays: null };
  return html`
    ${plays !== null ? html`<p>The clip <b>${plays}</b> is played in place of a camera.</p>` : null}
    ${plays === null ? cameras.map((camera) => html`<${Choice} key=${camera.device} camera=${camera} />`) : null}
    ${plays === null ? html`<${Lock} />` : null}
    <${Warnings} />
    <p class="refused" role="alert">${fault.value}</p>
    <div class="row"><button type="button" onClick=${findCameras}>Look again</button></div>
  `;
}
