// The Recordings view: recording, marking, finding losses, playing. Requirements: page.test.mjs.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { PATIENCE, looksWell, pageOf, until } from "./browser.mjs";
import { played, prepareShow } from "./daemon.mjs";

const on = played("run-recordings", prepareShow);
const opened = (options = {}) => pageOf(on.browser, on.place.address, { view: "recordings", ...options });
const list = async () => (await fetch(`${on.place.address}api/v1/recordings`)).json();
const button = (page, name) => page.getByRole("button", { name, exact: true });
const row = async (page) => Number(await page.getByRole("slider").getAttribute("aria-valuenow"));
/** What is shown, once it is the row that is wanted. */
const shown = (page) =>
  page.evaluate(async () => {
    const { row, shown } = await import("/clip.js");
    while (shown.value?.row !== row.value) await new Promise((done) => setTimeout(done, 20));
    return shown.value;
  });
/** Opens the first recording that was made. */
async function choose(page) {
  await page.locator(".recordings button").last().click();
  await page.getByRole("slider").waitFor();
}
/** The states of all rows of the oldest recording. */
async function records() {
  const { recordings } = await list();
  const text = await (await fetch(`${on.place.address}api/v1/recordings/${recordings.at(-1).id}/poses?from=0&count=5000`)).text();
  return text.trim().split("\n").map((line) => JSON.parse(line));
}

test("nothing is said plainly; a recording is begun, marked and ended, and the last seconds are saved", async () => {
  const { page, complaints, close } = await opened();
  await page.getByText("There are no recordings yet.").waitFor();
  await page.getByText("Not recording.").waitFor();
  await button(page, "Record").click();
  await page.getByText(/^Recording clip-/).waitFor();
  await page.getByLabel("Mark this moment").fill("cue 12 – Ophélie");
  await page.keyboard.press("Enter");
  await page.getByText("Marked.").waitFor();
  assert.equal(await page.getByLabel("Mark this moment").inputValue(), "");
  // Two rounds, so that there are two losses between tracked frames.
  await until(list, ({ recordings }) => recordings[0]?.frames > 2 * on.place.round + 60);
  await button(page, "Stop recording").click();
  await page.getByText("Not recording.").waitFor();
  await page.locator(".recordings li").first().waitFor();
  await page.getByRole("button", { name: /^Save the last 5 s/ }).click();
  await until(() => page.locator(".recordings li").count(), (count) => count === 2);
  assert.equal(await page.locator(".recordings li").count(), 2);
  // As the daemon has it in its folder.
  const { recordings } = await list();
  assert.ok(readFileSync(`${on.place.folder}/recordings/${recordings.at(-1).id}/events.jsonl`, "utf8").includes("cue 12 – Ophélie"));
  assert.deepEqual(complaints, []);
  await close();
});

test("losses are found by button and key, and each shown row has its own record", async () => {
  const { page, complaints, close } = await opened();
  await choose(page);
  const all = await records();
  const isLost = ({ state }) => state !== "tracking" && state !== "coasting";
  const losses = all.map((record, k) => (isLost(record) && (k === 0 || !isLost(all[k - 1])) ? k : -1)).filter((k) => k > 0);
  assert.ok(losses.length >= 2, `${losses}`);
  for (const loss of losses.slice(0, 2)) {
    await button(page, "Next loss").click();
    assert.equal(await until(() => row(page), (now) => now === loss), loss);
    const { record } = await shown(page);
    assert.deepEqual([record.sequence, record.state], [all[loss].sequence, all[loss].state]);
  }
  await page.keyboard.press("j");
  assert.equal(await until(() => row(page), (now) => now === losses[0]), losses[0]);
  for (let k = 0; k < 4 && !(await page.locator("figcaption").count()); k += 1) await page.keyboard.press("j");
  const none = page.locator("figcaption", { hasText: "There is no loss before this row." });
  if (!isLost(all[0])) await none.waitFor();
  // A row's picture that comes later does not take back what the search said.
  let release;
  const released = new Promise((done) => (release = done));
  await page.route("**/frame/*", async (route) => {
    await released;
    await route.continue();
  });
  await page.evaluate(async () => (await import("/clip.js")).go(0));
  await page.keyboard.press("j");
  await none.waitFor();
  release();
  assert.equal((await shown(page)).row, 0);
  assert.ok(await none.isVisible());
  await page.unroute("**/frame/*");
  // By its own slider, and by single rows.
  const slider = page.getByRole("slider");
  await slider.focus();
  await page.keyboard.press("Home");
  await page.keyboard.press("Shift+ArrowRight");
  await page.keyboard.press(".");
  await page.keyboard.press(",");
  assert.equal(await row(page), 10);
  const { left, width, top } = await slider.evaluate((one) => one.getBoundingClientRect().toJSON());
  await page.mouse.click(left + width / 2, top + 30);
  assert.ok(Math.abs((await row(page)) - all.length / 2) <= 2);
  for (const k of [0, 17, 40, all.length - 1]) {
    await page.evaluate(async (k) => (await import("/clip.js")).go(k), k);
    const { record, size } = await shown(page);
    assert.deepEqual([record?.sequence, size], [all[k].sequence, [640, 360]]);
  }
  // The mark leads to its row.
  await page.getByRole("button", { name: /cue 12 – Ophélie/ }).click();
  const marked = all.findIndex(({ timestamp_ns }) => timestamp_ns > all[0].timestamp_ns);
  assert.ok((await row(page)) >= marked && (await row(page)) < all.length - 1);
  assert.deepEqual(complaints, []);
  await close();
});

