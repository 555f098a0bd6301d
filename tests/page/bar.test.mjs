// What the bar says on every view, the list of keys, and the camera's angles.
//   node --test tests/page/bar.test.mjs
import assert from "node:assert/strict";
import { test } from "node:test";
import { panTiltRoll } from "../../src/web/page/lens.js";
import { pageOf } from "./browser.mjs";
import { played, prepareShow } from "./daemon.mjs";

const on = played("run-bar", prepareShow);

/** The product of two quaternions. */
function product([a, b, c, d], [x, y, z, w]) {
  return [d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z];
}

/** A rotation about an axis, degrees. */
function about(axis, degrees) {
  const half = (degrees * Math.PI) / 360;
  return [...axis.map((value) => value * Math.sin(half)), Math.cos(half)];
}

test("pan, tilt and roll are those of the receivers: to the left, up, and clockwise", () => {
  // A level camera that looks upstage: its z is the stage's y, its y points down.
  const level = about([1, 0, 0], -90);
  const [left, up, along] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]];
  for (const [pan, tilt, roll] of [[0, 0, 0], [30, 0, 0], [0, 20, 0], [0, 0, 10], [-150, -35, 5], [170, 80, -60]]) {
    const body = product(product(about(left, pan), about(up, tilt)), about(along, roll));
    const found = panTiltRoll(product(body, level));
    [pan, tilt, roll].forEach((angle, k) => assert.ok(Math.abs(found[k] - angle) < 1e-9, `${found} is not ${[pan, tilt, roll]}`));
  }
});

test("Live has the angles; a recording is said on every view; the keys open over the view", async () => {
  const { page, complaints, close } = await pageOf(on.browser, on.place.address);
  for (const name of ["Pan", "Tilt", "Roll"]) await page.locator(".facts div", { hasText: new RegExp(`^${name}\u2212?\\d+\\.\\d`) }).waitFor();
  const rec = page.locator("header .rec");
  assert.equal(await rec.count(), 0);
  await page.evaluate(async () => (await import("/ask.js")).post("recordings/start"));
  await rec.getByText(/REC 0:0[1-9]/).waitFor();
  // Also where the page comes later.
  await page.reload();
  await rec.waitFor();
  await page.keyboard.press("5");
  await page.getByRole("heading", { name: "Parts" }).waitFor();
  await rec.waitFor();
  await page.evaluate(async () => (await import("/ask.js")).post("recordings/stop"));
  await rec.waitFor({ state: "detached" });
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.keyboard.press("?");
  const { y, height } = await page.getByRole("region", { name: "Keys" }).boundingBox();
  assert.ok(y >= 0 && y + height <= 800, `${y} and ${height}`);
  await page.keyboard.press("Escape");
  await page.getByRole("region", { name: "Keys" }).waitFor({ state: "detached" });
  assert.deepEqual(complaints, []);
  await close();
});
