// The Recordings view: the recordings, the timeline and the player of one; starting, stopping and
// marking a recording.
import { computed, effect, signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { Barred, Change, Download } from "./access.js";
import { post, read, reason, sentence } from "./ask.js";
import { clip, close, fault, go, goToLoss, isLost, noLoss, open, painters, playing, retracked, row, shown, speed, togglePlaying, whose } from "./clip.js";
import { contact } from "./daemon.js";
import { draft } from "./drafts.js";
import { happened } from "./events.js";
import { viewKeys } from "./pages.js";
import { drawMarks, drawPicture, outlined } from "./picture.js";
import { Retracking, Today, goToDifference, swap } from "./retracked.js";
import { theme } from "./theme.js";
import { Timeline, clock, secondsOf } from "./timeline.js";
import { StateMark, amount, html, typed } from "./ui.js";

/**
 * Milliseconds between two requests of the list; it is also requested when a recording starts or
 * stops.
 */
const LOOKS_EVERY = 10_000;
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
/** Letters of a mark, as the daemon takes them. */
const LONGEST_MARK = 200;

const list = signal(/** @type {import("./types.js").RecordingList | null} */ (null));
/** Why there is no list. */
const listFault = signal("");
/** What became of the last wish. */
const said = signal("");
const mark = draft("mark");

async function look() {
  if (document.hidden) return;
  try {
    list.value = await read("recordings");
    listFault.value = "";
  } catch (why) {
    listFault.value = reason(why);
  }
}

/** @param {string} path @param {string} done @param {unknown} [sent] */
async function wish(path, done, sent) {
  said.value = "";
  try {
    await post(path, sent);
    said.value = done;
    return true;
  } catch (why) {
    said.value = reason(why);
    return false;
  } finally {
    void look();
  }
}

/** @param {Event} event */
async function addMark(event) {
  event.preventDefault();
  // What was typed stays where it was not taken.
  if (await wish("recordings/mark", "Marked.", { text: mark.value })) mark.value = "";
}

const date = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "medium", hourCycle: "h23" });

/** Where the picture is drawn. */
function Picture() {
  const below = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const above = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const again = () => {
    const now = shown.peek();
    if (above.current && now?.size) drawMarks(above.current, { record: chosen(now), size: now.size });
    else above.current?.getContext("2d")?.reset();
  };
  useEffect(() => {
    const paint = (/** @type {ImageBitmap | null} */ picture, /** @type {import("./clip.js").Shown} */ of) => {
      if (!below.current || !above.current) return;
      if (picture !== null) drawPicture(below.current, picture);
      else below.current.getContext("2d", { alpha: false })?.reset();
      if (of.size !== null) drawMarks(above.current, { record: chosen(of), size: of.size });
      else above.current.getContext("2d")?.reset();
    };
    const sized = new ResizeObserver(again);
    if (above.current) sized.observe(above.current);
    painters.add(paint);
    return () => {
      painters.delete(paint);
      sized.disconnect();
    };
  }, []);
  useEffect(again, [theme.value, outlined.value, whose.value, shown.value?.today]);
  const caption = fault.value || noLoss.value;
  return html`<figure class="picture" style=${{ aspectRatio: aspect.value, maxWidth: `calc((100vh - 22rem) * ${aspect.value})` }}>
    <canvas ref=${below} role="img" aria-label="The recorded picture" />
    <canvas ref=${above} class="marks ${outlined.value ? "" : "off"}" aria-hidden="true" />
    ${caption ? html`<figcaption role="status">${caption}</figcaption>` : null}
  </figure>`;
}

/** The record whose outlines are drawn. @param {import("./clip.js").Shown} of */
function chosen({ record, today }) {
  return whose.peek() === "today" ? today : record;
}

/** Width over height of the pictures; that of the last one, where a row has none. */
const aspect = computed(() => {
  const now = shown.value?.size;
  if (now) lastAspect = now[0] / now[1];
  return lastAspect;
});
let lastAspect = 16 / 9;

