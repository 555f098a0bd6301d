// The set-up's steps as pure functions: where the origin is, what findings ask for, what is wrong with
// a picture, what a walk lacks, and how a config is written. No browser and no daemon is needed.
//   node --test tests/page/steps.test.mjs
import assert from "node:assert/strict";
import { test } from "node:test";
import { edgeWidth, faults } from "../../src/web/page/steps/faults.js";
import { automatic } from "../../src/web/page/steps/locks.js";
import { CLICKED, axes, contradiction, placed } from "../../src/web/page/steps/placing.js";
import { remedies } from "../../src/web/page/steps/remedies.js";
import { lines, list } from "../../src/web/page/steps/toml.js";
import { seenFrom } from "../../src/web/page/steps/walked.js";

const SURFACE = { width: "4", height: "3", door: "artwork", corners: [], former: [] };
const DRAFT = { surfaces: [SURFACE], surface: 0, unit: "m", origin: "point", point: "bottom", at: ["0", "0", "0"], turn: "0", clicked: null, points: [], lens: "guess", more: { camera: {} } };
const near = (a, b, within = 1e-9) => assert.ok(a.every((value, k) => Math.abs(value - b[k]) <= within), `${a} is not ${b}`);

test("one point places the surface, turned or not, wherever on its picture it was clicked", () => {
  assert.deepEqual(placed({ ...DRAFT, at: ["0,5", "1", "0"] }), [{ name: "bottom", at: [0.5, 1, 0] }]);
  assert.equal(placed({ ...DRAFT, at: ["", "1", "0"] }), null);
  // A quarter to the left: the right side goes upstage.
  const [left, right, top] = placed({ ...DRAFT, turn: "90" });
  near(left.at, [0, -2, 0]);
  near(right.at, [0, 2, 0]);
  near(top.at, [0, -2, 3]);
  // A quarter of the width from the left, a third of the height from the top.
  const [centre] = placed({ ...DRAFT, point: CLICKED, clicked: [0.25, 1 / 3] });
  assert.equal(centre.name, "centre");
  near(centre.at, [1, 0, -0.5]);
});

test("three points place the surface to a tenth of a millimetre, and lengths that contradict are found", () => {
  const angle = (25 * Math.PI) / 180;
  const at = (x, z) => [1.2 + x * Math.cos(angle), 3.4 + x * Math.sin(angle), 0.25 + z].map((value) => value.toFixed(4));
  const points = [["bottom left", -2, 0], ["bottom right", 2, 0], ["top", 0, 3]].map(([point, x, z]) => ({ point, at: at(x, z) }));
  const of = { ...DRAFT, origin: "points", points };
  const by = axes(of);
  near(by.x, [Math.cos(angle), Math.sin(angle), 0], 1e-4);
  near(by.y, [0, 0, 1], 1e-4);
  near(by.centre, [1.2, 3.4, 1.75], 2e-4);
  assert.ok(contradiction(placed(of), [4, 3]).share < 1e-4);
  const worst = contradiction(placed(of), [4.2, 3]);
  assert.deepEqual(worst.names, ["bottom left", "bottom right"]);
  assert.equal(axes({ ...of, points: points.map((one) => ({ ...one, point: "top" })) }), null, "one point three times");
});

test("a finding's line becomes a change, and nothing else does", () => {
  const of = { ...DRAFT, surfaces: [SURFACE, { ...SURFACE, door: "freeze", corners: [[1, 1]] }], fov: "60" };
  const titles = (message) => remedies(message, of).map(({ title }) => title);
  const [sizes] = remedies("width and height are swapped: write size_m = [3.0, 4.0]", of);
  assert.deepEqual(sizes.part.surfaces.map(({ width, height }) => [width, height]), [["3", "4"], ["4", "3"]]);
  const [readout] = remedies("another time fits: write readout_s = 0.0123 below [camera] (tried: 40 of 40)", of);
  assert.deepEqual(readout.part.more.camera, { readout_s: "0.0123" });
  assert.equal(remedies("write `fov_deg = 75.1`", of)[0].part.fov, "75.1");
  assert.deepEqual(remedies("write fov_deg = 75.1", { ...of, lens: "file" }), [], "there is no guess to change");
  const [corners] = remedies("surface 2: write corners_px = [[1, 2], [3.5, 4], [5, 6], [7, 8]]", of);
  assert.deepEqual(corners.part.surfaces[1].corners, [[1, 2], [3.5, 4], [5, 6], [7, 8]]);
  assert.deepEqual(corners.part.surfaces[1].former, [[[1, 1]]], "it can be taken back");
  assert.deepEqual(titles("surface 9: write size_m = [1.0, 2.0]"), []);
  assert.deepEqual(titles("write corners_px = [[1, 2], [3, 4]]"), []);
  assert.deepEqual(titles("write it down; write name = 3; size_m is wrong"), []);
});

