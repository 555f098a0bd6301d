// Receives what the daemon sends: pictures with their records, and its status between them. The
// page requests a picture when the last one is decoded (if painting is slow, when it is painted),
// and paints the newest: even a slow page shows a current picture. It reports silence within a
// second.
import { signal } from "./vendor/signals.js";
import { content, parsed } from "./ask.js";

/**
 * Milliseconds. The daemon sends something at least every 250. After this long without a message
 * the page reports no contact, and it checks this often: a loss shows within 650, and a busy
 * machine that is late by 350 causes none.
 */
export const SILENT_AFTER = 600;
export const LOOKS_EVERY = 50;
/** Milliseconds from a lost connection, or one that does not come about, to the next try. */
const TRY_AGAIN = 700;
const GIVE_UP_AFTER = 2500;
/** Milliseconds for which a shown frame stands for the status. */
const FRAME_SPEAKS = 1000;
/**
 * Milliseconds. If painting takes longer, the next picture is requested after it: one that came
 * meanwhile would be shown that much later. Raised, slow pages show older pictures; at 0, pages
 * whose browser paints late do.
 */
const LONG_PAINT = 25;
/** Shown frames that the rate is counted over. */
const RATE_OVER = 30;

/** @import { Head, Known, Scene } from "./types.js" */

/** Whether the daemon speaks; null until that is known. */
export const contact = signal(/** @type {boolean | null} */ (null));
/** The status as /api/v1/state has it, if no frames come. */
export const standing = signal(/** @type {Known | null} */ (null));
/** The head of the frame that is shown. */
export const head = signal(/** @type {Head | null} */ (null));
/** Frames shown a second; null with fewer than two. */
export const rate = signal(/** @type {number | null} */ (null));
/** Whether the picture stands still because the user wants it. */
export const frozen = signal(false);
/** Whether each view wants the next frame with its pixels. @type {Set<() => boolean>} */
export const pixelsWanted = new Set();
/** Camera and surfaces of this session, as /api/v1/scene has them. */
export const scene = signal(/** @type {Scene | null} */ (null));

/**
 * Functions that draw a frame when the browser paints; the picture is closed afterwards.
 * @type {Set<(picture: ImageBitmap, head: Head) => void>}
 */
export const painters = new Set();
/** @type {WebSocket | null} */
let socket = null;
let triedAt = 0;
let heardAt = 0;
let owesFrame = false;
/**
 * The newest decoded frame, until the browser paints.
 * @type {{ picture: ImageBitmap, said: Head } | null}
 */
let unpainted = null;
/** Milliseconds that the last painting took. */
let paintTook = 0;
let epoch = 0;
/** @type {string | null} */
let page = null;
/** @type {number[]} */
let shownAt = [];

/** When something was last heard, milliseconds of performance.now. */
export const heard = () => heardAt;

/** Begins. */
export function listen() {
  connect();
  setInterval(watch, LOOKS_EVERY);
  document.addEventListener("visibilitychange", ask);
}

/** Pictures stand still, or go on. */
export function toggleFrozen() {
  frozen.value = !frozen.value;
  ask();
}

function connect() {
  const address = new URL("ws/view", document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  const opened = new WebSocket(address);
  opened.binaryType = "arraybuffer";
  opened.onopen = ask;
  opened.onmessage = (/** @type {MessageEvent<string | ArrayBuffer>} */ { data }) => {
    if (opened === socket) hear(data);
  };
  opened.onclose = () => {
    if (opened === socket) {
      socket = null;
      contact.value = false;
    }
  };
  socket = opened;
  triedAt = performance.now();
  owesFrame = false;
}

/** Says that nobody speaks, and tries again. */
function watch() {
  const now = performance.now();
  if (now - Math.max(heardAt, contact.value === null ? triedAt : 0) > SILENT_AFTER) contact.value = false;
  const wait = socket === null ? TRY_AGAIN : GIVE_UP_AFTER;
  if (contact.value === false && now - triedAt > wait) {
    const old = socket;
    connect();
    old?.close();
  }
}

/** Asks for the next frame, unless one is on its way or nobody would see it. */
function ask() {
  if (owesFrame || frozen.value || document.hidden || socket?.readyState !== WebSocket.OPEN) return;
  owesFrame = true;
  socket.send([...pixelsWanted].some((wants) => wants()) ? "u" : "n");
}

/** @param {string | ArrayBuffer} data */
function hear(data) {
  heardAt = performance.now();
  contact.value = true;
  if (typeof data === "string") {
    const said = /** @type {{page: string, state: Known}} */ (parsed(data));
    // A page of another version does not know what this daemon says.
    if (page !== null && page !== said.page) location.reload();
    page = said.page;
    // Between the frames of a slow tracker its last frame says more, while its state is current.
    if (heardAt - (shownAt.at(-1) ?? 0) > FRAME_SPEAKS || said.state.state !== head.value?.record.state) {
      standing.value = said.state;
      rate.value = null;
      shownAt = [];
    }
  } else {
    void show(data);
  }
}

/** @param {ArrayBuffer} data */
async function show(data) {
  const length = new DataView(data).getUint32(0, true);
  const said = /** @type {Head} */ (parsed(new TextDecoder().decode(new Uint8Array(data, 4, length))));
  const picture = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" })).catch(() => null);
  if (said.epoch !== epoch) void learnScene(said.epoch);
  owesFrame = false;
  if (picture !== null) {
    // A browser that paints later than the next picture comes paints that one.
    if (unpainted === null) requestAnimationFrame(paintNewest);
    else unpainted.picture.close();
    unpainted = { picture, said };
  }
  if (picture === null || paintTook < LONG_PAINT) ask();
}

/** Paints the frame that waits, now that the browser paints. @param {number} now */
function paintNewest(now) {
  if (unpainted === null) return;
  const begun = performance.now();
  const { picture, said } = unpainted;
  unpainted = null;
  // Who looks again sees a new one.
  if (!frozen.value && !document.hidden) {
    for (const paint of painters) paint(picture, said);
    head.value = said;
    standing.value = null;
    shownAt = [...shownAt.slice(1 - RATE_OVER), now];
    const span = now - shownAt[0];
    rate.value = span > 0 ? (1000 * (shownAt.length - 1)) / span : null;
  }
  picture.close();
  paintTook = performance.now() - begun;
  ask();
}

/** @param {number} of the session's number */
async function learnScene(of) {
  epoch = of;
  try {
    const answer = await fetch("./api/v1/scene", { cache: "no-store" });
    scene.value = answer.ok ? await content(answer) : null;
  } catch {
    // The next frame asks again.
    epoch = 0;
  }
}