test("outlines lie on the recorded picture, and are gone where nothing was known", async () => {
  const { page, close } = await opened();
  await choose(page);
  const all = await records();
  const covered = async (k) => {
    await page.evaluate(async (k) => (await import("/clip.js")).go(k), k);
    await shown(page);
    return page.evaluate(() => {
      const marks = document.querySelector(".marks");
      return marks.getContext("2d").getImageData(0, 0, marks.width, marks.height).data.filter((alpha, at) => at % 4 === 3 && alpha > 0).length;
    });
  };
  const [known, lost] = [all.findIndex(({ pose }) => pose !== null), all.findIndex(({ pose }) => pose === null)];
  const isMany = (count) => count > 1000;
  assert.ok(isMany(await until(() => covered(known), isMany)));
  assert.equal(await covered(lost), 0);
  await close();
});

test("a recording plays at its own pace, slower and faster, to its end", async () => {
  const { page, complaints, close } = await opened();
  await choose(page);
  const stamps = (await records()).map(({ timestamp_ns }, _, all) => (timestamp_ns - all[0].timestamp_ns) / 1e6);
  // A starved browser paints seldom: here the test drives its clock, a tenth of a second per tick.
  await page.evaluate(() => {
    let [waiting, now, count] = [new Map(), 0, 0];
    globalThis.requestAnimationFrame = (act) => waiting.set((count += 1), act) && count;
    globalThis.cancelAnimationFrame = (id) => waiting.delete(id);
    globalThis.tick = async () => {
      const acts = [...waiting.values()];
      waiting = new Map();
      now += 100;
      for (const act of acts) act(now);
      await new Promise((done) => setTimeout(done, 5));
    };
  });
  for (const [speed, ticks] of [[0.1, 60], [1, 12], [8, 5]]) {
    await page.getByLabel("Speed").selectOption(`${speed}`);
    await page.evaluate(async () => (await import("/clip.js")).go(0));
    await page.getByRole("button", { name: "Play", exact: true }).click();
    const [from, to] = await page.evaluate(async (ticks) => {
      const { row } = await import("/clip.js");
      // Time begins when the stamps are known.
      while (row.value === 0) await globalThis.tick();
      const from = row.value;
      for (let k = 0; k < ticks; k += 1) await globalThis.tick();
      return [from, row.value];
    }, ticks);
    await page.getByRole("button", { name: "Stop", exact: true }).click();
    // The first row was reached within the tick that showed it.
    const at = (time) => stamps.findLastIndex((stamp) => stamp <= time);
    const [least, most] = [at(stamps[from] + 100 * speed * ticks), at(stamps[from] + 100 * speed * (ticks + 1))];
    assert.ok(least <= to && to <= most, `at ${speed} from ${from} to ${to}, not ${least} to ${most}`);
  }
  await page.reload();
  await choose(page);
  await page.getByLabel("Speed").selectOption("8");
  await page.keyboard.press("k");
  assert.equal(await until(() => row(page), (now) => now === stamps.length - 1), stamps.length - 1);
  await page.getByRole("button", { name: "Play" }).waitFor();
  assert.deepEqual(complaints, []);
  await close();
});

