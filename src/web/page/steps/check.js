// Step 6: the config is written, and shows how well the stage is tracked.
import { computed } from "../vendor/signals.js";
import { barred, session } from "../access.js";
import { isInForce } from "./force.js";
import { Pan } from "./pan.js";
import { sentence } from "../ask.js";
import { head, standing } from "../daemon.js";
import { added, minute } from "../minute.js";
import { StateMark, amount, html } from "../ui.js";
import { config, wanting } from "./config.js";
import { STEPS, change } from "./draft.js";
import { readBack } from "./fromconfig.js";
import { found, unasked } from "./judged.js";
import { isOther, isWriting, said, write } from "./write.js";

/** Milliseconds over which found frames are counted. */
const OVER = 10_000;

/** The last seconds of tracking: the share of frames with a measured pose, and the residual. */
const recent = computed(() => {
  void added.value;
  const now = performance.now();
  const frames = minute.filter(({ at }) => at > now - OVER);
  const rms = frames.flatMap((frame) => (frame.state === "tracking" && frame.rms !== null ? [frame.rms] : [])).sort((a, b) => a - b);
  return { count: frames.length, share: frames.filter(({ state }) => state === "tracking").length / Math.max(frames.length, 1), rms: rms[Math.floor(rms.length / 2)] ?? null };
});

function Tracking() {
  const { count, share, rms } = recent.value;
  const state = standing.value?.state ?? head.value?.record.state ?? "searching";
  return html`<p><${StateMark} state=${state} /></p>
    <dl class="facts">
      <div><dt>Found</dt><dd>${count === 0 ? "–" : `${Math.round(100 * share)} %`}</dd></div>
      <div><dt>Residual</dt><dd>${amount(rms, 2, "px")}</dd></div>
    </dl>
    <p class="note">Of the last ten seconds. ${advice(count, share, rms)}</p>
    ${head.value?.says && state !== "tracking" ? html`<p class="warned">${sentence(head.value.says)} ${sentence(head.value.mend ?? "")}</p>` : null}`;
}

/** What the figures say. @param {number} count @param {number} share @param {number | null} rms */
function advice(count, share, rms) {
  if (count === 0) return "Frames are awaited.";
  if (share < 0.5) return "Point the camera at the surface. If it is seen and not found, look at picture, corners and lens again.";
  if (rms !== null && rms > 0.5) return "The stage is found, but the picture does not lie well on it. Look at lens and sizes again.";
  return "The stage is found. Pan slowly over all of it to be sure.";
}

/** What other steps still want, each with the way there. */
function Wanted() {
  const open = STEPS.filter(({ name }) => wanting.value[name] !== "" || (name !== "check" && found.value[name]?.some(({ level }) => level === "error")));
  if (open.length === 0) return null;
  return html`<ul class="list wanted">
    ${open.map(({ name, title }) => html`<li key=${name}><button type="button" onClick=${() => change({ step: name })}>${title}</button> ${wanting.value[name] || "The daemon refuses what is there."}</li>`)}
  </ul>`;
}

function Other() {
  if (!isOther.value) return null;
  return html`<p class="warned" role="alert">
    ${session.value?.config_file ?? "The config"} holds another config, which this set-up did not write, or which was changed since. Writing replaces it; it is kept in the folder “former”.
    <span class="row"><button type="button" class="danger" onClick=${() => write(true)}>Replace it</button><button type="button" onClick=${readBack}>Go on from that one</button></span>
  </p>`;
}

export function Check() {
  const text = config.value;
  return html`<${Wanted} />
    <${Other} />
    <p role="status">${isWriting.value ? "Writing …" : said.value}</p>
    ${unasked.value && barred.value === null ? html`<p class="refused">${unasked.value}</p>` : null}
    ${isInForce.value ? html`<${Tracking} /><${Pan} />` : text === null ? null : html`<p>The config is complete. Writing it starts tracking.</p>`}
    ${text === null ? null : html`<details><summary>The config as text</summary><pre tabindex="0">${text}</pre></details>`}`;
}
