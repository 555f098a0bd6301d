// Step 2: the lens, guessed or from a calibration file.
import { draft, change } from "./draft.js";
import { amount, html, typed } from "../ui.js";
import { BoardCapture } from "./board.js";
import { ChooseFile } from "./choosefile.js";
import { putCalibration } from "./upload.js";

/** @type {{kind: "guess" | "file" | "board", title: string}[]} */
const KINDS = [
  { kind: "guess", title: "Guess its field of view" },
  { kind: "file", title: "Calibration file" },
  { kind: "board", title: "Board" },
];

function Guess() {
  return html`<label class="field wide">
      <span>Field of view across the picture's width</span>
      <input data-first inputmode="decimal" value=${draft.value.fov} onInput=${(/** @type {Event} */ event) => change({ fov: typed(event) })} />
      <span class="unit">degrees</span>
    </label>
    <p class="note">For a first look. Distances are then uncertain by some per cent. A board, a calibration file, or a walk (step 3) measures the lens.</p>`;
}

function File() {
  const { calibration } = draft.value;
  return html`
    ${calibration === null || calibration.width === 0 ? (calibration === null ? null : html`<p><b>${calibration.name}</b></p>`) : html`<p><b>${calibration.name}</b>: ${calibration.width} x ${calibration.height} pixels, ${amount(calibration.fov_deg, 1, "degrees")} across.</p>`}
    <${ChooseFile} label=${calibration === null ? "Choose file …" : "Choose another file …"} accept=".toml,.yaml,.yml,.m" take=${async (/** @type {globalThis.File} */ file) => change({ calibration: await putCalibration(file) })} isFirst />
    <p class="note">From <code>stagepose calibrate</code>, OpenCV, ROS, Kalibr or Bouguet's toolbox.</p>
  `;
}

export function Lens() {
  const { lens } = draft.value;
  return html`<fieldset class="choice">
      <legend>Known by</legend>
      ${KINDS.map(({ kind, title }) => html`<label key=${kind}><input type="radio" name="lens" checked=${lens === kind} onChange=${() => change({ lens: kind, ...(kind === lens ? {} : { calibration: null }) })} /><span>${title}</span></label>`)}
    </fieldset>
    ${lens === "config" ? html`<p>As the config has it. Choose another way to change it.</p>` : lens === "guess" ? html`<${Guess} />` : lens === "board" ? html`<${BoardCapture} />` : html`<${File} />`}`;
}