const time = computed(() => (clip.value === null ? "–" : `${clock(secondsOf(clip.value, row.value))} of ${clock(secondsOf(clip.value, Math.max(0, clip.value.frames - 1)))}`));
const place = computed(() => (clip.value === null ? "–" : `${row.value + 1} of ${clip.value.frames}`));
const fits = computed(() => amount(shown.value?.record?.rms_px, 2, "px"));
const state = computed(() => shown.value?.record?.state ?? null);
const todayFits = computed(() => amount(shown.value?.today?.rms_px, 2, "px"));
const todayState = computed(() => shown.value?.today?.state ?? null);
/** How far apart the two place the camera. */
const apart = computed(() => {
  const [a, b] = [shown.value?.record?.pose, shown.value?.today?.pose];
  return amount(a && b ? 1000 * Math.hypot(...a.position_m.map((value, axis) => value - b.position_m[axis])) : null, 2, "mm");
});

/** What there is to be said where no recording is open. */
function nothing() {
  if (list.value === null) return listFault.value || "Loading the list of recordings.";
  if (list.value.recordings.length > 0) return "Choose a recording to see it.";
  return `There are no recordings yet. Press Record, or save the last seconds. They are stored in ${list.value.folder}.`;
}

function Player() {
  const of = clip.value;
  if (of === null) return html`<p role="status">${fault.value || nothing()}</p>`;
  const losses = of.columns.filter((column, k) => isLost(column) && (k === 0 || !isLost(of.columns[k - 1]))).length;
  return html`<div class="player">
    <${Picture} />
    <${Timeline} of=${of} />
    <${Today} />
    <div class="row">
      <button type="button" onClick=${() => goToLoss(-1)} disabled=${losses === 0}>Previous loss</button>
      <button type="button" onClick=${togglePlaying} aria-pressed=${playing.value ? "true" : "false"}>${playing.value ? "Stop" : "Play"}</button>
      <button type="button" onClick=${() => goToLoss(1)} disabled=${losses === 0}>Next loss</button>
      <button type="button" onClick=${() => go(row.value - 1)}>−1 row</button>
      <button type="button" onClick=${() => go(row.value + 1)}>+1 row</button>
      <label class="field speed"><span>Speed</span>
        <select value=${`${speed.value}`} onChange=${(/** @type {Event} */ event) => (speed.value = Number(typed(event)))}>
          ${SPEEDS.map((one) => html`<option key=${one} value=${`${one}`} selected=${one === speed.value}>${one} ×</option>`)}
        </select>
      </label>
    </div>
    <dl class="facts">
      <div><dt>Time</dt><dd>${time}</dd></div>
      <div><dt>Row</dt><dd>${place}</dd></div>
      <div><dt>State</dt><dd>${state.value === null ? "–" : html`<${StateMark} state=${state.value} />`}</dd></div>
      <div><dt>Residual</dt><dd>${fits}</dd></div>
      ${retracked.value === null
        ? null
        : html`<div><dt>State, today</dt><dd>${todayState.value === null ? "–" : html`<${StateMark} state=${todayState.value} />`}</dd></div>
            <div><dt>Residual, today</dt><dd>${todayFits}</dd></div>
            <div><dt>Distance</dt><dd>${apart}</dd></div>`}
    </dl>
    <p class="note">${losses === 0 ? "The stage was never lost." : `The stage was lost ${losses === 1 ? "once" : `${losses} times`}.`} Outlines show today's stage and lens.</p>
  </div>`;
}

