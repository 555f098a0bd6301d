// What is in a zip, without unpacking all of it: names from its directory, and a file's text.

/** Signatures: the end of the directory, and one of its entries. Little-endian. */
const END = 0x06054b50;
const ENTRY = 0x02014b50;
/** Bytes of the end without its comment, which has at most this many. */
const END_BYTES = 22;
const LONGEST_COMMENT = 65535;

/**
 * @typedef {{name: string, bytes: number, packed: number, method: number, at: number}} Entry `at`
 *   is where its local header begins
 */

/**
 * The files of a zip; the promise fails with a sentence if it is not one.
 * @param {Blob} file
 * @returns {Promise<Entry[]>}
 */
export async function entries(file) {
  const tail = new DataView(await file.slice(Math.max(0, file.size - END_BYTES - LONGEST_COMMENT)).arrayBuffer());
  let end = tail.byteLength - END_BYTES;
  while (end >= 0 && tail.getUint32(end, true) !== END) end -= 1;
  if (end < 0) throw new Error("This is not a complete zip file. Choose a backup from this page.");
  const [count, size, from] = [tail.getUint16(end + 10, true), tail.getUint32(end + 12, true), tail.getUint32(end + 16, true)];
  const view = new DataView(await file.slice(from, from + size).arrayBuffer());
  /** @type {Entry[]} */
  const found = [];
  for (let at = 0; found.length < count; ) {
    if (at + 46 > view.byteLength || view.getUint32(at, true) !== ENTRY) throw new Error("The zip's directory is damaged. Choose another backup.");
    const [name, extra, comment] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    const text = new TextDecoder().decode(new Uint8Array(view.buffer, at + 46, Math.min(name, view.byteLength - at - 46)));
    found.push({ name: text, bytes: view.getUint32(at + 24, true), packed: view.getUint32(at + 20, true), method: view.getUint16(at + 10, true), at: view.getUint32(at + 42, true) });
    at += 46 + name + extra + comment;
  }
  return found;
}

/** A file's content as text. @param {Blob} file @param {Entry} entry */
export async function textOf(file, { packed, method, at }) {
  const head = new DataView(await file.slice(at, at + 30).arrayBuffer());
  const from = at + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  const content = file.slice(from, from + packed);
  if (method === 0) return content.text();
  if (method !== 8) throw new Error("The zip uses an unsupported compression. Choose a backup from this page.");
  return new Response(content.stream().pipeThrough(new DecompressionStream("deflate-raw"))).text();
}

/**
 * Lines that only one of two texts has: those removed and those added, in order.
 * @param {string} before
 * @param {string} after
 */
export function differing(before, after) {
  const [old, next] = [before, after].map((text) => text.split("\n").map((line) => line.trimEnd()));
  const without = (/** @type {string[]} */ lines, /** @type {string[]} */ others) => {
    /** @type {Map<string, number>} */
    const left = new Map();
    for (const line of others) left.set(line, (left.get(line) ?? 0) + 1);
    return lines.filter((line) => {
      const count = left.get(line) ?? 0;
      left.set(line, count - 1);
      return count <= 0 && line !== "";
    });
  };
  return { goes: without(old, next), comes: without(next, old) };
}
