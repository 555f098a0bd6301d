// Questions to the daemon, and changes, with its answer as a sentence where it refuses.

/** What says that a request comes from the page itself. */
const OWN = { "X-Stagepose": "1" };

/** What the daemon refuses, with its own sentence. */
export class Refused extends Error {
  /** @param {number} status @param {string} sentence */
  constructor(status, sentence) {
    super(sentence);
    this.status = status;
  }
}

/** Who wants to know of refusals, and whether it was a change that was refused. @type {Set<(status: number, isChange: boolean) => void>} */
export const whenRefused = new Set();

/** Words of the daemon as a sentence: they begin small, and end without a full stop. A name that comes first stays as it is. @param {string} words */
export function sentence(words) {
  const text = words.trim();
  const begun = /^[a-z]+([ ,;:]|$)/.test(text) ? `${text[0].toUpperCase()}${text.slice(1)}` : text;
  return text === "" || /[.!?…]$/.test(text) ? begun : `${begun}.`;
}

/** What is the matter, as a sentence. @param {unknown} why */
export function reason(why) {
  return why instanceof Error ? why.message : sentence(`${why}`);
}

/** @param {string} path below the page's address @param {RequestInit} [how] */
export async function ask(path, how = {}) {
  /** @type {Response} */
  let answer;
  try {
    answer = await fetch(`./api/v1/${path}`, { cache: "no-store", ...how });
  } catch (why) {
    if (how.signal?.aborted) throw why;
    throw new Refused(0, "stagepose does not answer. See that it runs.");
  }
  if (answer.ok) return answer;
  for (const told of whenRefused) told(answer.status, how.method !== undefined);
  throw new Refused(answer.status, await refusal(answer));
}

/** The sentence of a refusal: a text, or the findings of a config. @param {Response} answer */
async function refusal(answer) {
  const text = await answer.text();
  try {
    const { findings } = JSON.parse(text);
    return findings.map((/** @type {any} */ found) => [found.line ? `line ${found.line}: ${found.sentence}` : found.sentence, found.mend].filter(Boolean).map(sentence).join(" ")).join(" ");
  } catch {
    return sentence(text) || `stagepose answers with ${answer.status}.`;
  }
}

/** The answer as JSON. @param {string} path @param {AbortSignal} [signal] @returns {Promise<any>} */
export async function read(path, signal) {
  return (await ask(path, { signal })).json();
}

/** A change. @param {string} path @param {any} [content] sent as JSON, or as it is where it is bytes */
export function post(path, content) {
  return send("POST", path, content);
}

/** @param {"POST" | "PUT" | "DELETE"} method @param {string} path @param {any} [content] @param {Record<string, string>} [headers] */
export function send(method, path, content, headers = {}) {
  const isBytes = content instanceof Blob;
  const type = isBytes ? content.type : "application/json";
  const body = content === undefined ? undefined : isBytes ? content : JSON.stringify(content);
  return ask(path, { method, headers: { ...OWN, ...(content === undefined ? {} : { "Content-Type": type }), ...headers }, body });
}
