// Whether the page shows the record of the very picture that it shows, and the newest there is however slow it is: each picture of the played clip carries its number
// as a row of black and white squares, which the browser reads back from what it drew.
import assert from "node:assert/strict";
import { test } from "node:test";
import { pageOf } from "./browser.mjs";
import { played, prepareNumbered } from "./daemon.mjs";

/** Shown frames that are compared, and milliseconds after which those that were shown are enough, if they are some: a busy machine shows few. */
const COMPARED = 1000;
const LONG_ENOUGH = 90_000;
const SOME = 20;

const on = played("run-numbered", prepareNumbered, "clip");

/** Reads the numbers of the next shown pictures beside those of their records, and when they were drawn.
 * @param {import("playwright-core").Page} page @param {number} count */
function compared(page, count) {
  return page.evaluate(
    ([count, bits, square, longest, some]) =>
      new Promise((done) => {
        const [found, begun] = [[], performance.now()];
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
            if (found.length === count || (found.length >= some && performance.now() - begun > longest)) {
              painters.delete(paint);
              done(found);
            }
          };
          painters.add(paint);
        });
      }),
    [count, on.place.bits, on.place.square, LONG_ENOUGH, SOME],
  );
}

test("each shown picture is that of its record, also where the browser is slow", { timeout: 600_000 }, async () => {
  const { page, close } = await pageOf(on.browser, on.place.address);
  const client = await page.context().newCDPSession(page);
  await client.send("Emulation.setCPUThrottlingRate", { rate: 6 });
  const found = await compared(page, COMPARED);
  // A record's stamp tells the picture that it is of, whatever the daemon has passed over: they come at one rate.
  const [first] = found;
  const expected = ({ timestamp_ns }) => (first.number + Math.round(((timestamp_ns - first.timestamp_ns) * on.place.rate) / 1e9)) % on.place.numbers;
  assert.deepEqual(found.filter((one) => one.number !== expected(one)), []);
  assert.ok(new Set(found.map(({ number }) => number)).size > SOME / 2, "the pictures go on");
  console.log(`${found.length} shown pictures, rows ${found[0].sequence} to ${found.at(-1).sequence}: each with its own record`);
  await close();
});

/** Milliseconds that a frame of the slow page takes, and frames that it draws. */
const SLOW = 200;
const DRAWN = 80;

test("a page that draws five a second sees new pictures, not ever older ones, and the daemon keeps none for it", { timeout: 300_000 }, async () => {
  const { page, close } = await pageOf(on.browser, on.place.address);
  const before = on.daemon.memory();
  const found = await page.evaluate(
    ([slow, drawn, longest, some]) =>
      new Promise((done) => {
        const [found, start] = [[], performance.now()];
        import("/daemon.js").then(({ painters }) => {
          const paint = (_, { record }) => {
            // Ages by two clocks: their difference is the same for all.
            found.push({ sequence: record.sequence, at: performance.now(), age: performance.now() - record.timestamp_ns / 1e6 });
            const begun = performance.now();
            while (performance.now() - begun < slow);
            if (found.length === drawn || (found.length >= some && performance.now() - start > longest)) {
              painters.delete(paint);
              done(found);
            }
          };
          painters.add(paint);
        });
      }),
    [SLOW, DRAWN, LONG_ENOUGH, SOME],
  );
  const median = (values) => values.toSorted((a, b) => a - b)[Math.floor(values.length / 2)];
  const quarter = Math.floor(found.length / 4);
  const ages = found.map(({ age }) => age);
  const grown = median(ages.slice(-quarter)) - median(ages.slice(0, quarter));
  const passed = found.at(-1).sequence - found[0].sequence;
  const [first, last] = [before, on.daemon.memory()].map((bytes) => (bytes / 1e6).toFixed(1));
  console.log(`${found.length} pictures drawn while ${passed} came; the last are ${grown.toFixed(0)} ms older than the first; the daemon has ${first} MB, then ${last} MB`);
  // Most were passed over; had they been queued, the last would be older by nearly all the time that the others took.
  assert.ok(passed > 2 * found.length, `${passed}`);
  assert.ok(grown < (found.at(-1).at - found[0].at) / 4, `${grown}`);
  assert.ok(on.daemon.memory() - before < 16e6, `${first} MB, then ${last} MB`);
  await close();
});
