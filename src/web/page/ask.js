// Questions to the daemon, and changes, with its answer as a sentence where it refuses.

/**
 * @import { Finding, Means, Output, Part, RecordingList, Retracked, Session, Timeline } from "./types.js"
 */

/**
 * What the daemon answers with where it is asked for JSON, by the path.
 * @typedef {{
 *   session: Session,
 *   setup: Means,
 *   health: {parts: Part[]},
 *   outputs: {outputs: Output[]},
 *   recordings: RecordingList,
 *   [timeline: `recordings/${string}/timeline?${string}`]: Timeline,
 *   [retracked: `recordings/${string}/retracked?${string}`]: Retracked,
 * }} Answers
 */

/** What says that a request comes from the page itself. */
const OWN = { "X-Stagepose": "1" };

/** What the daemon refuses, with its own sentence. */
export class Refused extends Error {
  /** @param {number} status @param {string} says */
  constructor(status, says) {
    super(says);
    this.status = status;
  }
}

/**
 * Listeners for refused requests; `isChange`: whether it was a change.
 * @type {Set<(status: number, isChange: boolean) => void>}
 */
export const whenRefused = new Set();

/**
 * Makes a sentence of the daemon's words, which begin with a small letter and end without a full
 * stop. A leading name is not capitalised.
 * @param {string} words
 */
export function sentence(words) {
  const text = words.trim();
  const begun = /^[a-z]+([ ,;:]|$)/.test(text) ? `${text[0].toUpperCase()}${text.slice(1)}` : text;
  return text === "" || /[.!?…]$/.test(text) ? begun : `${begun}.`;
}

/** What is the matter, as a sentence. @param {unknown} why */
export function reason(why) {
  return why instanceof Error ? why.message : sentence(String(why));
}

/** @param {string} path below the page's address @param {RequestInit} [how] */
export async function ask(path, how = {}) {
  /** @type {Response} */
  let answer;
  try {
    answer = await fetch(`./api/v1/${path}`, { cache: "no-store", ...how });
  } catch (why) {
    if (how.signal?.aborted) throw why;
    throw new Refused(0, "stagepose does not answer. Check that it runs.");
  }
  if (answer.ok) return answer;
  for (const listener of whenRefused) listener(answer.status, how.method !== undefined);
  throw new Refused(answer.status, await refusal(answer));
}

/** The sentence of a refusal: a text, or the findings of a config. @param {Response} answer */
async function refusal(answer) {
  const text = await answer.text();
  try {
    const { findings } = /** @type {{findings: Finding[]}} */ (parsed(text));
    return findings.map((found) => [found.line ? `line ${found.line}: ${found.sentence}` : found.sentence, found.mend ?? ""].filter(Boolean).map(sentence).join(" ")).join(" ");
  } catch {
    return sentence(text) || `stagepose returned HTTP status ${answer.status}.`;
  }
}

/** What a text of JSON says. @param {string} text @returns {unknown} */
export function parsed(text) {
  return JSON.parse(text);
}

/**
 * An answer's content; the caller knows its type.
 * @template T
 * @param {Response} answer
 * @returns {Promise<T>}
 */
export async function content(answer) {
  return /** @type {T} */ (parsed(await answer.text()));
}

/**
 * Lines of JSON, one per row.
 * @param {string} path
 * @param {AbortSignal} [signal]
 * @returns {Promise<unknown[]>}
 */
export async function lines(path, signal) {
  const text = await (await ask(path, { signal })).text();
  return text.split("\n").filter((line) => line !== "").map(parsed);
}

/**
 * The answer as JSON.
 * @template {keyof Answers} P
 * @param {P} path
 * @param {AbortSignal} [signal]
 * @returns {Promise<Answers[P]>}
 */
export async function read(path, signal) {
  return content(await ask(path, { signal }));
}

/**
 * Requests a change.
 * @param {string} path
 * @param {unknown} [sent] as JSON; bytes are sent unchanged
 */
export function post(path, sent) {
  return send("POST", path, sent);
}

/**
 * @param {"POST" | "PUT" | "DELETE"} method
 * @param {string} path
 * @param {unknown} [sent]
 * @param {Record<string, string>} [headers]
 */
export function send(method, path, sent, headers = {}) {
  const isBytes = sent instanceof Blob;
  const type = isBytes ? sent.type : "application/json";
  const body = sent === undefined ? undefined : isBytes ? sent : JSON.stringify(sent);
  return ask(path, { method, headers: { ...OWN, ...(sent === undefined ? {} : { "Content-Type": type }), ...headers }, body });
}
