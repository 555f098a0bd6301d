// Checks that the page shows each picture with its own record, and always the newest, however slow
// it is and however long it is open. Each picture of the clip carries its number as black and white
// squares, which the browser reads back from what it drew. For an hour:
//   PAGE_SOAK_S=3600 node --test --test-name-pattern="each shown picture" \
//       tests/page/identity.test.mjs
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { pageOf } from "./browser.mjs";
import { SOAK_S, played, prepareNumbered } from "./daemon.mjs";

/**
 * Frames to compare while the browser is slowed down, and seconds after which fewer are enough: a
 * busy machine shows few.
 */
const COMPARED = 1000;
const LONG_ENOUGH_S = 150;
/** How much the browser is slowed down. */
const THROTTLED = 6;
/** Seconds without that at the end. */
const AS_IT_IS_S = 20;
/** Fewer frames than this say nothing. */
const SOME = 20;
/** Seconds between two looks at its memory, and bytes that it may grow by. */
const LOOKS_S = 20;
const GROWS = 10e6;

const on = played("run-numbered", prepareNumbered, "clip", ["--log", "error", "--poses", "poses.jsonl"]);

/** Nanoseconds to add to a monotonic stamp to get the machine's calendar time. */
const clocks = () => Date.now() - Number(process.hrtime.bigint()) / 1e6;
const quantile = (values, share) => [...values].sort((a, b) => a - b)[Math.floor(share * (values.length - 1))];

/**
 * Makes the page read the number of each picture that it draws; `taken` returns those since the
 * last call.
 */
function watched(page) {
  return page.evaluate(
    async ([bits, square]) => {
      const { painters } = await import("/daemon.js");
      const canvas = document.querySelector(".picture canvas");
      const context = canvas.getContext("2d");
      globalThis.found = [];
      painters.add((_, { record }) => {
        const drawn = performance.timeOrigin + performance.now();
        const { data } = context.getImageData(0, canvas.height - square, bits * square, square);
        let number = 0;
        for (let bit = 0; bit < bits; bit += 1) {
          const at = 4 * ((square / 2) * bits * square + bit * square + square / 2);
          number = 2 * number + (data[at] > 127 ? 1 : 0);
        }
        globalThis.found.push({ number, sequence: record.sequence, timestamp_ns: record.timestamp_ns, drawn, at: performance.timeOrigin + performance.now() });
      });
    },
    [on.place.bits, on.place.square],
  );
}
const taken = (page) => page.evaluate(() => globalThis.found.splice(0));