test("a recording is downloaded as a zip with all of it", async () => {
  const { page, close } = await opened();
  const waited = page.waitForEvent("download");
  await page.getByRole("link", { name: /^Download clip-/ }).last().click();
  const download = await waited;
  assert.match(download.suggestedFilename(), /^clip-.*\.zip$/);
  const bytes = readFileSync(await download.path());
  for (const name of ["timestamps.csv", "poses.jsonl", "events.jsonl", "clip.toml"]) assert.ok(bytes.includes(name), name);
  await close();
});

test("a recording is tracked again with today's config and compared with what was recorded", async () => {
  const { page, complaints, close } = await opened();
  await choose(page);
  const all = await records();
  assert.equal(await page.locator(".timeline.today").count(), 0);
  await button(page, "Track it again").focus();
  await page.keyboard.press("Enter");
  const table = page.locator(".retracking table");
  // It stands back behind the tracker, and behind a browser without a graphics card.
  await table.waitFor({ timeout: 4 * PATIENCE });
  assert.equal(await page.locator(".retracking progress").count(), 0);
  await page.locator(".timeline.today canvas").waitFor();
  // The numbers are those of the records: the recorded ones as the page reads them, today's from
  // the daemon's files.
  const { recordings } = await list();
  const { id } = recordings.at(-1);
  const text = await (await fetch(`${on.place.address}api/v1/recordings/${id}/retracked/poses?from=0&count=5000`)).text();
  const today = text.trim().split("\n").map((line) => JSON.parse(line));
  const tracked = (records) => `${records.filter(({ state }) => state === "tracking").length} of ${records.length}`;
  const cells = await table.locator("tbody tr").first().locator("td").allTextContents();
  assert.deepEqual(cells, [tracked(all), tracked(today)]);
  // Each row has both records; by key the outlines are those of the one or of the other.
  const k = all.findIndex(({ state }, row) => row > 5 && state === "tracking" && today[row].state === "tracking");
  await page.evaluate(async (k) => (await import("/clip.js")).go(k), k);
  const both = await until(() => shown(page), ({ today }) => today !== null);
  assert.deepEqual([both.record.sequence, both.today.sequence, both.today.pose], [all[k].sequence, today[k].sequence, today[k].pose]);
  const apart = 1000 * Math.hypot(...all[k].pose.position_m.map((value, axis) => value - today[k].pose.position_m[axis]));
  await page.locator(".facts div", { hasText: `Distance${apart.toFixed(2)}` }).waitFor();
  await page.keyboard.press("b");
  assert.equal(await page.getByRole("radio", { name: "today" }).isChecked(), true);
  await page.keyboard.press("b");
  assert.equal(await page.getByRole("radio", { name: "recorded" }).isChecked(), true);
  // The next row that differs, as the two say.
  const differs = all.findIndex(({ state }, row) => row > k && state !== today[row].state);
  await page.keyboard.press("d");
  if (differs > 0) {
    const at = await until(() => row(page), (now) => now !== k);
    assert.ok(at > k && at <= differs, `${at} of ${differs}`);
  }
  // It is there when the recording is opened anew.
  await page.reload();
  await choose(page);
  await table.waitFor();
  assert.deepEqual(complaints, []);
  await close();
});

test("the report of a fault is downloaded with and without pictures", async () => {
  const { page, close } = await opened();
  await choose(page);
  const bytes = [];
  for (const name of ["Without pictures", /^With the last/]) {
    const waited = page.waitForEvent("download");
    await page.getByRole("link", { name }).click();
    const download = await waited;
    assert.match(download.suggestedFilename(), /^report-clip-.*\.zip$/);
    bytes.push(readFileSync(await download.path()));
  }
  for (const name of ["about.txt", "config/stage.toml", "daemon/diagnostics.txt", "recording/poses.jsonl"]) assert.ok(bytes[0].includes(name), name);
  assert.ok(!bytes[0].includes(".jpg") && bytes[1].includes("recording/frames/"), "pictures come where they are asked for");
  await close();
});

test("the view is accessible in every theme and width", async () => {
  const { page, close } = await opened({ bypassCSP: true });
  await choose(page);
  await button(page, "Next loss").click();
  await shown(page);
  // A row after it that is tracked again.
  const all = await records();
  const from = await row(page);
  await page.evaluate(async (k) => (await import("/clip.js")).go(k), all.findIndex(({ state }, k) => k > from && state === "tracking"));
  await shown(page);
  await looksWell(on.browser, page, "recordings");
  await close();
});
