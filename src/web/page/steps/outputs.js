// Step 7: who gets the poses.
import { html, typed } from "../ui.js";
import { change, draft } from "./draft.js";
import { Sheet } from "./sheet.js";

/** Protocols, with who takes them. */
const KINDS = [
  { kind: "freed", title: "FreeD: Unreal, disguise, Pixotope, Aximmetry" },
  { kind: "opentrackio", title: "OpenTrackIO: Unreal 5.6 and later" },
  { kind: "psn", title: "PosiStageNet: lighting desks" },
  { kind: "osc", title: "OSC: TouchDesigner, QLab, Max" },
];

/** What an address of a receiver is like. */
const ADDRESS = /^[^\s:]+:\d{1,5}$|^\[[0-9a-fA-F:]+\]:\d{1,5}$/;

function add() {
  const { outputs, kind, to } = draft.peek();
  if (ADDRESS.test(to.trim())) change({ outputs: [...outputs, { kind, to: to.trim() }], to: "" });
}

export function Outputs() {
  const { outputs, kind, to } = draft.value;
  const isAddress = ADDRESS.test(to.trim());
  return html`${outputs.length === 0 ? html`<p>Only this page gets the poses. Add those who need them, or leave it for later.</p>` : null}
    <ul class="list wanted">
      ${outputs.map((output, k) => html`<li key=${k}><b>${output.kind}</b> to ${output.to} <button type="button" class="quiet danger" onClick=${() => change({ outputs: outputs.filter((_, at) => at !== k) })}>Remove</button></li>`)}
    </ul>
    <label class="field wide">
      <span>Protocol</span>
      <select value=${kind} onChange=${(/** @type {Event} */ event) => change({ kind: typed(event) })}>
        ${KINDS.map((one) => html`<option key=${one.kind} value=${one.kind}>${one.title}</option>`)}
      </select>
    </label>
    <label class="field wide">
      <span>Address and port of the receiver</span>
      <input data-first placeholder="192.168.1.20:40000" value=${to} aria-invalid=${to !== "" && !isAddress ? "true" : "false"} onInput=${(/** @type {Event} */ event) => change({ to: typed(event) })} />
    </label>
    <div class="row"><button type="button" disabled=${!isAddress} onClick=${add}>Add</button></div>
    <${Sheet} />`;
}
