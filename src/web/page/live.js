// The Live view: the picture with what was found in it, the state in a sentence, the camera's
// position.
import { computed, effect, signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { session } from "./access.js";
import { contact, frozen, head, painters, rate, standing } from "./daemon.js";
import { Happened, trouble } from "./events.js";
import { panTiltRoll } from "./lens.js";
import { drawAgain, drawFrame, drawOn, floored, hidden, outlined, parted, rested, restsOn } from "./picture.js";
import { Stage } from "./stage.js";
import { Strip } from "./strip.js";
import { theme } from "./theme.js";
import { StateMark, amount, html } from "./ui.js";

/** Minimum milliseconds a sentence stays in the same state: reasons may change with every frame. */
const STANDS = 1000;
/** Milliseconds after which seen.js is loaded: the first picture must not wait for it. */
const WAITS = 8000;

/** @import { State as Word } from "./types.js" */
/**
 * @typedef {{state: Word | "none" | "withheld", sentence: string, mend: string | null}} Account what the state
 *   is, for a person
 */

/** Sentences for states without a reason. */
const SENTENCES = {
  tracking: "The camera's pose is measured in every frame.",
  coasting: "The stage is briefly not seen; the pose is predicted.",
  searching: "The stage has not been found yet.",
  lost: "The stage was tracked, but is no longer seen.",
  stale: "The camera sends no pictures.",
  withheld: "A pose is found, but not sent.",
  none: "stagepose does not answer.",
};
/** Reasons for which a pose that was found is not reported: the stage is seen, and not searched. */
const WITHHELD = ["lens_moved", "mixed", "jumped"];
/** @type {Partial<Record<Account["state"], string>>} */
const HINTS = {
  stale: "Check that the camera is plugged in and that no other program uses it.",
  none: "Check that it runs. This page continues on its own when it is back.",
};

/** @returns {Account} */
function account() {
  if (contact.value === false) return of("none");
  if (contact.value === null) return { state: "searching", sentence: "Connecting to stagepose.", mend: null };
  if (session.value?.mode === "setup" && standing.value === null) return { state: "searching", sentence: "The camera's picture is shown. Nothing is tracked before the stage is set up.", mend: null };
  if (standing.value !== null) {
    const { state } = standing.value;
    if ((state === null || state === "stale") && trouble.value !== null) return { state: state ?? "stale", sentence: trouble.value, mend: null };
    return state === null ? { state: "searching", sentence: "The camera has not sent a picture yet.", mend: HINTS.stale ?? null } : of(state);
  }
  const { says, mend, reason, record } = head.value ?? {};
  return record && says ? { state: reason && WITHHELD.includes(reason) ? "withheld" : record.state, sentence: `${says[0].toUpperCase()}${says.slice(1)}.`, mend: hintSentence(mend) } : withHidden(of(record?.state ?? "searching"));
}

/**
 * Adds what is hidden: tracking continues with a part of the stage, but users should know.
 * @param {Account} of
 */
function withHidden({ state, sentence, mend }) {
  return { state, sentence: state === "tracking" && hidden.value ? `${sentence} ${hidden.value}` : sentence, mend };
}

/** @param {Account["state"]} state */
function of(state) {
  return { state, sentence: SENTENCES[state], mend: HINTS[state] ?? null };
}

/** A hint as a sentence. @param {string | null | undefined} mend */
function hintSentence(mend) {
  return mend ? `${mend[0].toUpperCase()}${mend.slice(1)}.` : null;
}

/** The sentence shown; it stays for a while unless the state changes. */
const said = signal(account());
let saidAt = 0;

effect(() => {
  const next = account();
  const now = performance.now();
  const before = said.peek();
  const isSame = next.state === before.state && next.sentence === before.sentence;
  if (isSame || (next.state === before.state && now - saidAt < STANDS)) return;
  saidAt = now;
  said.value = next;
});

/** The state as the bar shows it. */
export function State() {
  return html`<${StateMark} state=${said.value.state} />`;
}

/** Width over height of the pictures; that of a wide picture before the first. */
const aspect = computed(() => (head.value === null ? 16 / 9 : head.value.size[0] / head.value.size[1]));

/** What the residuals of the shown frame are drawn to; a frame without a pose has none. */
const rests = computed(() => (head.value === null || head.value.record.pose ? restsOn.value : "Nothing is measured in this frame."));

function Picture() {
  const below = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const above = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    const marks = /** @type {HTMLCanvasElement} */ (above.current);
    drawOn(below.current, marks);
    const sized = new ResizeObserver(drawAgain);
    sized.observe(marks);
    painters.add(drawFrame);
    let isGone = false;
    let end = () => {};
    // What can wait must not delay the first picture.
    const later = setTimeout(async () => {
      const { watchSeen } = await import("./seen.js");
      if (!isGone) end = watchSeen();
    }, WAITS);
    return () => {
      isGone = true;
      clearTimeout(later);
      end();
      painters.delete(drawFrame);
      sized.disconnect();
    };
  }, []);
  useEffect(() => {
    if (!rested.value) return;
    let isGone = false;
    let end = () => {};
    import("./used.js").then(({ watchUsed }) => !isGone && (end = watchUsed()), () => (rested.value = false));
    return () => {
      isGone = true;
      end();
    };
  }, [rested.value]);
  // Marks have the theme's colours; which are drawn is chosen.
  useEffect(drawAgain, [theme.value, outlined.value, floored.value, parted.value]);
  return html`<figure class="picture" style=${{ aspectRatio: aspect.value, maxWidth: `calc((100vh - 9rem) * ${aspect.value})` }}>
    <canvas ref=${below} role="img" aria-label="What the camera sees" />
    <canvas ref=${above} class="marks ${outlined.value || floored.value || parted.value || rested.value ? "" : "off"}" aria-hidden="true" />
    ${rested.value ? html`<p class="scale">${rests}</p>` : null}
    ${frozen.value ? html`<figcaption>Frozen. Press Space to continue.</figcaption>` : null}
  </figure>`;
}

