// Writes the config, which the daemon then uses at once.
import { signal } from "../vendor/signals.js";
import { session } from "../access.js";
import { Refused, ask, content, reason, send } from "../ask.js";
import { config } from "./config.js";
import { change, draft } from "./draft.js";

/** @import { Finding } from "../types.js" */

/** How writing went; empty before. */
export const said = signal("");
/** Whether there is a config that this set-up did not write, or that was changed since. */
export const isOther = signal(false);
/** Whether it is being written. */
export const isWriting = signal(false);

/** The ETag of the daemon's config; null without one. @returns {Promise<string | null>} */
async function tagNow() {
  try {
    return (await ask("config")).headers.get("ETag");
  } catch (why) {
    if (why instanceof Refused && why.status === 404) return null;
    throw why;
  }
}

/** Writes the draft. @param {boolean} replaces whether it may take the place of another config */
export async function write(replaces) {
  const text = config.peek();
  if (text === null || isWriting.peek()) return false;
  isWriting.value = true;
  said.value = "";
  try {
    const tag = await tagNow();
    isOther.value = tag !== null && tag !== draft.peek().tag && !replaces;
    if (isOther.value) return false;
    const answer = await send("PUT", "config", new Blob([text], { type: "text/plain" }), { "If-Match": tag ?? "*" });
    change({ written: text, tag: answer.headers.get("ETag") });
    /** @type {{findings: Finding[]}} */
    await content(answer);
    said.value = `Written to ${session.peek()?.config_file ?? "the config"}.`;
    return true;
  } catch (why) {
    said.value = `Nothing was written. ${reason(why)}`;
    return false;
  } finally {
    isWriting.value = false;
  }
}
