// The clock that the page shows to a camera. Requirements: page.test.mjs.
import assert from "node:assert/strict";
import { test } from "node:test";
import { pageOf } from "./browser.mjs";
import { played, prepareShow } from "./daemon.mjs";

const on = played("run-clock", prepareShow, undefined, []);

test("the code is the one that the program reads", async () => {
  const { page, close } = await pageOf(on.browser, on.place.address, { view: "health" });
  const rows = await page.evaluate(async () => (await import("/clock.js")).cells(123_456_789).map((row) => row.map((white) => (white ? " " : "#")).join("")));
  // The same rows as in src/delay/filmed_clock/layout.rs.
  assert.deepEqual(rows, [
    "##################",
    "##               #",
    "#      ##   # #  #",
    "# #####  ### # # #",
    "# ###  #    ## # #",
    "#    ## ####  #  #",
    "#                #",
    "##################",
  ]);
  await close();
});

test("the clock covers the page, shows the daemon's time, and goes with Escape", async () => {
  const { page, complaints, close } = await pageOf(on.browser, on.place.address, { view: "health" });
  await page.getByRole("button", { name: "Show the clock" }).click();
  const clock = page.getByRole("img", { name: /The time as black and white cells/ });
  await clock.waitFor();
  const shown = () =>
    page.evaluate(() => {
      const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector("canvas.clock"));
      const cell = Math.floor(Math.min(canvas.width / 20, canvas.height / 10));
      const [left, top] = [Math.round((canvas.width - cell * 18) / 2), Math.round((canvas.height - cell * 8) / 2)];
      const context = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
      context.drawImage(canvas, 0, 0);
      const isWhite = (column, row) => context.getImageData(left + cell * (column + 0.5), top + cell * (row + 0.5), 1, 1).data[0] > 127;
      let gray = 0;
      for (let bit = 0; bit < 28; bit += 1) {
        const [column, row] = [2 + (bit % 14), 2 + 2 * Math.floor(bit / 14)];
        if (isWhite(column, row) === isWhite(column, row + 1)) return null;
        if (isWhite(column, row)) gray |= 1 << bit;
      }
      const code = [1, 2, 4, 8, 16].reduce((number, shift) => number ^ (number >>> shift), gray);
      return { code, now: Date.now() % 2 ** 28, covers: canvas.clientWidth === innerWidth && canvas.clientHeight === innerHeight };
    });
  let seen = null;
  for (let k = 0; k < 100 && seen === null; k += 1) {
    seen = await shown();
    await page.waitForTimeout(50);
  }
  assert.ok(seen !== null && seen.covers, JSON.stringify(seen));
  // A busy machine paints late, and both run here: the browser's clock is the daemon's.
  assert.ok(Math.abs(seen.now - seen.code) < 2000, JSON.stringify(seen));
  const later = await shown();
  assert.notEqual(later?.code, seen.code);
  await page.keyboard.press("Escape");
  await clock.waitFor({ state: "detached" });
  assert.deepEqual(complaints, []);
  await close();
});
