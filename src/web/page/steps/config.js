// The draft as a config, and what it still wants.
import { computed, signal } from "../vendor/signals.js";
import { head } from "../daemon.js";
import { draft } from "./draft.js";
import { EXAMPLES, number } from "./lengths.js";
import { numbers, placed } from "./placing.js";
import { isSide, size } from "./sides.js";
import { lines, list, quoted, written } from "./toml.js";

/** @import { Means } from "../types.js" */
/** @import { Draft, StepName, SurfaceDraft } from "./draft.js" */
/** @import { Table } from "./types.js" */

/** What is there to set a stage up with; null until that is known. */
export const means = signal(/** @type {Means | null} */ (null));

/** Limits of a field of view that a lens has, degrees. */
const FOV = [5, 170];

/** The picture of a surface. @param {SurfaceDraft} of */
export const picture = ({ door, artwork, photo }) => (door === "freeze" ? photo : artwork);

/** What a surface is called. @param {number} k */
export const nameOf = (k) => `Surface ${k + 1}`;

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
  if (kind === "config") return "";
  if (kind === "guess") {
    const degrees = number(fov);
    return degrees !== null && degrees >= FOV[0] && degrees <= FOV[1] ? "" : `Type the degrees across the picture's width, ${FOV[0]} to ${FOV[1]}. A webcam has 60 to 80.`;
  }
  if (calibration === null) return kind === "board" ? "Take pictures of the board and compute the lens, or guess its field of view." : "Choose the calibration file of this camera, or guess its field of view.";
  const isKnown = shape.value !== null && calibration.height > 0;
  const off = isKnown ? calibration.width / calibration.height / Number(shape.value) : 1;
  return Math.abs(off - 1) < 0.01 ? "" : `The calibration is for pictures of ${calibration.width} x ${calibration.height}, but the camera's have another shape. Choose the file that was made in this mode of this camera.`;
}

/**
 * The first wish of a surface, with its name where there are several.
 * @param {Draft} of
 * @param {(surface: SurfaceDraft, k: number) => string} wants
 */
function first({ surfaces }, wants) {
  const all = surfaces.map(wants);
  const k = all.findIndex((one) => one !== "");
  if (k < 0) return "";
  return surfaces.length === 1 ? all[k] : `${nameOf(k)}: ${all[k]}`;
}

/** @param {SurfaceDraft} of */
function look({ door, artwork, photo, corners }) {
  if (door === "poster") return artwork === null ? "Make the poster, print it and hang it." : "";
  if (door === "artwork") return artwork === null ? "Choose the picture that the surface shows, as it was printed or painted." : "";
  if (photo === null) return "Point the camera at the surface, keep it still, and freeze the picture.";
  return isConvex(corners) ? "" : "The corners do not go round the surface. Place them clockwise: top left, top right, bottom right, bottom left.";
}

/** @param {SurfaceDraft} of @param {number} k */
function stands({ place, turn }, k) {
  return k === 0 || (numbers(place) !== null && number(turn) !== null) ? "" : "Type where its centre is, in metres from the centre of the first surface.";
}

/** @param {Draft} of */
const stage = (of) => first(of, look) || first(of, stands);

/** Whether the corners go clockwise round a convex shape. @param {number[][]} corners */
export function isConvex(corners) {
  return corners.length === 4 && corners.every(([x, y], k) => {
    const [[nx, ny], [ox, oy]] = [corners[(k + 1) % 4], corners[(k + 2) % 4]];
    return (nx - x) * (oy - ny) - (ny - y) * (ox - nx) > 0;
  });
}

/** @param {Draft} of */
function sizes(of) {
  const words = `Type width and height of what the picture shows, in ${{ m: "metres", cm: "centimetres", ft: "feet and inches" }[of.unit]}, such as ${EXAMPLES[of.unit]}.`;
  return first(of, (_, k) => (size(of, k).every(isSide) ? "" : words));
}

/** @param {Draft} of */
function origin(of) {
  if (of.origin === "points" && new Set(of.points.map(({ point }) => point)).size < of.points.length) return "Choose three different points.";
  if (placed(of) !== null || !size(of, 0).every(isSide)) return "";
  return of.origin === "points" ? "Type where the three points are, in metres: to the right, upstage and up." : "Type where the point is, in metres: to the right, upstage and up. The origin itself is 0, 0, 0.";
}

/** The config; null while a step wants something. */
export const config = computed(() => (Object.values(wanting.value).every((wants) => wants === "") ? asText(draft.value, means.value) : null));

/** @param {Draft} of @param {Means | null} from @returns {string} */
function asText(of, from) {
  const { more } = of;
  const places = (placed(of) ?? []).map(({ name, at }) => `${quoted(name)} = ${list(at)}`);
  const controls = of.controls && Object.keys(of.controls).length > 0 ? Object.fromEntries(Object.entries(of.controls).map(([name, value]) => [name, `${value}`])) : null;
  const values = {
    ...(of.device === null || from?.plays ? {} : { device: quoted(of.device) }),
    ...lensValues(of),
    ...more.camera,
    ...(controls === null ? {} : { controls }),
  };
  const http = { ...(from?.listens ? { listen: quoted(from.listens) } : {}), ...more.http };
  const text = [
    "# Written by the page's set-up.",
    "[camera]",
    ...lines(values, ["camera"]),
    "",
    "[stage]",
    ...(places.length === 0 ? [] : [`origin = { ${places.join(", ")} }`]),
    ...lines({ ...more.stage, surface: of.surfaces.map((surface, k) => surfaceValues(of, surface, k)) }, ["stage"]),
    ...(Object.keys(http).length === 0 ? [] : ["", "[http]", ...lines(http, ["http"])]),
    ...of.outputs.flatMap(({ kind, to, more: rest }, k) => ["", "[[output]]", ...lines(rest ?? { kind: quoted(kind), name: quoted(`${kind}-${k + 1}`), to: `[${quoted(to)}]` }, ["output"])]),
    ...lines(more.tables, []),
  ];
  return `${text.join("\n")}\n`;
}

/** @param {Draft} of @returns {Table} */
function lensValues({ lens: kind, fov, calibration }) {
  if (kind === "config") return {};
  return kind === "guess" ? { fov_deg: written(number(fov) ?? 0) } : { calibration: quoted(calibration?.file ?? "") };
}

/** @param {Draft} of @param {SurfaceDraft} surface @param {number} k @returns {Table} */
function surfaceValues(of, surface, k) {
  const { corners, photo, artwork, door, more, place, turn } = surface;
  const pairs = corners.map((corner) => `[${corner.map((value) => `${Number(value.toFixed(2))}`).join(", ")}]`);
  /** @type {Table} */
  const own = of.lens === "file" || of.lens === "board" ? { photo_calibration: quoted(of.calibration?.file ?? "") } : {};
  /** @type {Table} */
  const looks = door === "freeze" ? { photo: quoted(photo?.file ?? ""), corners_px: `[${pairs.join(", ")}]`, ...own } : { image: quoted(artwork?.file ?? "") };
  /** @type {Table} */
  const placing = k === 0 ? {} : { position_m: list(numbers(place) ?? [0, 0, 0]), ...(number(turn) ? { rotation_deg: list([number(turn) ?? 0, 0, 0]) } : {}) };
  return { ...looks, size_m: list(size(of, k).map((side) => side ?? 0)), ...placing, ...more };
}
