// A button that takes a file.
import { useState } from "../vendor/hooks.js";
import { barred } from "../access.js";
import { reason } from "../ask.js";
import { html } from "../ui.js";

/**
 * `take` gets the file; what it throws is said.
 * @param {{label: string, accept: string, take: (file: File) => Promise<unknown>, isFirst?:
 *   boolean}} props
 */
export function ChooseFile({ label, accept, take, isFirst = false }) {
  const [said, setSaid] = useState("");
  const chosen = async (/** @type {Event} */ event) => {
    const input = /** @type {HTMLInputElement} */ (event.target);
    const [file] = input.files ?? [];
    if (!file) return;
    setSaid(`Sending ${file.name} …`);
    setSaid(await take(file).then(() => "", reason));
    // The same file may be chosen again after it was changed.
    input.value = "";
  };
  return html`<div class="row">
      <label class="button">${label}<input type="file" accept=${accept} data-first=${isFirst ? "" : null} disabled=${barred.value !== null} onChange=${chosen} /></label>
    </div>
    <p class=${said.startsWith("Sending ") ? "" : "refused"} role="status">${said}</p>`;
}
