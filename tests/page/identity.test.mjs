// Whether the page shows the record of the very picture that it shows, and how old that picture is: each picture of the played clip carries its number
// as a row of black and white squares, which the browser reads back from what it drew.
import assert from "node:assert/strict";
import { test } from "node:test";
import { pageOf } from "./browser.mjs";
import { played, prepareNumbered } from "./daemon.mjs";

/** Shown frames that are compared. */
const COMPARED = 1000;

const on = played("run-numbered", prepareNumbered, "clip");

/** Reads the numbers of the next shown pictures beside those of their records, and when they were drawn.
 * @param {import("playwright-core").Page} page @param {number} count */
function compared(page, count) {
  return page.evaluate(
    ([count, bits, square]) =>
      new Promise((done) => {
        const found = [];
        import("/daemon.js").then(({ painters }) => {
          const canvas = document.querySelector(".picture canvas");
          const context = canvas.getContext("2d");
          const paint = (_, { record }) => {
            const { data } = context.getImageData(0, canvas.height - square, bits * square, square);
            let number = 0;
            for (let bit = 0; bit < bits; bit += 1) {
              const at = 4 * ((square / 2) * bits * square + bit * square + square / 2);
              number = 2 * number + (data[at] > 127 ? 1 : 0);
            }
            found.push({ number, sequence: record.sequence, timestamp_ns: record.timestamp_ns, at: performance.timeOrigin + performance.now() });
            if (found.length === count) {
              painters.delete(paint);
              done(found);
            }
          };
          painters.add(paint);
        });
      }),
    [count, on.place.bits, on.place.square],
  );
}

test("each shown picture is that of its record, also where the browser is slow", { timeout: 180_000 }, async () => {
  const { page, close } = await pageOf(on.browser, on.place.address);
  const client = await page.context().newCDPSession(page);
  await client.send("Emulation.setCPUThrottlingRate", { rate: 6 });
  const found = await compared(page, COMPARED);
  assert.deepEqual(found.filter(({ number, sequence }) => number !== sequence % on.place.numbers), []);
  console.log(`${found.length} shown pictures, rows ${found[0].sequence} to ${found.at(-1).sequence}: each with its own record`);
  await close();
});
