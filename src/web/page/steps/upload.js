// Files for the config, from this browser to the daemon.
import { content, send } from "../ask.js";

/** @import { Kept } from "../types.js" */
/** @import { KeptFile } from "./draft.js" */

/** The longest name before its ending. */
const LONGEST = 60;

/**
 * A name that the daemon takes, like the file's own.
 * @param {string} name
 * @param {string[]} endings the first is for files that have none of them
 */
function plain(name, endings) {
  const ending = endings.find((one) => name.toLowerCase().endsWith(one)) ?? endings[0];
  const stem = name.replace(/\.[^.]*$/, "").normalize("NFKD").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "");
  return `${stem.slice(0, LONGEST) || "file"}${ending}`;
}

/** @param {string} path @param {string} name @param {Blob} file @returns {Promise<KeptFile>} */
async function put(path, name, file) {
  /** @type {Kept} */
  const kept = await content(await send("PUT", `${path}/${name}`, file));
  return { ...kept, name };
}

/** @param {Blob} file @param {string} name */
export const putPicture = (file, name) => put("pictures", plain(name, [file.type === "image/png" ? ".png" : ".jpg", ".png", ".jpg", ".jpeg"]), file);

/** @param {File} file */
export const putCalibration = (file) => put("calibrations", plain(file.name, [".toml", ".yaml", ".yml", ".m"]), new Blob([file], { type: "text/plain" }));

/** The address of a picture that the daemon keeps; null if it serves none. @param {KeptFile} of */
export function pictureAt({ file }) {
  const [, folder, name] = /(?:^|\/)(pictures|prints)\/([^/]+)$/.exec(file) ?? [];
  return folder === undefined ? null : `./api/v1/${folder}/${name}`;
}
