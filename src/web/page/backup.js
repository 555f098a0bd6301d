// Backup and restore: what a restore would change is said before it is done.
import { signal } from "./vendor/signals.js";
import { Barred, Change, Download } from "./access.js";
import { Refused, ask, content, post, reason, sentence } from "./ask.js";
import { html } from "./ui.js";
import { differing, entries, textOf } from "./zip.js";

/** The config's name in a backup. */
const CONFIG = "stage.toml";
/** Changed lines that are shown. */
const SHOWN = 40;

/** @import { Finding } from "./types.js" */
/**
 * @typedef {{file: File, replaces: string[], adds: string[], findings: Finding[], goes: string[],
 *   comes: string[], isKnown: boolean}} Plan what a restore would do; `isKnown`: the current config
 *   could be read
 */

const plan = signal(/** @type {Plan | null} */ (null));
const said = signal("");

/** @param {Event} event */
async function choose(event) {
  const input = /** @type {HTMLInputElement} */ (event.target);
  const [file] = input.files ?? [];
  if (!file) return;
  plan.value = null;
  said.value = "";
  try {
    const found = await entries(file);
    const config = found.find(({ name }) => name === CONFIG);
    if (config === undefined) throw new Error(`${file.name} has no ${CONFIG}, so it is not a backup. Choose a backup from this page.`);
    // The daemon tries it: what it would refuse is not offered.
    /** @type {Pick<Plan, "replaces" | "adds" | "findings">} */
    const { replaces, adds, findings } = await content(await post("restore?try=1", new Blob([file], { type: "application/zip" })));
    const [now, then] = await Promise.all([ask("config").then((answer) => answer.text(), () => null), textOf(file, config)]);
    plan.value = { file, replaces, adds, findings, ...differing(now ?? "", then), isKnown: now !== null };
  } catch (why) {
    said.value = why instanceof Refused && why.status === 422 ? `${file.name} cannot be restored. Nothing was changed. ${reason(why)}` : reason(why);
  }
  input.value = "";
}

/** @param {Plan} of */
async function restore({ file }) {
  try {
    /** @type {{findings?: Finding[]}} */
    const { findings = [] } = await content(await post("restore", new Blob([file], { type: "application/zip" })));
    said.value = [`${file.name} is restored, and the config was reloaded.`, ...findings.map((found) => sentence(found.sentence))].join(" ");
    plan.value = null;
  } catch (why) {
    said.value = reason(why);
  }
}

/** What would be done, and whether it shall. @param {{of: Plan}} props */
function Planned({ of }) {
  const { file, replaces, adds, findings, goes, comes, isKnown } = of;
  const others = replaces.filter((name) => name !== CONFIG);
  const lines = [...goes.map((line) => `− ${line}`), ...comes.map((line) => `+ ${line}`)];
  return html`<div class="planned">
    <p>
      Restoring ${file.name} replaces the config${others.length > 0 ? ` and ${others.join(", ")}` : ""}${adds.length > 0 ? `, and adds ${adds.join(", ")}` : ""}. The previous files are kept in “former” beside the config.
      ${!isKnown ? " The current config cannot be read, so its changes cannot be shown." : lines.length === 0 ? " The config does not change." : " Changes in the config:"}
    </p>
    ${isKnown && lines.length > 0 ? html`<pre tabindex="0">${lines.slice(0, SHOWN).join("\n")}${lines.length > SHOWN ? `\n… and ${lines.length - SHOWN} more lines` : ""}</pre>` : null}
    ${findings.length > 0 ? html`<ul class="findings">${findings.map((one, k) => html`<li key=${k}>${[one.sentence, one.mend].filter(Boolean).map((words) => sentence(`${words}`)).join(" ")}</li>`)}</ul>` : null}
    <div class="row">
      <${Change} act=${() => restore(of)}>Restore<//>
      <button type="button" onClick=${() => (plan.value = null)}>Cancel</button>
    </div>
  </div>`;
}

/** Both. */
export function Backup() {
  return html`<section aria-labelledby="backup">
    <h2 id="backup">Backup</h2>
    <p class="note">The config, every file it names, and the set, as one zip.</p>
    <${Barred} />
    <div class="row">
      <${Download} path="backup">Download backup<//>
      <label class="button">Restore …<input type="file" accept=".zip,application/zip" onChange=${choose} /></label>
    </div>
    ${plan.value ? html`<${Planned} of=${plan.value} />` : null}
    <p role="status">${said.value}</p>
  </section>`;
}