/** A picture of stripes, `rise` pixels wide at their edges. */
function striped(level, range, rise, width = 160, height = 90) {
  const at = (x) => Math.min(Math.max((((x % 40) - 20) / rise) + 0.5, 0), 1) * (x % 80 < 40 ? 1 : -1) + (x % 80 < 40 ? 0 : 1);
  return { grey: Float32Array.from({ length: width * height }, (_, k) => level + range * at(k % width)), width, height };
}

test("dark, white, blurred and flickering pictures are named, a good one is not", () => {
  const good = striped(60, 120, 2);
  const says = (small, before = small, middle = small) => faults({ small, middle, before }).join(" ");
  assert.equal(says(good), "");
  assert.ok(edgeWidth(good) < 3 && edgeWidth(striped(60, 120, 12)) > 6);
  assert.match(says(striped(5, 30, 2)), /dark/);
  assert.match(says(striped(150, 110, 2)), /white/);
  assert.match(says(good, good, striped(60, 120, 12)), /blurred/);
  const brighter = (by) => ({ ...good, grey: good.grey.map((level, k) => level + by(Math.floor(k / good.width), k % good.width)) });
  assert.match(says(brighter((y) => 4 * Math.sin(y / 8)), good), /Bands/);
  assert.equal(says(brighter(() => 4), good), "", "all of it brighter is no band");
  assert.equal(says(brighter((_, x) => 4 * Math.sin(x / 8)), good), "", "upright bands are no flicker");
  assert.match(says(brighter((_, x) => (x % 2 ? 40 : -40)), good), /moves/);
  assert.equal(edgeWidth(striped(60, 10, 2)), null, "there is too little to see");
});

test("automatics that run are named", () => {
  const of = (pairs) => Object.entries(pairs).map(([name, value]) => ({ name, value }));
  assert.deepEqual(automatic(of({ auto_exposure: 3, focus_automatic_continuous: 0, white_balance_automatic: 1, brightness: 3 })), ["exposure", "white balance"]);
  assert.deepEqual(automatic(of({ auto_exposure: 1, focus_auto: null })), []);
});

test("a walk is guided to what is missing, until nothing is", () => {
  const aim = { centre: [0, 0, 1.5], width: 4 };
  const walk = (places, more = {}) => seenFrom({ places, frames: places.length, tracked: places.length, blurred: 0, ...more }, aim).wants;
  assert.deepEqual(walk([[0, -4, 1.5]]), ["Go farther to the right.", "Go nearer, and farther away.", "Hold the camera higher, and lower."]);
  const round = Array.from({ length: 41 }, (_, k) => [4 * Math.sin((k - 20) / 40), -4 * Math.cos((k - 20) / 40), 1.5]);
  assert.deepEqual(walk(round), ["Go nearer, and farther away.", "Hold the camera higher, and lower."]);
  const whole = [...round, [0, -5.5, 1.8], [0, -4, 1.5]];
  assert.deepEqual(walk(whole), []);
  assert.deepEqual(walk(whole, { tracked: 20 }), ["Keep the stage in view: it is seen in too few pictures."]);
  assert.deepEqual(walk(whole, { blurred: 30 }), ["Walk and turn more slowly: pictures are blurred."]);
  assert.deepEqual(walk([]).length, 3);
});

test("values and tables are written as TOML", () => {
  assert.equal(list([1, -0.5, 2.00004]), "[1.0, -0.5, 2.0]");
  const table = { fps: "30", "odd key": "true", controls: { gain: "3" }, surface: [{ image: '"a.png"' }, { image: '"b.png"', deep: { x: "1" } }] };
  assert.equal(lines(table, ["camera"]).join("\n"), `fps = 30
"odd key" = true

[camera.controls]
gain = 3

[[camera.surface]]
image = "a.png"

[[camera.surface]]
image = "b.png"

[camera.surface.deep]
x = 1`);
});
