// Models from files: glTF in one file (.glb). Files that refer to others are refused, because the
// page loads nothing from elsewhere.
import { signal } from "./vendor/signals.js";
import { ask, parsed, reason, send } from "./ask.js";
import { Box3, Group, GLTFLoader, LoadingManager, TextureLoader, Vector3 } from "./vendor/three.js";

/** Bytes of a file at most. */
const LARGEST = 64 * 1024 * 1024;

/** Models by the name of their file, a metre high at most, standing on their origin, z up. */
export const models = signal(/** @type {Map<string, import("./vendor/three.js").Object3D>} */ (new Map()));

/** Letters of a model's name, as the daemon takes them. */
const LONGEST_NAME = 64;

/** What the daemon calls a model's file. @param {string} name */
function keptName(name) {
  return `${name.replace(/\.glb$/i, "").replace(/[^A-Za-z0-9_-]+/g, "-").slice(0, LONGEST_NAME) || "model"}.glb`;
}

/**
 * Reads a model and sends it to the daemon to keep; the promise fails with a sentence for users if
 * the model cannot be used. Returns its name, and why the daemon does not keep it.
 * @param {File} file
 * @returns {Promise<{name: string, unkept: string | null}>}
 */
export async function load(file) {
  if (file.size > LARGEST) throw new Error(`${file.name} has ${Math.ceil(file.size / 1048576)} MB; the maximum is 64 MB. Make its pictures smaller.`);
  const name = keptName(file.name);
  await take(file.name, name, await file.arrayBuffer());
  const content = new Blob([file], { type: "model/gltf-binary" });
  return { name, unkept: await send("PUT", `sets/${name}`, content).then(() => null, reason) };
}

/** Models that were asked for. @type {Set<string>} */
const asked = new Set();

/** Fetches models that the daemon keeps, each once. @param {string[]} names */
export async function fetchModels(names) {
  for (const name of names) {
    if (asked.has(name) || models.value.has(name)) continue;
    asked.add(name);
    try {
      await take(name, name, await (await ask(`sets/${name}`)).arrayBuffer());
    } catch {
      // The user sees that its file is missing; the next opening asks again.
      asked.delete(name);
    }
  }
}

/**
 * @param {string} file as people call it
 * @param {string} kept its name
 * @param {ArrayBuffer} bytes
 */
async function take(file, kept, bytes) {
  refuseOthers(file, bytes);
  const loader = new GLTFLoader(new LoadingManager());
  // Pictures through an element: the policy lets nothing be fetched from memory.
  loader.register((parser) => {
    parser.textureLoader = new TextureLoader(parser.options.manager);
    return { name: "pictures" };
  });
  const gltf = await loader.parseAsync(bytes, "").catch((/** @type {unknown} */ why) => {
    throw new Error(`${file} cannot be read (${why instanceof Error ? why.message : String(why)}). Export it as glTF binary (.glb) without compression.`);
  });
  models.value = new Map([...models.value, [kept, upright(gltf.scene)]]);
}

/** @param {string} name @param {ArrayBuffer} bytes */
function refuseOthers(name, bytes) {
  const view = new DataView(bytes);
  // "glTF", then the version, the length, and the first chunk: JSON.
  if (bytes.byteLength < 20 || view.getUint32(0, true) !== 0x46546c67) throw new Error(`${name} is not a glTF binary file. Export it as .glb.`);
  const length = view.getUint32(12, true);
  if (20 + length > bytes.byteLength) throw new Error(`${name} is incomplete. Copy it again.`);
  /** @type {{buffers?: {uri?: string}[], images?: {uri?: string}[]}} */
  let said;
  try {
    said = /** @type {typeof said} */ (parsed(new TextDecoder().decode(new Uint8Array(bytes, 20, length))));
  } catch {
    throw new Error(`${name} has no table of contents. Export it again.`);
  }
  const named = [...(said.buffers ?? []), ...(said.images ?? [])].filter(({ uri }) => uri !== undefined);
  if (named.length > 0) throw new Error(`${name} refers to other files. Export everything as one .glb file.`);
}

/**
 * Rotates a glTF model (y is up), scales it to a metre, and puts it on its origin.
 * @param {import("./vendor/three.js").Object3D} model
 */
function upright(model) {
  model.rotation.x = Math.PI / 2;
  model.updateMatrixWorld(true);
  const bounds = new Box3().setFromObject(model);
  const [size, middle] = [bounds.getSize(new Vector3()), bounds.getCenter(new Vector3())];
  const scale = 1 / Math.max(size.x, size.y, size.z, 1e-6);
  const whole = new Group();
  whole.scale.setScalar(scale);
  whole.position.set(-middle.x * scale, -middle.y * scale, -bounds.min.z * scale);
  whole.add(model);
  return new Group().add(whole);
}
