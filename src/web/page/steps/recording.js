// A recording for the set-up: begun and ended here, named by the daemon.
import { signal } from "../vendor/signals.js";
import { post, read } from "../ask.js";

/** When the one that was begun here began, milliseconds of performance.now(); null without one. */
export const since = signal(/** @type {number | null} */ (null));

/** Waits until `of` is true of the list of recordings. @param {(list: import("../types.js").RecordingList) => boolean} of */
async function when(of) {
  for (let k = 0; k < 100; k += 1) {
    const list = await read("recordings");
    if (of(list)) return list;
    await new Promise((done) => setTimeout(done, 100));
  }
  throw new Error("The recorder does not answer. See Recordings.");
}

/** Begins one. */
export async function begin() {
  await post("recordings/start");
  await when(({ recording }) => recording !== null);
  since.value = performance.now();
}

/** Ends it, and returns its name. */
export async function end() {
  const { recording } = await read("recordings");
  since.value = null;
  await post("recordings/stop");
  await when((list) => list.recording === null);
  if (recording === null) throw new Error("The recording has ended already. Begin again.");
  return recording;
}
