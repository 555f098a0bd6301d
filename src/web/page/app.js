// The page: its bar, its view, its keys.
import { render } from "./vendor/preact.js";
// Signals take part in rendering as soon as they are loaded.
import "./vendor/signals.js";
import { listen } from "./daemon.js";
import { Live } from "./live.js";
import { THEMES, theme, toggleStage } from "./theme.js";
import { html } from "./ui.js";

function Bar() {
  return html`<header>
    <h1>stagepose</h1>
    <fieldset class="choice">
      <legend>Colours</legend>
      ${THEMES.map(
        (name) => html`<label key=${name}>
          <input type="radio" name="theme" value=${name} checked=${theme.value === name} onChange=${() => (theme.value = name)} />
          <span>${name}</span>
        </label>`,
      )}
    </fieldset>
  </header>`;
}

function Page() {
  return html`<${Bar} /><${Live} />
    <footer>Keys: <kbd>n</kbd> stage colours on and off. <a href="./vendor/LICENSES.txt">Licences</a></footer>`;
}

/** What single keys do, where nothing is typed into. */
const KEYS = { n: toggleStage };

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const act = KEYS[/** @type {keyof typeof KEYS} */ (event.key)];
  if (act) {
    event.preventDefault();
    act();
  }
});

const place = document.getElementById("page");
if (place) {
  place.replaceChildren();
  render(html`<${Page} />`, place);
}
listen();
