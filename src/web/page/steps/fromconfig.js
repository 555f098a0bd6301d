// A config that exists, as a draft: the steps show what they know of it, and keep the rest as it is.
import { signal } from "../vendor/signals.js";
import { ask, content, reason } from "../ask.js";
import { NEW_SURFACE, takeDraft, whole } from "./draft.js";

/** @import { Draft, KeptFile, SurfaceDraft } from "./draft.js" */
/** @import { Table, Texts } from "./types.js" */
/** @typedef {{[key: string]: unknown}} Values */
/** @typedef {{values: Values, texts: Table}} Parts values of a config, and the same as TOML's text */

/** How reading it went; empty before. */
export const readSaid = signal("");

/** @param {unknown} value @returns {Values} */
const table = (value) => (typeof value === "object" && value !== null && !Array.isArray(value) ? /** @type {Values} */ (value) : {});
/** @param {Texts | undefined} value @returns {Table} */
const tableOf = (value) => (typeof value === "object" && !Array.isArray(value) ? value : {});
/** @param {unknown} value */
const text = (value) => (typeof value === "string" ? value : null);
/** @param {unknown} value @returns {value is number[]} */
const isNumbers = (value) => Array.isArray(value) && value.every((one) => typeof one === "number");

/** A table without some of its keys. @param {Table} of @param {string[]} keys */
const without = (of, keys) => Object.fromEntries(Object.entries(of).filter(([key]) => !keys.includes(key)));

/** A file of the config whose size is not known. @param {string} file @returns {KeptFile} */
const named = (file) => ({ file, name: file.split("/").pop() ?? "", width: 0, height: 0, fov_deg: null });

/** A length as typed, metres. @param {number} value */
const typed = (value) => `${Number(value.toFixed(6))}`;

/** @param {Values} camera @returns {Partial<Draft>} */
function lens(camera) {
  const calibration = text(camera.calibration);
  if (calibration !== null) return { lens: "file", calibration: named(calibration) };
  return typeof camera.fov_deg === "number" ? { lens: "guess", fov: `${camera.fov_deg}` } : { lens: "config" };
}

/**
 * @param {Values} of
 * @param {Table} all
 * @param {number[]} first where the first surface's centre is typed
 * @param {number} k
 * @returns {SurfaceDraft}
 */
function surface(of, all, first, k) {
  const shown = ["image", "photo", "corners_px", "size_m"];
  const [width, height] = isNumbers(of.size_m) ? of.size_m.map(typed) : ["", ""];
  const [image, photo] = [text(of.image), text(of.photo)];
  const corners = Array.isArray(of.corners_px) && of.corners_px.every(isNumbers) ? /** @type {number[][]} */ (of.corners_px) : [];
  const at = isNumbers(of.position_m) ? of.position_m : [0, 0, 0];
  const turned = isNumbers(of.rotation_deg) ? of.rotation_deg : null;
  const isTurn = turned !== null && turned[1] === 0 && turned[2] === 0;
  // The first one's place is what the origin says.
  const hides = k === 0 ? ["position_m"] : ["position_m", ...(isTurn ? ["rotation_deg"] : [])];
  return {
    ...NEW_SURFACE,
    door: image === null ? "freeze" : "artwork",
    artwork: image === null ? null : named(image),
    photo: photo === null ? null : named(photo),
    corners,
    width,
    height,
    place: k === 0 ? ["0", "0", "0"] : at.map((value, axis) => typed(value - first[axis])),
    turn: k > 0 && isTurn ? typed(turned[0]) : "0",
    more: without(all, [...shown, ...hides, ...(image === null ? ["photo_calibration"] : [])]),
  };
}

/** @param {Values} stage @param {number[]} first @returns {Partial<Draft>} */
function origin(stage, first) {
  const points = Object.entries(table(stage.origin)).flatMap(([point, at]) => (isNumbers(at) ? [{ point, at: at.map(typed) }] : []));
  if (points.length === 3) return { origin: "points", points };
  // Without an origin the surfaces' places count.
  const [{ point, at }] = points.length === 1 ? points : [{ point: "centre", at: first.map(typed) }];
  return { origin: "point", point, at };
}

/** @param {Values} of @param {Table} all */
function output(of, all) {
  const to = Array.isArray(of.to) && of.to.length === 1 ? text(of.to[0]) : null;
  const isPlain = to !== null && Object.keys(of).every((key) => ["kind", "name", "to"].includes(key)) && /-\d+$/.test(text(of.name) ?? "");
  return { kind: text(of.kind) ?? "", to: to ?? "as the config has it", ...(isPlain ? {} : { more: all }) };
}

/**
 * A config as a draft; null if the steps cannot show it.
 * @param {Parts} parts
 * @returns {Partial<Draft> | null}
 */
export function asDraft({ values, texts: all }) {
  const [camera, stage] = [table(values.camera), table(values.stage)];
  const [cameraTexts, stageTexts] = [tableOf(all.camera), tableOf(all.stage)];
  const surfaces = Array.isArray(stage.surface) ? stage.surface.map(table) : [];
  const surfaceTexts = Array.isArray(stageTexts.surface) ? stageTexts.surface.map(tableOf) : [];
  const points = Object.keys(table(stage.origin)).length;
  // A map has no surfaces, and the steps have room for one or three points.
  if (surfaces.length === 0 || ![0, 1, 3].includes(points)) return null;
  const at = surfaces[0].position_m;
  const first = isNumbers(at) ? at : [0, 0, 0];
  const controls = Object.entries(table(camera.controls)).filter(([, value]) => typeof value === "number");
  const isControls = controls.length > 0 && controls.length === Object.keys(table(camera.controls)).length;
  const outputs = Array.isArray(values.output) ? values.output.map(table) : [];
  const outputTexts = Array.isArray(all.output) ? all.output.map(tableOf) : [];
  return {
    device: text(camera.device),
    controls: isControls ? /** @type {Record<string, number>} */ (Object.fromEntries(controls)) : null,
    ...lens(camera),
    surfaces: surfaces.map((one, k) => surface(one, surfaceTexts[k] ?? {}, first, k)),
    surface: 0,
    unit: "m",
    ...origin(stage, first),
    outputs: outputs.map((one, k) => output(one, outputTexts[k] ?? {})),
    more: {
      camera: without(cameraTexts, ["device", "calibration", "fov_deg", ...(isControls ? ["controls"] : [])]),
      stage: without(stageTexts, ["origin", "surface"]),
      http: without(tableOf(all.http), ["listen"]),
      tables: without(all, ["camera", "stage", "http", "output"]),
    },
  };
}

/** Goes on from the config that the daemon has. */
export async function readBack() {
  try {
    const answer = await ask("setup/config");
    const found = asDraft(await content(answer));
    if (found === null) {
      readSaid.value = "The config has no surface that these steps could show: its stage is a map, or is placed by more points. It stays as it is.";
      return false;
    }
    takeDraft(whole({ ...found, tag: answer.headers.get("ETag"), edited: Date.now() }));
    readSaid.value = "";
    return true;
  } catch (why) {
    readSaid.value = reason(why);
    return false;
  }
}
