// The Health view: one card a part with a sentence and what to do, what the outputs send, the log.
import { signal } from "./vendor/signals.js";
import { useEffect, useRef } from "./vendor/hooks.js";
import { ask, post, read } from "./ask.js";
import { contact } from "./daemon.js";
import { html } from "./ui.js";

/** Milliseconds between two looks, while the view is seen. */
const LOOKS_EVERY = 1000;
const LINES = 200;
const LEVELS = { good: "Good", warn: "Look at it", bad: "Bad", off: "Off" };

/** @typedef {{part: string, level: keyof typeof LEVELS, sentence: string, mend: string | null}} Part
 * @typedef {{name: string, protocol: string, sent: number, failed: number, withheld: number, dropped: number, latency_us: number | null, per_s: number,
 *   last: any, last_hex: string | null}} Output */

const parts = signal(/** @type {Part[] | null} */ (null));
const outputs = signal(/** @type {Output[]} */ ([]));
const log = signal("");
const said = signal("");

async function look() {
  if (document.hidden) return;
  try {
    const [health, sent] = await Promise.all([read("health"), read("outputs")]);
    parts.value = health.parts;
    outputs.value = sent.outputs;
  } catch (why) {
    said.value = why instanceof Error ? why.message : `${why}`;
  }
}

async function readLog() {
  log.value = await ask(`log?lines=${LINES}`).then((answer) => answer.text(), (why) => why.message);
}

/** @param {Part} part */
function Card({ part, level, sentence, mend }) {
  return html`<li class="card ${level}"><h3>${part} <span>${LEVELS[level] ?? level}</span></h3>
    <p>${sentence}</p>
    ${mend ? html`<p class="mend">${mend}</p>` : null}
  </li>`;
}

/** @param {Output} output */
function Sent({ name, protocol, sent, failed, withheld, dropped, per_s, latency_us, last, last_hex }) {
  const counts = [`${sent} sent`, `${per_s.toFixed(1)}/s`, ...(failed ? [`${failed} failed`] : []), ...(withheld ? [`${withheld} withheld`] : []), ...(dropped ? [`${dropped} dropped`] : [])];
  return html`<li class="card"><h3>${name} <span>${protocol}</span></h3>
    <p>${counts.join(", ")}${latency_us === null ? "" : `, ${(latency_us / 1000).toFixed(2)} ms after the pose`}</p>
    ${last === null ? html`<p class="mend">Nothing has been sent yet.</p>` : html`<details><summary>Last packet</summary><pre tabindex="0">${JSON.stringify(last, null, 1)}</pre>${last_hex ? html`<pre tabindex="0">${last_hex}</pre>` : null}</details>`}
  </li>`;
}

/** Text into the clipboard, also where a page from another machine has none. @param {string} text @param {HTMLTextAreaElement} field */
async function copy(text, field) {
  field.value = text;
  field.hidden = false;
  field.select();
  const isCopied = await (navigator.clipboard?.writeText(text).then(() => true, () => false) ?? Promise.resolve(document.execCommand("copy")));
  said.value = isCopied ? "Copied." : "Copy the selected text with Ctrl and C.";
  if (isCopied) field.hidden = true;
}

function Diagnostics() {
  const field = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  const diagnose = async () => {
    try {
      const text = await (await ask("diagnostics")).text();
      if (field.current) await copy(text, field.current);
    } catch (why) {
      said.value = why instanceof Error ? why.message : `${why}`;
    }
  };
  const restore = async (/** @type {any} */ event) => {
    const [file] = event.target.files;
    if (!file) return;
    try {
      const { findings } = await (await post("restore", new Blob([file], { type: "application/zip" }))).json();
      said.value = [`${file.name} is in place.`, ...findings.map((/** @type {any} */ { sentence }) => sentence)].join(" ");
    } catch (why) {
      said.value = why instanceof Error ? why.message : `${why}`;
    }
    event.target.value = "";
  };
  return html`<section aria-label="Diagnostics and backup">
    <div class="row">
      <button type="button" onClick=${diagnose}>Copy diagnostics</button>
      <a class="button" href="./api/v1/backup" download>Backup</a>
      <label class="button">Restore …<input type="file" accept=".zip" onChange=${restore} /></label>
    </div>
    <p role="status">${said.value}</p>
    <textarea ref=${field} hidden readonly rows="8" aria-label="Diagnostics"></textarea>
  </section>`;
}

/** The view. */
export function Health() {
  useEffect(() => {
    look();
    readLog();
    const timer = setInterval(look, LOOKS_EVERY);
    return () => clearInterval(timer);
  }, []);
  return html`<main class=${contact.value === false ? "silent plain" : "plain"}>
    <section aria-labelledby="parts"><h2 id="parts">Parts</h2>
      ${parts.value === null ? html`<p>Asking.</p>` : html`<ul class="cards">${parts.value.map((part) => html`<${Card} key=${part.part} ...${part} />`)}</ul>`}
    </section>
    ${outputs.value.length > 0
      ? html`<section aria-labelledby="outputs"><h2 id="outputs">Outputs</h2><ul class="cards">${outputs.value.map((output) => html`<${Sent} key=${output.name} ...${output} />`)}</ul></section>`
      : null}
    <${Diagnostics} />
    <section aria-labelledby="log"><h2 id="log">Log</h2>
      <div class="row"><button type="button" onClick=${readLog}>Read anew</button></div>
      <pre class="log" tabindex="0">${log.value || "Nothing has been logged."}</pre>
    </section>
  </main>`;
}