function Recorder() {
  const now = list.value;
  const isOn = now?.recording != null;
  return html`<section class="recorder" aria-labelledby="recorder">
    <h2 id="recorder">Recorder</h2>
    <p>${now === null ? "Loading." : isOn ? `Recording ${now.recording}.` : "Not recording."}</p>
    <${Barred} />
    <div class="row">
      ${isOn
        ? html`<${Change} act=${() => wish("recordings/stop", "Recording stopped.")}>Stop recording<//>`
        : html`<${Change} off=${now === null} act=${() => wish("recordings/start", "Recording started.")}>Record<//>`}
      <${Change} off=${!now?.ring_s} act=${() => wish("ring/save", `The last ${now?.ring_s} s are being saved.`)}>Save the last ${now?.ring_s ? `${now.ring_s} s` : "seconds"}<//>
    </div>
    ${now !== null && !now.ring_s ? html`<p class="note">The last seconds are not kept. Set [recorder] ring_s in the config to keep them.</p>` : null}
    <form class="row" onSubmit=${addMark}>
      <label class="field wide"><span>Mark this moment</span><input maxlength=${LONGEST_MARK} value=${mark.value} placeholder="cue 12" onInput=${(/** @type {Event} */ event) => (mark.value = typed(event))} /></label>
      <${Change} act=${addMark}>Mark<//>
    </form>
    <p role="status" class="note">${said.value}</p>
  </section>`;
}

function Choice() {
  const now = list.value;
  if (now === null || now.recordings.length === 0) return null;
  return html`<section aria-labelledby="recordings">
    <h2 id="recordings">Recordings</h2>
    <ul class="recordings">
      ${now.recordings.map(
        (one) => html`<li key=${one.id}>
          <button type="button" aria-pressed=${clip.value?.id === one.id ? "true" : "false"} onClick=${() => open(one.id)}>
            ${date.format(one.begun_unix_ms)}<br /><small>${clock(one.seconds)}, ${one.frames} rows${one.open ? ", still recording" : ""}</small>
          </button>
          <${Download} path=${`recordings/${one.id}/download`} name=${`Download ${one.id}`}>Download<//>
        </li>`,
      )}
    </ul>
  </section>`;
}

/** Seconds of pictures in a report, as the command has it. */
const PICTURES_S = 30;

/** The open recording for whoever helps. */
function Bundle() {
  const of = clip.value;
  if (of === null) return null;
  return html`<section aria-labelledby="bundle">
    <h2 id="bundle">Fault report</h2>
    <p class="note">Records, events, config, diagnostics and log as one zip, like “stagepose report”. Pictures show the people on stage.</p>
    <div class="row">
      <${Download} path=${`recordings/${of.id}/report`}>Without pictures<//>
      <${Download} path=${`recordings/${of.id}/report?pictures=${PICTURES_S}`}>With the last ${PICTURES_S} s of pictures<//>
    </div>
  </section>`;
}

/** What happened in the open recording; each leads to its row. */
function Events() {
  const of = clip.value;
  if (of === null || of.events.length === 0) return null;
  return html`<section class="happened" aria-labelledby="inside">
    <h2 id="inside">Events</h2>
    <ol>
      ${of.events.map(
        (one, k) => html`<li key=${k} class=${one.level}><button type="button" class="plain" onClick=${() => go(one.row)}><time>${clock(secondsOf(of, one.row))}</time> ${sentence(one.says)}</button></li>`,
      )}
    </ol>
  </section>`;
}

/** Keys of this view. */
const KEYS = [
  { key: " ", name: "Space, k", does: "play or stop", act: togglePlaying },
  { key: "k", name: "", does: "", act: togglePlaying },
  { key: "j", name: "j", does: "previous loss", act: () => goToLoss(-1) },
  { key: "l", name: "l", does: "next loss", act: () => goToLoss(1) },
  { key: ",", name: ",", does: "one row back", act: () => go(row.value - 1) },
  { key: "b", name: "b", does: "outlines: recorded or today's config", act: swap },
  { key: "d", name: "d", does: "next difference", act: goToDifference },
  { key: ".", name: ".", does: "one row forward", act: () => go(row.value + 1) },
];

/** The view. */
export function Recordings() {
  useEffect(() => {
    viewKeys.value = KEYS;
    const timer = setInterval(look, LOOKS_EVERY);
    const stop = effect(() => {
      // Where a recording begins or ends, and where the daemon comes back.
      void [happened.value[0], contact.value];
      void look();
    });
    return () => {
      clearInterval(timer);
      stop();
      viewKeys.value = [];
      close();
    };
  }, []);
  return html`<main class=${contact.value === false ? "silent" : ""}>
    <link rel="stylesheet" href="./views.css" />
    <section aria-label="The open recording"><${Player} /></section>
    <div class="beside">
      <${Recorder} />
      <${Choice} />
      <${Retracking} />
      <${Bundle} />
      <${Events} />
    </div>
  </main>`;
}
