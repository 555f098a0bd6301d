// The Health view: one card per part with a sentence and a hint, what the outputs send, the log,
// diagnostics and backup.
import { effect, signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { session } from "./access.js";
import { ask, read, reason, sentence } from "./ask.js";
import { Backup } from "./backup.js";
import { ClockToFilm } from "./clock.js";
import { contact } from "./daemon.js";
import { html } from "./ui.js";

/** Milliseconds between two looks, while the view is seen. */
const LOOKS_EVERY = 1000;
/** Lines of the log. */
const LINES = 200;

/**
 * The levels' words and their marks within a square of 16: they differ by shape, not only by
 * colour.
 */
const LEVELS = {
  good: { word: "Good", shape: "M6.300 13.400L1.200 8.300 2.700 6.800 6.300 10.400 13.300 3.400 14.800 4.900z" },
  warn: { word: "Check", shape: "M8 1l7.500 14H.5z" },
  bad: { word: "Bad", shape: "M2.400 1L8 6.600 13.600 1 15 2.400 9.400 8 15 13.600 13.600 15 8 9.400 2.400 15 1 13.600 6.600 8 1 2.400z" },
  off: { word: "Off", shape: "M2 7h12v2H2z" },
};

/** @import { Output, Part } from "./types.js" */

const parts = signal(/** @type {Part[] | null} */ (null));
const outputs = signal(/** @type {Output[]} */ ([]));
/** Why nothing new is known; empty while it is. */
const fault = signal("");
const log = signal(/** @type {string | null} */ (null));
const said = signal("");

async function look() {
  if (document.hidden) return;
  try {
    const [health, sent] = await Promise.all([read("health"), read("outputs")]);
    parts.value = health.parts;
    outputs.value = sent.outputs;
    fault.value = "";
  } catch (why) {
    fault.value = reason(why);
  }
}

async function readLog() {
  if (session.peek()?.needs_pairing) {
    log.value = "This browser is not paired. Pair it to read the log.";
    return;
  }
  // Which module says it is for programmers: the file has it.
  log.value = await ask(`log?lines=${LINES}`).then(async (answer) => (await answer.text()).replace(/ stagepose(::\w+)+:/g, ""), reason);
}

/** @param {Part} props */
function Card({ part, level, sentence: words, mend }) {
  const { word, shape } = LEVELS[level] ?? { word: level, shape: LEVELS.off.shape };
  return html`<li class="card ${level}">
    <h3>${part[0].toUpperCase()}${part.slice(1)}</h3>
    <span class="level"><svg viewBox="0 0 16 16" aria-hidden="true"><path d=${shape} /></svg>${word}</span>
    <p>${sentence(words)}</p>
    ${mend ? html`<p class="mend">${sentence(mend)}</p>` : null}
  </li>`;
}

/** What a decoded packet says, as lines: a text with fields, or an object. @param {unknown} last */
function decoded(last) {
  return typeof last === "string" ? last.replace(/ \{ /g, " {\n  ").replace(/, (?=[a-z_]+:)/g, ",\n  ").replace(/ \}$/, "\n}") : JSON.stringify(last, null, 1);
}

/** @param {Output} props */
function Sent({ name, protocol, sent, failed, withheld, dropped, per_s, latency_us, last, last_hex }) {
  const counts = [`${sent} sent`, per_s === null ? null : `${per_s.toFixed(1)} a second`, failed ? `${failed} failed` : null, withheld ? `${withheld} withheld` : null, dropped ? `${dropped} dropped` : null];
  const part = parts.value?.find((one) => one.part === `output ${name}`);
  const late = sent === 0 ? "" : `, ${(latency_us / 1000).toFixed(2)} ms after the pose`;
  return html`<li class="card ${part?.level ?? ""}">
    <h3>${name}</h3>
    <span class="level">${protocol}</span>
    <p>${counts.filter(Boolean).join(", ")}${late}.</p>
    ${part && part.level !== "good" ? html`<p class="mend">${[part.sentence, part.mend ?? ""].filter(Boolean).map(sentence).join(" ")}</p>` : null}
    ${last === null && !last_hex
      ? html`<p class="mend">Nothing has been sent yet.</p>`
      : html`<details>
          <summary>Last packet</summary>
          ${last === null ? null : html`<pre tabindex="0">${decoded(last)}</pre>`}
          ${last_hex ? html`<pre tabindex="0" class="hex">${last_hex}</pre>` : null}
        </details>`}
  </li>`;
}

/**
 * Copies text to the clipboard, also for pages from another machine, which have no clipboard.
 * @param {string} text
 * @param {HTMLTextAreaElement} field
 */
async function copy(text, field) {
  field.value = text;
  field.hidden = false;
  field.select();
  const isCopied = await (navigator.clipboard?.writeText(text).then(() => true, () => false) ?? Promise.resolve(document.execCommand("copy")));
  said.value = isCopied ? "Copied." : "This browser does not allow copying here. Press Ctrl+C to copy the selected text.";
  if (isCopied) field.hidden = true;
}

function Diagnostics() {
  const field = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  const diagnose = async () => {
    try {
      const text = await (await ask("diagnostics")).text();
      if (field.current) await copy(text, field.current);
    } catch (why) {
      said.value = reason(why);
    }
  };
  return html`<section aria-labelledby="diagnostics">
    <h2 id="diagnostics">Diagnostics</h2>
    <p class="note">This page as text, with all numbers and the log, to send to support.</p>
    <div class="row"><button type="button" onClick=${diagnose}>Copy diagnostics</button></div>
    <p role="status">${said.value}</p>
    <textarea ref=${field} hidden readonly rows="8" aria-label="Diagnostics"></textarea>
  </section>`;
}

function Log() {
  return html`<section class="wide" aria-labelledby="log">
    <h2 id="log">Log</h2>
    <div class="row"><button type="button" onClick=${readLog}>Refresh</button></div>
    <pre class="log" tabindex="0">${log.value === null ? "Loading." : log.value || "Nothing has been logged. [log] level in the config sets what is logged."}</pre>
  </section>`;
}

/** The view. */
export function Health() {
  useEffect(() => {
    void readLog();
    const timer = setInterval(look, LOOKS_EVERY);
    // At once, and where the daemon comes back.
    const stop = effect(() => {
      void contact.value;
      void look();
    });
    return () => {
      clearInterval(timer);
      stop();
    };
  }, []);
  const isOld = contact.value === false;
  // What is said of an output stands with what it sent.
  const own = parts.value?.filter(({ part }) => !outputs.value.some(({ name }) => part === `output ${name}`)) ?? null;
  return html`<main class=${isOld ? "health silent" : "health"}>
    <link rel="stylesheet" href="./views.css" />
    <section class="wide" aria-labelledby="parts">
      <h2 id="parts">Parts</h2>
      ${isOld ? html`<p role="alert">stagepose does not answer. Check that it runs.${parts.value ? " Below is its last report." : ""}</p>` : html`<p role="status">${fault.value}</p>`}
      ${own === null ? (isOld || fault.value ? null : html`<p>Loading.</p>`) : html`<ul class="cards">${own.map((part, k) => html`<${Card} key=${`${k} ${part.part}`} ...${part} />`)}</ul>`}
    </section>
    <section class="wide" aria-labelledby="outputs">
      <h2 id="outputs">Outputs</h2>
      ${outputs.value.length > 0
        ? html`<ul class="cards outputs">${outputs.value.map((output) => html`<${Sent} key=${output.name} ...${output} />`)}</ul>`
        : html`<p>${parts.value === null ? "" : "The config has no [[output]]: only this page shows the poses."}</p>`}
    </section>
    <${Diagnostics} />
    <${Backup} />
    <${ClockToFilm} />
    <${Log} />
  </main>`;
}
