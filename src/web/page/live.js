// The Live view: the state as one sentence, and where the camera is.
import { contact, record, state } from "./daemon.js";
import { StateMark, amount, html } from "./ui.js";

/** The state to show: the daemon's, unless it is silent. */
function shown() {
  if (contact.value === false) return "none";
  return state.value?.state ?? "searching";
}

/** What the states mean, for a person. */
const SENTENCES = {
  tracking: "The camera's pose is measured in every frame.",
  coasting: "The stage is not seen just now; the pose is predicted for a moment.",
  searching: "The stage has not been found yet.",
  lost: "The stage was tracked and is not seen any more.",
  stale: "The camera gives no pictures.",
  none: "stagepose does not answer. This page looks for it until it does.",
};

function Facts() {
  const pose = record.value?.pose;
  const [x, y, z] = pose?.position_m ?? [];
  const rows = [
    ["right", amount(x, 3, "m")],
    ["upstage", amount(y, 3, "m")],
    ["up", amount(z, 3, "m")],
    ["does not fit", amount(record.value?.rms_px, 2, "px")],
    ["frame", state.value?.sequence ?? "–"],
    ["age", amount(state.value?.age_s === null ? null : (state.value?.age_s ?? 0) * 1000, 0, "ms")],
  ];
  return html`<dl class="facts">
    ${rows.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value}</dd></div>`)}
  </dl>`;
}

/** The view. */
export function Live() {
  const now = /** @type {keyof typeof SENTENCES} */ (shown());
  return html`<main class=${contact.value === false ? "silent" : ""}>
    <section class="says" role="status">
      <${StateMark} state=${now} />
      <p>${SENTENCES[now]}</p>
    </section>
    <section aria-label="The camera's pose"><${Facts} /></section>
  </main>`;
}
