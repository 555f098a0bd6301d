// Fields for numbers: what is typed stays as typed while it is typed, and takes effect as soon as it is a number.
import { useState } from "./vendor/hooks.js";
import { html } from "./ui.js";

/** @param {{label: string, value: number, unit: string, step?: number, least?: number, onValue: (value: number) => void}} props */
export function NumberField({ label, value, unit, step = 0.1, least = -Infinity, onValue }) {
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  const number = typed === null ? value : Number(typed.replace(",", "."));
  const isWrong = typed !== null && (typed.trim() === "" || !Number.isFinite(number) || number < least);
  const take = (/** @type {string} */ text) => {
    setTyped(text);
    const read = Number(text.replace(",", "."));
    if (text.trim() !== "" && Number.isFinite(read) && read >= least) onValue(read);
  };
  return html`<label class="field">
    <span>${label}</span>
    <input
      type="text"
      inputmode="decimal"
      value=${typed ?? `${Number(value.toFixed(4))}`}
      aria-invalid=${isWrong ? "true" : "false"}
      onInput=${(/** @type {any} */ event) => take(event.target.value)}
      onBlur=${() => !isWrong && setTyped(null)}
      onKeyDown=${(/** @type {KeyboardEvent} */ event) => {
        const by = { ArrowUp: step, ArrowDown: -step }[event.key];
        if (by === undefined) return;
        event.preventDefault();
        take(`${Number(Math.max(least, value + by * (event.shiftKey ? 10 : event.altKey ? 0.1 : 1)).toFixed(4))}`);
      }}
    />
    <span class="unit">${unit}</span>
  </label>`;
}
