// The page: its bar, its view, its keys.
import { render } from "./vendor/preact.js";
// Signals take part in rendering as soon as they are loaded.
import { effect, signal } from "./vendor/signals.js";
import { ConfigFault, Lock, Pairing, barred, session, unturned, watchAccess } from "./access.js";
import { post, reason } from "./ask.js";
import { frozen, listen, toggleFrozen } from "./daemon.js";
import { listenToEvents } from "./events.js";
import { Live, State } from "./live.js";
import { PAGES, show, shown, viewKeys } from "./pages.js";
import { Recording, watchRecording } from "./recorded.js";
import { floored, outlined, parted, rested } from "./picture.js";
import { THEMES, theme, toggleStage } from "./theme.js";
import { html } from "./ui.js";

/** @import { ComponentType } from "./vendor/preact.js"
 * @import { Signal } from "./vendor/signals.js" */

const keysShown = signal(false);
/** Whether a phone shows the switches of the display. */
const displayShown = signal(false);

/**
 * Views that are loaded when they are first opened: most people open few.
 * @type {Record<string, () => Promise<ComponentType>>}
 */
const LATER = {
  setup: () => import("./setup.js").then(({ Setup }) => Setup),
  set: () => import("./setpage.js").then(({ SetPage }) => SetPage),
  recordings: () => import("./recordings.js").then(({ Recordings }) => Recordings),
  health: () => import("./health.js").then(({ Health }) => Health),
};
/** Those that are here; null where one could not be loaded. */
const loaded = signal(/** @type {Record<string, ComponentType | null>} */ ({ live: Live }));
effect(() => {
  const name = shown.value;
  if (name in loaded.peek()) return;
  const keep = (/** @type {ComponentType | null} */ view) => (loaded.value = { ...loaded.peek(), [name]: view });
  LATER[name]().then(keep, () => keep(null));
});

/** Why a mark made by key was not made, for as long as a sentence is read. */
const unmarked = signal("");
const READ_WITHIN = 8000;
let untilRead = 0;
async function mark() {
  unmarked.value = barred.value ?? (await post("recordings/mark", { text: "" }).then(() => "", reason));
  clearTimeout(untilRead);
  untilRead = setTimeout(() => (unmarked.value = ""), READ_WITHIN);
}

/** Switches it. @param {Signal<boolean>} on */
const switching = (on) => () => (on.value = !on.value);
const toggleOutlines = switching(outlined);
const toggleFloor = switching(floored);
const toggleParts = switching(parted);
const toggleResiduals = switching(rested);
const toggleKeys = switching(keysShown);

/** What single keys do. */
const KEYS = [
  { key: " ", name: "Space", does: "freeze the picture, or continue", act: toggleFrozen },
  { key: "o", name: "o", does: "outlines on and off", act: toggleOutlines },
  { key: "g", name: "g", does: "metre grid on the floor on and off", act: toggleFloor },
  { key: "x", name: "x", does: "seen and hidden parts of the stage on and off", act: toggleParts },
  { key: "u", name: "u", does: "pixels used and their residuals on and off", act: toggleResiduals },
  { key: "r", name: "r", does: "mark this moment", act: mark },
  { key: "n", name: "n", does: "stage colours on and off", act: toggleStage },
  { key: "?", name: "?", does: "this list", act: toggleKeys },
  { key: "Escape", name: "", does: "", act: () => (keysShown.value = false) },
  ...PAGES.map(({ name, title, key }) => ({ key, name: key, does: `the view ${title}`, act: () => show(name) })),
];

/** A button that is on or off. @param {{on: boolean, act: () => void, children: unknown}} props */
function Switch({ on, act, children }) {
  return html`<button type="button" aria-pressed=${on ? "true" : "false"} onClick=${act}>${children}</button>`;
}

function Bar() {
  return html`<header>
    <h1>stagepose</h1>
    <nav aria-label="Views">
      ${PAGES.map(({ name, title }) => html`<a key=${name} href=${`#${name}`} aria-current=${shown.value === name ? "page" : null}>${title}</a>`)}
    </nav>
    <${State} />
    <${Recording} />
    <div class="switches ${displayShown.value ? "opened" : ""}">
      <${Lock} />
      ${shown.value === "live" || shown.value === "set" ? html`<${Switch} on=${frozen.value} act=${toggleFrozen}>Freeze<//>` : null}
      <button type="button" class="more" aria-expanded=${displayShown.value ? "true" : "false"} onClick=${switching(displayShown)}>Display</button>
      <div class="display">
      ${shown.value === "live"
        ? html`<${Switch} on=${outlined.value} act=${toggleOutlines}>Outlines<//><${Switch} on=${floored.value} act=${toggleFloor}>Floor<//><${Switch} on=${parted.value} act=${toggleParts}>Seen parts<//><${Switch} on=${rested.value} act=${toggleResiduals}>Residuals<//>`
        : null}
      <fieldset class="choice">
        <legend>Colours</legend>
        ${THEMES.map(
          (name) => html`<label key=${name}>
            <input type="radio" name="theme" value=${name} checked=${theme.value === name} onChange=${() => (theme.value = name)} />
            <span>${name}</span>
          </label>`,
        )}
      </fieldset>
      </div>
    </div>
    ${[...new Set([unturned.value, unmarked.value])].filter(Boolean).map((why) => html`<p key=${why} class="refused" role="alert">${why}</p>`)}
  </header>`;
}

function Foot() {
  return html`<footer>
    <button type="button" aria-expanded=${keysShown.value ? "true" : "false"} onClick=${toggleKeys}>Keys</button>
    ${keysShown.value
      ? html`<section class="overlay" aria-label="Keys">
          <ul class="keys">${[...viewKeys.value, ...KEYS].filter(({ name }) => name !== "").map(({ name, does }) => html`<li key=${name}><kbd>${name}</kbd> ${does}</li>`)}</ul>
          <p class="note"><kbd>?</kbd> or <kbd>Esc</kbd> closes this list.</p>
        </section>`
      : null}
    <a href="./vendor/LICENSES.txt">Licences</a>
  </footer>`;
}

function View() {
  const view = loaded.value[shown.value];
  if (view) return html`<${view} />`;
  return html`<main><p role="status">${view === null ? "This view could not be loaded. Check that stagepose runs, then reload the page." : "Loading this view."}</p></main>`;
}

function Page() {
  // The set-up says itself what is wrong, where it can be changed.
  return html`<${Bar} />${shown.value === "setup" ? null : html`<${ConfigFault} />`}<${Pairing} /><${View} /><${Foot} />`;
}

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  // What is typed into a field is the field's.
  if (event.target instanceof HTMLElement && event.target.matches("input:not([type=radio]), select, textarea")) return;
  // Space presses the button that has the focus.
  if (event.key === " " && event.target instanceof HTMLElement && event.target.closest("button, a, input")) return;
  const found = [...viewKeys.value, ...KEYS].find(({ key }) => key === event.key);
  if (found) {
    event.preventDefault();
    found.act();
  }
});

// Without a config there is nothing to look at yet. Who follows a link to a view gets that one.
if (location.hash === "") {
  const stop = effect(() => {
    if (session.value === null) return;
    if (!session.value.has_config && location.hash === "") show("setup");
    queueMicrotask(() => stop());
  });
}

const place = document.getElementById("page");
if (place) {
  place.replaceChildren();
  render(html`<${Page} />`, place);
}
listen();
listenToEvents();
watchAccess();
watchRecording();
