// The Setup view: from a camera to a tracked stage, step by step. Each step can be opened at any
// time; what is typed is kept.
import { useEffect, useLayoutEffect, useRef } from "./vendor/hooks.js";
import { Barred, barred } from "./access.js";
import { sentence } from "./ask.js";
import { html } from "./ui.js";
import { Camera, findCameras } from "./steps/camera.js";
import { Check } from "./steps/check.js";
import { config, wanting } from "./steps/config.js";
import { Frozen } from "./steps/corners.js";
import { STEPS, after, change, draft, shown, startOver } from "./steps/draft.js";
import { isInForce } from "./steps/force.js";
import { found, watchFindings } from "./steps/judged.js";
import { readSaid } from "./steps/fromconfig.js";
import { Two, watchDraft } from "./steps/kept.js";
import { Lens } from "./steps/lens.js";
import { Look } from "./steps/look.js";
import { Origin } from "./steps/origin.js";
import { Outputs } from "./steps/outputs.js";
import { Sizes } from "./steps/sizes.js";
import { Stage, walks } from "./steps/stage.js";
import { pictureAt } from "./steps/upload.js";
import { isWriting, write } from "./steps/write.js";

/** @import { StepName } from "./steps/draft.js" */

const VIEWS = { camera: Camera, lens: Lens, stage: Stage, sizes: Sizes, origin: Origin, check: Check, outputs: Outputs };

/** How a step stands: it has all, it wants something, or the daemon refuses what is there. */
const MARKS = { done: "✓", open: "○", wrong: "!" };
const MARK_WORDS = { done: "done", open: "open", wrong: "has an error" };

/** @param {StepName} name @returns {keyof typeof MARKS} */
function standing(name) {
  if (found.value[name]?.some(({ level }) => level === "error")) return "wrong";
  if (name === "check") return isInForce.value ? "done" : "open";
  if (name === "outputs") return draft.value.outputs.length > 0 ? "done" : "open";
  return wanting.value[name] === "" ? "done" : "open";
}

function Steps() {
  return html`<nav class="progress" aria-label="Steps of the set-up">
    <ol>
      ${STEPS.map(({ name, title }, k) => {
        const stands = standing(name);
        return html`<li key=${name}>
          <button type="button" class=${stands} aria-current=${draft.value.step === name ? "step" : null} onClick=${() => change({ step: name })}>
            <span aria-hidden="true">${MARKS[stands]}</span> ${k + 1} <span class="title">${title}</span><span class="unseen">, ${MARK_WORDS[stands]}</span>
          </button>
        </li>`;
      })}
    </ol>
  </nav>`;
}

/** What is wrong at this step, and what is to be known. @param {{name: StepName}} props */
function Findings({ name }) {
  const all = found.value[name] ?? [];
  if (all.length === 0) return null;
  return html`<ul class="findings">
    ${all.map(({ level, sentence: words, mend }, k) => html`<li key=${k} class=${level}>${[words, mend].filter(Boolean).map((part) => sentence(`${part}`)).join(" ")}</li>`)}
  </ul>`;
}

/** The one primary action of a step. @param {StepName} name */
function primary(name) {
  const isWritten = isInForce.value;
  if (name === "check") return isWritten ? "Next" : "Write the config and track";
  if (name === "outputs") return isWritten ? "Done: show it live" : "Write the config";
  return "Next";
}

/** @param {StepName} name */
async function go(name) {
  if (name !== "check" && name !== "outputs") {
    if (wanting.peek()[name] === "") change({ step: after(name) });
  } else if (!isInForce.peek()) {
    // The check is where one sees how it goes.
    if (await write(false)) change({ step: name });
    else change({ step: "check" });
  } else if (name === "check") change({ step: "outputs" });
  else location.hash = "live";
}

function Step() {
  const form = useRef(/** @type {HTMLFormElement | null} */ (null));
  const { step } = draft.value;
  const { title } = STEPS.find(({ name }) => name === step) ?? STEPS[0];
  useLayoutEffect(() => {
    // Keys go on where the step begins.
    const first = form.current?.querySelector("[data-first]") ?? form.current?.querySelector("button[type=submit]");
    if (first instanceof HTMLElement) first.focus();
  }, [step]);
  const wants = wanting.value[step];
  const needsAll = step === "check" || step === "outputs";
  const isOff = wants !== "" || (needsAll && config.value === null) || (needsAll && !isInForce.value && barred.value !== null) || isWriting.value;
  const submit = (/** @type {Event} */ event) => {
    event.preventDefault();
    if (!isOff) void go(step);
  };
  const View = VIEWS[step];
  return html`<form ref=${form} class="beside step" onSubmit=${submit}>
    <h2>${title}</h2>
    <${Barred} />
    <${View} key=${step} />
    <${Findings} name=${step} />
    <p class="note wants" role="status">${wants}</p>
    ${readSaid.value === "" ? null : html`<p class="warned" role="status">${readSaid.value}</p>`}
    <div class="row">
      <button type="submit" class="primary" aria-disabled=${isOff ? "true" : "false"}>${primary(step)}</button>
      ${step === "camera" && draft.value.edited > 0 ? html`<button type="button" onClick=${startOver}>Start over</button>` : null}
    </div>
  </form>`;
}

/** The view. */
export function Setup() {
  useEffect(() => watchFindings(), []);
  useEffect(() => watchDraft(), []);
  // The step of the camera looks for cameras itself.
  useEffect(() => {
    if (draft.peek().step !== "camera") void findCameras();
  }, []);
  const { step } = draft.value;
  const { door, photo } = shown.value;
  const isFrozen = step === "stage" && door === "freeze" && photo !== null && !walks.value && pictureAt(photo) !== null;
  return html`<main class="setup">
    <link rel="stylesheet" href="./views.css" />
    <link rel="stylesheet" href="./setup.css" />
    <${Steps} />
    <${Two} />
    ${isFrozen ? html`<${Frozen} />` : html`<${Look} />`}
    <${Step} />
  </main>`;
}
