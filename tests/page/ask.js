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

/** @param {string} path below the page's address @param {RequestInit} [how] */
export async function ask(path, how = {}) {
  /** @type {Response} */
  let answer;
  try {
    answer = await fetch(`./api/v1/${path}`, { cache: "no-store", ...how });
  } catch {
    throw new Refused(0, "stagepose does not answer. See that it runs.");
  }
  if (!answer.ok) throw new Refused(answer.status, (await answer.text()).trim() || `stagepose answers with ${answer.status}.`);
  return answer;
}

/** The answer as JSON. @param {string} path @param {AbortSignal} [signal] @returns {Promise<any>} */
export async function read(path, signal) {
  return (await ask(path, { signal })).json();
}

/** A change. @param {string} path @param {any} [content] sent as JSON, or as it is where it is bytes */
export function post(path, content) {
  const isBytes = content instanceof Blob;
  const type = isBytes ? content.type : "application/json";
  const body = content === undefined ? undefined : isBytes ? content : JSON.stringify(content);
  return ask(path, { method: "POST", headers: content === undefined ? OWN : { ...OWN, "Content-Type": type }, body });
}
