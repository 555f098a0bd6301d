// The whole set-up on a sheet of paper, for the folder at the desk; and as one file.
import { session } from "../access.js";
import { Backup } from "../backup.js";
import { html } from "../ui.js";
import { config, nameOf, picture } from "./config.js";
import { draft } from "./draft.js";
import { placed } from "./placing.js";
import { size } from "./sides.js";

const date = new Intl.DateTimeFormat(undefined, { dateStyle: "long", timeStyle: "short", hourCycle: "h23" });

/** A length, metres. @param {number | null} value */
const metres = (value) => (value === null ? "–" : `${value.toFixed(3)} m`);

/** How the lens is known, in words. */
function lens() {
  const { lens: kind, fov, calibration } = draft.value;
  if (kind === "guess") return `guessed: ${fov} degrees across`;
  return kind === "config" ? "as the config has it" : (calibration?.name ?? "–");
}

/** What is on paper only. */
function Paper() {
  const of = draft.value;
  const rows = [
    ["Config", session.value?.config_file ?? "–"],
    ["Camera", of.device ?? "a played clip"],
    ["Locked", of.controls === null ? "nothing" : Object.entries(of.controls).map(([name, value]) => `${name} = ${value}`).join(", ")],
    ["Lens", lens()],
    ...of.surfaces.map((one, k) => [nameOf(k), `${picture(one)?.name ?? "–"}, ${size(of, k).map(metres).join(" x ")}`]),
    ["Origin", (placed(of) ?? []).map(({ name, at }) => `${name} at ${at.map((value) => value.toFixed(3)).join(", ")} m`).join("; ")],
    ["Outputs", of.outputs.length === 0 ? "this page only" : of.outputs.map(({ kind, to }) => `${kind} to ${to}`).join("; ")],
  ];
  return html`<section class="sheet" aria-hidden="true">
    <h2>stagepose set-up, ${date.format(Date.now())}</h2>
    <table><tbody>${rows.map(([name, value]) => html`<tr key=${name}><th scope="row">${name}</th><td>${value}</td></tr>`)}</tbody></table>
    <pre>${config.value ?? ""}</pre>
  </section>`;
}

export function Sheet() {
  return html`<details>
      <summary>On paper, and as one file</summary>
      <div class="row"><button type="button" onClick=${() => print()}>Print the set-up</button></div>
      <${Backup} />
    </details>
    <${Paper} />`;
}
