// The draft as a config, and what it still wants.
import { computed, signal } from "../vendor/signals.js";
import { head } from "../daemon.js";
import { draft } from "./draft.js";
import { EXAMPLES, metres, number } from "./lengths.js";

/** @import { Means } from "../types.js" */
/** @import { Draft, StepName } from "./draft.js" */

/** What is there to set a stage up with; null until that is known. */
export const means = signal(/** @type {Means | null} */ (null));

/** Limits of a field of view that a lens has, degrees. */
const FOV = [5, 170];
/** A surface's side, metres. */
const SIDE = [0.05, 200];

/** A text in TOML. @param {string} text */
const quoted = (text) => JSON.stringify(text);
/** A number in TOML, to tenths of a millimetre. @param {number} value */
const written = (value) => {
  const text = `${Number(value.toFixed(4))}`;
  return text.includes(".") ? text : `${text}.0`;
};

/** Width and height in metres; null where one is none. @param {Draft} of */
export function size({ width, height, unit }) {
  return [width, height].map((text) => metres(text, unit));
}

/** Whether a length can be a surface's side. @param {number | null} length */
export const isSide = (length) => length !== null && length >= SIDE[0] && length <= SIDE[1];

/** The picture of the stage. @param {Draft} of */
export const picture = ({ door, artwork, photo }) => (door === "artwork" ? artwork : photo);

/** Width over height of the pictures that the camera sends; null before the first. */
const shape = computed(() => (head.value === null ? null : head.value.size[0] / head.value.size[1]));

/** What each step wants, as a sentence with what to do; empty where it has all. */
export const wanting = computed(() => {
  const of = draft.value;
  /** @type {Record<StepName, string>} */
  const wants = { camera: camera(of), lens: lens(of), stage: stage(of), sizes: sizes(of), origin: origin(of), check: "", outputs: "" };
  return wants;
});

/** @param {Draft} of */
function camera({ device }) {
  if (device !== null || means.value === null || means.value.plays !== null) return "";
  return means.value.cameras.length === 0 ? "There is no camera. Plug one in and press “Look again”. To practise, start stagepose setup with --play and a clip." : "Choose a camera.";
}

/** @param {Draft} of */
function lens({ lens: kind, fov, calibration }) {
  if (kind === "guess") {
    const degrees = number(fov);
    return degrees !== null && degrees >= FOV[0] && degrees <= FOV[1] ? "" : `Type the degrees across the picture's width, ${FOV[0]} to ${FOV[1]}. A webcam has 60 to 80.`;
  }
  if (calibration === null) return "Choose the calibration file of this camera, or guess its field of view.";
  const off = shape.value === null ? 1 : (calibration.width / calibration.height) / shape.value;
  return Math.abs(off - 1) < 0.01 ? "" : `The calibration is for pictures of ${calibration.width} x ${calibration.height}, but the camera's have another shape. Choose the file that was made in this mode of this camera.`;
}

/** @param {Draft} of */
function stage({ door, artwork, photo, corners }) {
  if (door === "artwork") return artwork === null ? "Choose the picture that the surface shows, as it was printed or painted." : "";
  if (photo === null) return "Point the camera at the surface, keep it still, and freeze the picture.";
  return isConvex(corners) ? "" : "The corners do not go round the surface. Place them clockwise: top left, top right, bottom right, bottom left.";
}

/** Whether the corners go clockwise round a convex shape. @param {number[][]} corners */
export function isConvex(corners) {
  return corners.length === 4 && corners.every(([x, y], k) => {
    const [[nx, ny], [ox, oy]] = [corners[(k + 1) % 4], corners[(k + 2) % 4]];
    return (nx - x) * (oy - ny) - (ny - y) * (ox - nx) > 0;
  });
}

/** @param {Draft} of */
function sizes(of) {
  if (size(of).every(isSide)) return "";
  return `Type width and height of what the picture shows, in ${{ m: "metres", cm: "centimetres", ft: "feet and inches" }[of.unit]}, such as ${EXAMPLES[of.unit]}.`;
}

/** @param {Draft} of */
function origin({ at }) {
  return at.every((text) => number(text) !== null) ? "" : "Type where the point is, in metres: to the right, upstage and up. The origin itself is 0, 0, 0.";
}

/** The config; null while a step wants something. */
export const config = computed(() => (Object.values(wanting.value).every((wants) => wants === "") ? asText(draft.value, means.value) : null));

/** @param {Draft} of @param {Means | null} from @returns {string} */
function asText(of, from) {
  const [width, height] = size(of).map((side) => written(side ?? 0));
  const at = of.at.map((value) => written(number(value) ?? 0)).join(", ");
  const lines = [
    "# Written by the page's set-up.",
    "[camera]",
    ...(of.device === null || from?.plays ? [] : [`device = ${quoted(of.device)}`]),
    ...lensLines(of),
    ...(of.controls && Object.keys(of.controls).length > 0 ? ["", "[camera.controls]", ...Object.entries(of.controls).map(([name, value]) => `${name} = ${value}`)] : []),
    "",
    "[stage]",
    `origin = { ${quoted(of.point)} = [${at}] }`,
    "",
    "[[stage.surface]]",
    ...surfaceLines(of),
    `size_m = [${width}, ${height}]`,
    ...(from?.listens ? ["", "[http]", `listen = ${quoted(from.listens)}`] : []),
    ...of.outputs.flatMap(({ kind, to }, k) => ["", "[[output]]", `kind = ${quoted(kind)}`, `name = ${quoted(`${kind}-${k + 1}`)}`, `to = [${quoted(to)}]`]),
  ];
  return `${lines.join("\n")}\n`;
}

/** @param {Draft} of */
function lensLines({ lens: kind, fov, calibration }) {
  return kind === "guess" ? [`fov_deg = ${written(number(fov) ?? 0)}`] : [`calibration = ${quoted(calibration?.file ?? "")}`];
}

/** @param {Draft} of */
function surfaceLines({ door, artwork, photo, corners, lens: kind, calibration }) {
  if (door === "artwork") return [`image = ${quoted(artwork?.file ?? "")}`];
  const pairs = corners.map((corner) => `[${corner.map((value) => `${Number(value.toFixed(2))}`).join(", ")}]`);
  const own = kind === "file" ? [`photo_calibration = ${quoted(calibration?.file ?? "")}`] : [];
  return [`photo = ${quoted(photo?.file ?? "")}`, `corners_px = [${pairs.join(", ")}]`, ...own];
}