test("each shown picture is that of its record, also where the browser is slow, and a page that stays open does not grow", { timeout: 1000 * (SOAK_S + 480) }, async () => {
  // Little is drawn around the picture: a browser without a graphics card shows more of them.
  const { page, complaints, close } = await pageOf(on.browser, on.place.address, { viewport: { width: 480, height: 360 } });
  const client = await page.context().newCDPSession(page);
  await client.send("Performance.enable");
  const heap = async () => {
    await client.send("HeapProfiler.collectGarbage");
    const { metrics } = await client.send("Performance.getMetrics");
    return metrics.find(({ name }) => name === "JSHeapUsedSize").value;
  };
  const offset = clocks();
  await watched(page);
  await client.send("Emulation.setCPUThrottlingRate", { rate: THROTTLED });
  const [begun, found, slow, heaps, memory] = [Date.now(), [], [], [], []];
  const since = () => (Date.now() - begun) / 1000;
  let asItIs = Infinity;
  while (since() < Math.max(SOAK_S, asItIs + AS_IT_IS_S) || found.length < SOME) {
    await new Promise((done) => setTimeout(done, 2000));
    const now = await taken(page);
    found.push(...now);
    if (asItIs === Infinity) slow.push(...now);
    if (asItIs === Infinity && (slow.length >= COMPARED || since() > LONG_ENOUGH_S)) {
      await client.send("Emulation.setCPUThrottlingRate", { rate: 1 });
      asItIs = since();
    }
    // What it remembers of the last minute is there after a minute.
    if (since() > 60 + LOOKS_S * heaps.length) {
      heaps.push(await heap());
      memory.push(on.daemon.memory());
    }
    assert.ok(since() < SOAK_S + 420, `only ${found.length} pictures were shown`);
  }
  // A record's stamp determines its picture, whatever the daemon skipped: the rate is constant.
  const [first] = found;
  const expected = ({ timestamp_ns }) => (first.number + Math.round(((timestamp_ns - first.timestamp_ns) * on.place.rate) / 1e9)) % on.place.numbers;
  assert.deepEqual(found.filter((one) => one.number !== expected(one)), []);
  assert.ok(new Set(found.map(({ number }) => number)).size > SOME / 2, "the pictures go on");
  // And the record is the one that the daemon wrote.
  const written = new Map(readFileSync(join(on.place.folder, "poses.jsonl"), "utf8").split("\n").slice(0, -1).map((line) => JSON.parse(line)).map(({ sequence, timestamp_ns }) => [sequence, timestamp_ns]));
  assert.deepEqual(found.filter(({ sequence, timestamp_ns }) => written.has(sequence) && written.get(sequence) !== timestamp_ns), []);
  const age = (which) => found.slice(slow.length).map((one) => one[which] - (one.timestamp_ns / 1e6 + offset));
  const told = (ages) => `median ${quantile(ages, 0.5)?.toFixed(0)} ms, 90 % ${quantile(ages, 0.9)?.toFixed(0)} ms`;
  console.log(`${found.length} shown pictures in ${since().toFixed(0)} s (${slow.length} of them with the processor slowed down ${THROTTLED} times), rows ${first.sequence} to ${found.at(-1).sequence}: each with its own record`);
  console.log(`a picture's age, not slowed down: when it is drawn ${told(age("drawn"))}; when its number was read back ${told(age("at"))}; a frame takes ${(1000 / on.place.rate).toFixed(0)} ms`);
  const [heapGrown, memoryGrown] = [heaps.at(-1) - heaps[0], memory.at(-1) - memory[0]].map((bytes) => (bytes / 1e6).toFixed(2));
  console.log(`after ${heaps.length} looks in ${since().toFixed(0)} s the page's heap has grown by ${heapGrown} MB of ${(heaps[0] / 1e6).toFixed(1)}, the daemon by ${memoryGrown} MB of ${(memory[0] / 1e6).toFixed(0)}`);
  assert.ok(heaps.length > 1 && heaps.at(-1) - heaps[0] < GROWS, `${heaps}`);
  assert.ok(memory.at(-1) - memory[0] < 16e6, `${memory}`);
  // What the browser says of this test's own reading is none of the page's.
  assert.deepEqual(complaints.filter((one) => !one.includes("getImageData")), []);
  await close();
});

/** Milliseconds that a frame of the slow page takes, and frames that it draws. */
const SLOW = 200;
const DRAWN = 150;

test("a page that draws five a second sees new pictures, not ever older ones, and the daemon keeps none for it", { timeout: 300_000 }, async () => {
  const { page, close } = await pageOf(on.browser, on.place.address, { viewport: { width: 480, height: 360 } });
  const [before, offset] = [on.daemon.memory(), clocks()];
  const found = await page.evaluate(
    ([slow, drawn, longest, some]) =>
      new Promise((done) => {
        const [found, start] = [[], performance.now()];
        import("/daemon.js").then(({ painters }) => {
          const paint = (_, { record }) => {
            found.push({ sequence: record.sequence, at: performance.timeOrigin + performance.now(), timestamp_ns: record.timestamp_ns });
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
    [SLOW, DRAWN, 60_000, SOME],
  );
  const quarter = Math.floor(found.length / 4);
  const ages = found.map(({ at, timestamp_ns }) => at - (timestamp_ns / 1e6 + offset));
  const grown = quantile(ages.slice(-quarter), 0.5) - quantile(ages.slice(0, quarter), 0.5);
  const passed = found.at(-1).sequence - found[0].sequence;
  const [first, last] = [before, on.daemon.memory()].map((bytes) => (bytes / 1e6).toFixed(1));
  console.log(`${found.length} pictures drawn in ${((found.at(-1).at - found[0].at) / 1000).toFixed(0)} s while ${passed} came; age median ${quantile(ages, 0.5).toFixed(0)} ms, at most ${quantile(ages, 1).toFixed(0)} ms, the last are ${grown.toFixed(0)} ms older than the first; the daemon has ${first} MB, then ${last} MB`);
  // Most were skipped. Had they been queued, the last would be older by nearly the whole time.
  assert.ok(passed > 2 * found.length, `${passed}`);
  assert.ok(grown < (found.at(-1).at - found[0].at) / 4, `${grown}`);
  assert.ok(on.daemon.memory() - before < 16e6, `${first} MB, then ${last} MB`);
  await close();
});