/** The record of the shown frame, while frames come or the user looks at this one. */
const record = computed(() => (contact.value && (frozen.value || standing.value === null) ? (head.value?.record ?? null) : null));

// What changes with every frame goes directly into its text, without rendering a view.
const position = (/** @type {number} */ axis) => computed(() => amount(record.value?.pose?.position_m[axis], 3, "m"));
const angles = computed(() => (record.value?.pose ? panTiltRoll(record.value.pose.orientation_xyzw) : null));
const angle = (/** @type {number} */ axis) => computed(() => amount(angles.value?.[axis], 1, "°"));
const FACTS = [
  { name: "Right", value: position(0) },
  { name: "Upstage", value: position(1) },
  { name: "Up", value: position(2) },
  { name: "Pan", value: angle(0) },
  { name: "Tilt", value: angle(1) },
  { name: "Roll", value: angle(2) },
  { name: "Residual", value: computed(() => amount(record.value?.rms_px, 2, "px")) },
  { name: "Frame", value: computed(() => `${record.value?.sequence ?? "–"}`) },
  { name: "Shown", value: computed(() => amount(rate.value, 1, "/s")) },
];

function Facts() {
  return html`<dl class="facts">
    ${FACTS.map(({ name, value }) => html`<div key=${name}><dt>${name}</dt><dd>${value}</dd></div>`)}
  </dl>`;
}

/** @typedef {{name: string, state: Word}} Listed an object in the list */

/**
 * Names and states of the tracked objects. The list is replaced only if they change, so its view is
 * rarely rendered.
 */
const objects = computed(() => {
  const now = record.value?.objects ?? [];
  const isSame = now.length === listed.length && now.every(({ name, state }, k) => name === listed[k].name && state === listed[k].state);
  if (!isSame) listed = now.map(({ name, state }) => ({ name, state }));
  return listed;
});
/** @type {Listed[]} */
let listed = [];

function Objects() {
  const all = objects.value;
  if (all.length === 0) return null;
  return html`<ul class="objects">
    ${all.map(({ name, state }) => html`<li key=${name}><span>${name}</span> <${StateMark} state=${state} /></li>`)}
  </ul>`;
}

/** The view. */
export function Live() {
  return html`<main class=${contact.value === false ? "silent" : ""}>
    <${Picture} />
    <div class="beside">
      <section class="says" role="status" aria-live="polite">
        <p>${said.value.sentence}</p>
        ${said.value.mend ? html`<p class="mend">${said.value.mend}</p>` : null}
      </section>
      <section aria-label="The camera in the stage"><${Facts} /></section>
      <${Stage} />
      <${Objects} />
      <${Happened} />
    </div>
    <${Strip} />
  </main>`;
}
