// Fields for numbers. Typed text is not changed while it is typed, and takes effect as soon as it
// is a number.
import { useState } from "./vendor/hooks.js";
import { html, typed } from "./ui.js";

/**
 * @param {{label: string, value: number, unit: string, step?: number, least?: number, onValue:
 *   (value: number) => void}} props
 */
export function NumberField({ label, value, unit, step = 0.1, least = -Infinity, onValue }) {
  const [text, setText] = useState(/** @type {string | null} */ (null));
  const number = text === null ? value : Number(text.replace(",", "."));
  const isWrong = text !== null && (text.trim() === "" || !Number.isFinite(number) || number < least);
  const take = (/** @type {string} */ next) => {
    setText(next);
    const read = Number(next.replace(",", "."));
    if (next.trim() !== "" && Number.isFinite(read) && read >= least) onValue(read);
  };
  return html`<label class="field">
    <span>${label}</span>
    <input
      type="text"
      inputmode="decimal"
      value=${text ?? `${Number(value.toFixed(4))}`}
      aria-invalid=${isWrong ? "true" : "false"}
      onInput=${(/** @type {Event} */ event) => take(typed(event))}
      onBlur=${() => !isWrong && setText(null)}
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
