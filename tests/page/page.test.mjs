// The page in a true browser, served by a true daemon.
//   STAGEPOSE=target/release/stagepose PAGE_OUT=target/page node --test tests/page/page.test.mjs
// PAGE_OUT has node_modules with what package.json names, and gets a screenshot of every theme and
// width. CHROMIUM names another browser. With PAGE_DIR=src/web/page the page's files come from
// there, to try a change before it is built.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { freeze, looksWell, out, pageOf, says, share as shareOf, until } from "./browser.mjs";
import { played, prepareCovered, start } from "./daemon.mjs";

const on = played("run");

/** A page that has shown the first frame that is tracked. */
async function opened(options = {}) {
  const found = await pageOf(on.browser, on.place.address, options);
  // The state may be known before the first frame is drawn.
  await found.page.locator(".facts div", { hasText: /^Frame\d+$/ }).waitFor();
  return found;
}

const share = (png, condition) => shareOf(on.browser, png, condition);
const frame = async (page) => Number(await page.locator(".facts div", { hasText: /^Frame/ }).locator("dd").textContent());
/** Waits for a frame after this one; a second without any shows no number. */
const goesOn = (page, from) => until(() => frame(page), (now) => now > from);

test("the page loads from its own server alone and shows what is tracked", async () => {
  const { page, complaints, asked, close } = await opened();
  assert.deepEqual([...asked], [new URL(on.place.address).host]);
  // The picture is there, and goes on.
  const first = await goesOn(page, -1);
  assert.ok((await goesOn(page, first + 5)) > first + 5);
  const colours = await page.evaluate(() => {
    const canvas = document.querySelector(".picture canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return { width: canvas.width, levels: new Set(data.filter((_, k) => k % 4 === 0)).size };
  });
  assert.equal(colours.width, 640);
  assert.ok(colours.levels > 100, `${colours.levels} levels`);
  // On a busy machine there may be a second without a frame, and then there is no place to show.
  await page.locator(".facts div", { hasText: /^Upstage\u2212\d\.\d{3}\sm$/ }).waitFor();
  // What happened is listed, the newest first.
  const list = page.locator(".happened li");
  await list.filter({ hasText: "long.mjpeg is open: MJPG 640x360" }).first().waitFor();
  await list.filter({ hasText: "Tracked after" }).first().waitFor();
  const listed = await list.allTextContents();
  const [opening, finding] = ["is open", "Tracked after"].map((words) => listed.findLastIndex((text) => text.includes(words)));
  // On a busy machine more may have happened since.
  assert.ok(finding >= 0 && finding < opening, listed.join("\n"));
  assert.deepEqual(complaints, []);
  await close();
});

test("outlines are where the lens shows the surfaces", async () => {
  const { page, close } = await opened();
  const off = await page.evaluate(async () => {
    const [{ pixel, within }, { head, scene }] = await Promise.all([import("/lens.js"), import("/daemon.js")]);
    while (!head.value?.record.homography || !scene.value) await new Promise((done) => setTimeout(done, 20));
    const { record } = head.value;
    const camera = { ...scene.value.camera, distortion: [0, 0, 0, 0, 0], valid_radius: null };
    const corners = scene.value.stage.surfaces[0].outline_m.filter((_, k) => k % 16 === 0);
    // The record's homography must take the artwork's corners to the same undistorted pixels.
    const picture = await (await fetch("/api/v1/scene")).json();
    const [w, h] = picture.stage.surfaces[0].picture_px;
    const by = (u, v) => {
      const m = record.homography;
      const s = m[6] * u + m[7] * v + m[8];
      return [(m[0] * u + m[1] * v + m[2]) / s, (m[3] * u + m[4] * v + m[5]) / s];
    };
    const edges = [[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]];
    return corners.map((corner, k) => {
      const [a, b] = [pixel(camera, within(record.pose, corner)), by(...edges[k])];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    });
  });
  assert.equal(off.length, 4);
  assert.ok(Math.max(...off) < 1.5, `${off}`);
  // They are drawn: marks cover pixels of their canvas, and none when off or without a pose.
  const covered = () =>
    page.evaluate(() => {
      const marks = document.querySelector(".marks");
      const { data } = marks.getContext("2d").getImageData(0, 0, marks.width, marks.height);
      return getComputedStyle(marks).visibility === "visible" ? data.filter((_, k) => k % 4 === 3).filter((a) => a > 0).length : 0;
    });
  const isDrawn = (count) => count > 1000;
  assert.ok(isDrawn(await until(covered, isDrawn)));
  await freeze(page);
  assert.ok(isDrawn(await covered()));
  const outlines = page.getByRole("button", { name: "Outlines" });
  await outlines.press("o");
  assert.equal(await until(covered, (count) => count === 0), 0);
  await outlines.press("o");
  assert.ok(isDrawn(await until(covered, isDrawn)));
  await close();
});

test("the stage in 3D turns by keys, buttons and the mouse, and its projections are exact", async () => {
  const { page, complaints, close } = await opened();
  const at = () => page.evaluate(async () => ({ ...(await import("/stage.js")).view.value }));
  const canvas = page.locator(".stage canvas");
  // It is drawn: the floor, the surfaces, the camera.
  const drawn = () => canvas.evaluate((canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.filter((_, k) => k % 4 === 3).filter((a) => a > 0).length);
  await page.evaluate(async () => {
    const [{ scene }, { minute }] = await Promise.all([import("/daemon.js"), import("/minute.js")]);
    while (scene.value === null || minute.length < 3) await new Promise((done) => setTimeout(done, 20));
  });
  const pixels = await until(drawn, (count) => count > 3000);
  assert.ok(pixels > 3000, `${pixels} pixels`);
  const first = await at();
  await canvas.focus();
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("+");
  const second = await at();
  assert.ok(second.azimuth > first.azimuth && second.zoom > first.zoom, JSON.stringify(second));
  await page.getByRole("button", { name: "rotate left" }).click();
  assert.ok(Math.abs((await at()).azimuth - first.azimuth) < 1e-9);
  await canvas.scrollIntoViewIfNeeded();
  const { x, y, width, height } = await canvas.boundingBox();
  await page.mouse.move(x + width / 2, y + height / 2);
  await page.mouse.down();
  await page.mouse.move(x + width / 2 - 60, y + height / 2 + 30, { steps: 6 });
  await page.mouse.up();
  const dragged = await at();
  assert.ok(dragged.azimuth > first.azimuth + 0.2 && dragged.elevation > first.elevation + 0.1, JSON.stringify(dragged));
  await page.getByRole("button", { name: "All" }).click();
  assert.deepEqual(await at(), first);
  // Axes are orthogonal, an ellipse has the covariance's sigmas, and the lens is inverted at the
  // picture's corners.
  const off = await page.evaluate(async () => {
    const [{ axes, dot, ellipse }, { direction, pixel }, { scene }] = await Promise.all([import("/orbit.js"), import("/lens.js"), import("/daemon.js")]);
    const seen = axes({ azimuth: 0.7, elevation: 0.3, zoom: 1 });
    const pairs = [[seen.right, seen.up], [seen.right, seen.away], [seen.up, seen.away]].map(([a, b]) => dot(a, b));
    const front = axes({ azimuth: 0, elevation: 0, zoom: 1 });
    // Sigmas of 3 and 1 along x and z, rotated by 30 degrees, and 2 along y, which the front view
    // does not show.
    const [c, s] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
    const { long, short, turned } = ellipse([[9 * c * c + s * s, 0, 8 * c * s], [0, 4, 0], [8 * c * s, 0, 9 * s * s + c * c]], front);
    const { camera } = scene.value;
    const corners = [[0, 0], [camera.width - 1, camera.height - 1]].map((corner) => {
      const back = pixel(camera, [...direction(camera, corner), 1]);
      return Math.hypot(back[0] - corner[0], back[1] - corner[1]);
    });
    return [...pairs, long - 3, short - 1, turned - Math.PI / 6, ...corners.map((pixels) => pixels * 1e-4)];
  });
  assert.ok(Math.max(...off.map(Math.abs)) < 1e-6, `${off}`);
  assert.deepEqual(complaints, []);
  await close();
});

test("the floor is drawn where the lens shows it, and the last minute has every frame shown", async () => {
  const { page, complaints, close } = await opened();
  await page.evaluate(async () => {
    const [{ scene }, { minute }] = await Promise.all([import("/daemon.js"), import("/minute.js")]);
    while (scene.value === null || minute.length <= 10) await new Promise((done) => setTimeout(done, 20));
  });
  await page.keyboard.press("o");
  await page.keyboard.press("g");
  await freeze(page);
  await page.getByText("Frozen.").waitFor();
  // Points on the floor's lines are drawn; those between four lines are not.
  const { lit, off, seen } = await page.evaluate(async () => {
    const [{ pixel, within }, { head, scene }] = await Promise.all([import("/lens.js"), import("/daemon.js")]);
    const marks = document.querySelector(".marks");
    const { data } = marks.getContext("2d").getImageData(0, 0, marks.width, marks.height);
    const { pose } = head.value.record;
    const { camera } = scene.value;
    const alpha = (point) => {
      const raw = pixel(camera, within(pose, point));
      const [x, y] = raw === null ? [-1, -1] : raw.map((value) => ((value + 0.5) * marks.width) / camera.width);
      if (!(x >= 2 && y >= 2 && x < marks.width - 2 && y < marks.height - 2)) return null;
      let most = 0;
      for (const dx of [-1, 0, 1]) for (const dy of [-1, 0, 1]) most = Math.max(most, data[4 * ((Math.floor(y) + dy) * marks.width + Math.floor(x) + dx) + 3]);
      return most;
    };
    const [x, y] = pose.position_m.map(Math.round);
    // The floor is seen edge on where the camera is as high as it: only near points are apart.
    const near = [1, 2, 3, 4].flatMap((dy) => [-1, 0, 1].map((dx) => [x + dx, y + dy + 0.25, 0]));
    const lines = near.map(alpha).filter((value) => value !== null);
    return { lit: lines.filter((value) => value > 40).length, off: data.filter((_, k) => k % 4 === 3).filter((a) => a === 0).length / (data.length / 4), seen: lines.length };
  });
  assert.ok(seen > 0 && lit === seen, `${lit} of ${seen}`);
  assert.ok(off > 0.5, `${off} of the picture is free`);
  // The strip's words count what the page remembers, and each state has its band.
  const counted = await page.evaluate(async () => (await import("/minute.js")).minute.length);
  assert.ok(counted > 0);
  await page.locator(".strip .note", { hasText: `Of ${counted} frames shown: ` }).waitFor();
  await page.locator(".strip .note", { hasText: /tracking \d+\s%.*largest residual \d\.\d\d\spx/ }).waitFor();
  assert.ok((await share(await page.locator(".strip canvas").screenshot(), "g > r + 40 && g > b + 20")) > 0);
  assert.deepEqual(complaints, []);
  await close();
});

test("every theme and width is accessible, and the stage's has no light but amber", async () => {
  const { page, complaints, close } = await opened({ bypassCSP: true });
  await looksWell(on.browser, page, "live");
  assert.deepEqual(complaints, []);
  await close();
});

test("the keyboard alone is enough, and the theme is kept", async () => {
  const { page, close } = await opened();
  await page.keyboard.press("Space");
  await page.getByText("Frozen.").waitFor();
  const now = await frame(page);
  // Longer than a frame speaks for.
  await page.waitForTimeout(1500);
  assert.equal(await frame(page), now);
  await says(page, "Tracking");
  await page.keyboard.press("Space");
  assert.ok((await goesOn(page, now)) > now);
  await page.keyboard.press("?");
  await page.getByText("outlines on and off").waitFor();
  // Tab reaches every switch; what has the focus is seen.
  const reached = new Set();
  for (let k = 0; k < 26; k += 1) {
    await page.keyboard.press("Tab");
    reached.add(await page.evaluate(() => document.activeElement?.textContent || document.activeElement?.getAttribute("value")));
  }
  for (const name of ["Freeze", "Outlines", "Floor", "Residuals", "Keys", "Licences"]) assert.ok(reached.has(name), `${[...reached]}`);
  await page.keyboard.press("n");
  assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "stage");
  await page.reload();
  assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "stage");
  await close();
});

test("a daemon that stands still or dies is said to be silent within a second, and the page goes on by itself", async () => {
  const { page, close } = await opened();
  // The page itself notes when it reports the loss, when it last heard something, and how late its
  // timers are: a look from outside is too coarse.
  const timers = await page.evaluate(async () => {
    const [{ contact, heard, SILENT_AFTER, LOOKS_EVERY }, { effect }] = await Promise.all([import("/daemon.js"), import("/vendor/signals.js")]);
    globalThis.lost = null;
    let [ticked, late] = [performance.now(), 0];
    setInterval(() => {
      late = Math.max(late, performance.now() - ticked - LOOKS_EVERY);
      ticked = performance.now();
    }, LOOKS_EVERY);
    effect(() => {
      if (contact.value === false) globalThis.lost = { after: performance.now() - heard(), late, at: Date.now() };
      else late = 0;
    });
    return SILENT_AFTER + LOOKS_EVERY;
  });
  // The daemon sends four times a second, which leaves room for a late machine within the second.
  assert.ok(timers <= 700, `${timers} ms`);
  const span = async (act, state) => {
    const begun = Date.now();
    await act();
    await says(page, state);
    return Date.now() - begun;
  };
  const lost = async (act) => {
    const begun = Date.now();
    await act();
    await says(page, "No contact");
    const { at, ...rest } = await page.evaluate(() => globalThis.lost);
    return { ...rest, said: at - begun };
  };
  const stood = await lost(() => on.daemon.stand());
  await page.screenshot({ path: join(out, "live-no-contact.png") });
  const wentOn = await span(() => on.daemon.goOn(), "Tracking");
  // As late as the page's timers were, and no later.
  assert.ok(stood.after <= timers + stood.late + 20, JSON.stringify(stood));
  const died = await lost(() => on.daemon.end());
  assert.match(await page.locator(".picture canvas").first().evaluate((canvas) => getComputedStyle(canvas).filter), /grayscale/);
  on.daemon = start(on.place.folder);
  const back = await span(() => {}, "Tracking");
  console.log(`no contact said after ${stood.said} ms (standing: ${stood.after.toFixed(0)} ms after the last word, timers ${stood.late.toFixed(0)} ms late) and ${died.said} ms (killed), back after ${wentOn} ms and ${back} ms`);
  await close();
});

/** Known tiles, and how many of them are seen, in the left third and in the others. */
const seenTiles = (page) =>
  page.evaluate(async () => {
    const { tiles, SEEN, UNKNOWN } = await import("/seen.js");
    const found = tiles.value;
    const part = (isOwn) => {
      const own = [...(found?.tiles ?? [])].filter((tile, k) => tile !== UNKNOWN && isOwn((k % found.across) / found.across));
      return { known: own.length, seen: own.filter((tile) => tile === SEEN).length };
    };
    return { left: part((x) => x < 0.3), right: part((x) => x >= 0.35) };
  });

test("what hides a part of the stage is said and marked, and nothing is said where nothing hides it", async () => {
  const { page, complaints, close } = await opened();
  const isKnown = ({ left, right }) => left.known + right.known > 30;
  const { left, right } = await until(() => seenTiles(page), isKnown);
  console.log(`artwork seen in ${left.seen + right.seen} of ${left.known + right.known} tiles`);
  assert.ok(left.seen >= 0.9 * left.known && right.seen >= 0.9 * right.known, JSON.stringify({ left, right }));
  await page.locator(".says", { hasText: "The camera's pose is measured in every frame." }).waitFor();
  assert.doesNotMatch(await page.locator(".says").textContent(), /hidden/);
  assert.deepEqual(complaints, []);
  await close();
  const place = await prepareCovered(join(out, "run-covered"), on.browser);
  const daemon = start(place.folder);
  try {
    const covered = await pageOf(on.browser, place.address);
    await covered.page.locator(".says", { hasText: "The left third is hidden." }).waitFor();
    const found = await until(() => seenTiles(covered.page), isKnown);
    assert.ok(found.left.known > 8 && found.left.seen <= 0.1 * found.left.known && found.right.seen >= 0.9 * found.right.known, JSON.stringify(found));
    // Marked, where they are asked for.
    await freeze(covered.page);
    const marks = (colour) => covered.page.locator(".picture").screenshot().then((png) => share(png, colour));
    const red = "r > 220 && g < 150 && b < 150";
    assert.equal(await marks(red), 0);
    await covered.page.getByRole("button", { name: "Seen parts" }).click();
    const isThere = (count) => count > 0.001;
    assert.ok(isThere(await until(() => marks(red), isThere)));
    await covered.page.screenshot({ path: join(out, "live-covered.png") });
    // Without a measured pose nothing is marked; hidden pixels that are not reported are not
    // invented.
    const marked = await covered.page.evaluate(async () => {
      const [{ head, painters }, { tiles, SEEN, HIDDEN }, { hidden }] = await Promise.all([import("/daemon.js"), import("/seen.js"), import("/picture.js")]);
      const { record, size } = head.value;
      // Two pixels in the middle of each of 16 by 9 tiles: the left third hidden, the rest used.
      const side = size[0] / 16;
      const middles = Array.from({ length: 2 * 16 * 9 }, (_, k) => [((k % 16) + 0.5) * side, ((Math.floor(k / 16) % 9) + 0.5) * side]);
      const [used, covered] = [1, 0].map((right) => middles.filter(([x]) => Number(3 * x > size[0]) === right).flat());
      const shown = async (frame) => {
        await new Promise((done) => setTimeout(done, 1100));
        const picture = await createImageBitmap(new ImageData(size[0], size[1]));
        for (const paint of painters) paint(picture, { ...head.value, ...frame });
        const all = [...(tiles.value?.tiles ?? [])];
        return [tiles.value !== null, all.includes(SEEN), all.includes(HIDDEN), hidden.value !== ""];
      };
      const found = {};
      found.both = await shown({ used, hidden: covered });
      for (const state of ["searching", "coasting", "lost"]) found[state] = await shown({ used: [], hidden: [], record: { ...record, state } });
      found.unposed = await shown({ used, hidden: covered, record: { ...record, pose: null } });
      found.nothing = await shown({ used: [], hidden: [] });
      found.old = await shown({ used, hidden: undefined });
      found.without = await shown({ used: undefined, hidden: undefined });
      return found;
    });
    const none = [false, false, false, false];
    assert.deepEqual(marked, {
      both: [true, true, true, true], searching: none, coasting: none, lost: none, unposed: none,
      nothing: [true, false, false, false], old: [true, true, false, false], without: [true, true, false, false],
    });
    await covered.close();
  } finally {
    await daemon.end();
  }
});

test("a newer daemon loads the page anew; what was typed is still there, then and after a restart", async () => {
  const { page, close } = await pageOf(on.browser, on.place.address, { view: "recordings" });
  const typed = page.getByLabel("Mark this moment");
  await typed.fill("half a cu");
  const said = await (await fetch(`${on.place.address}api/v1/session`)).json();
  const loaded = page.waitForEvent("load");
  await page.route("**/api/v1/session", (route) => route.fulfill({ json: { ...said, page: "0".repeat(16) } }));
  await loaded;
  await typed.waitFor();
  assert.equal(await typed.inputValue(), "half a cu");
  await on.daemon.end();
  await says(page, "No contact");
  await page.getByText("stagepose does not answer: nothing can be changed.").waitFor();
  await typed.fill("half a cue");
  on.daemon = start(on.place.folder);
  await says(page, "Tracking");
  assert.equal(await typed.inputValue(), "half a cue");
  await close();
});

test("a page that nobody sees asks for nothing", async () => {
  const { page, close } = await opened();
  const client = await page.context().newCDPSession(page);
  await client.send("Network.enable");
  const see = (hidden) =>
    page.evaluate((hidden) => {
      Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
    }, hidden);
  await see(true);
  await page.waitForTimeout(500);
  let [pictures, bytes, requests] = [0, 0, 0];
  client.on("Network.webSocketFrameReceived", ({ response }) => {
    pictures += response.opcode === 2 ? 1 : 0;
    bytes += response.opcode === 2 ? 0 : response.payloadData.length;
  });
  client.on("Network.requestWillBeSent", () => (requests += 1));
  await page.waitForTimeout(3000);
  // The one that it had asked for may come late.
  assert.ok(pictures <= 1, `${pictures}`);
  // Beside how things stand, three times a second, there is nothing.
  assert.ok(bytes < 3000 && requests === 0, `${bytes} bytes, ${requests} requests`);
  await see(false);
  await until(async () => pictures, (count) => count > 5);
  assert.ok(pictures > 5);
  await close();
});

test("used pixels and residuals are drawn to the scale that is said, and asked for only while they are shown", async () => {
  const { page, complaints, close } = await opened();
  const client = await page.context().newCDPSession(page);
  await client.send("Network.enable");
  const asked = [];
  client.on("Network.webSocketFrameSent", ({ response }) => asked.push(response.payloadData));
  // Except about once a second, to learn what is hidden: the first such frame may have no pixels
  // yet.
  const isSeldom = () => asked.filter((one) => one === "u").length <= asked.length / 2;
  await until(async () => asked.length, (count) => count > 20);
  assert.ok(isSeldom(), `${asked}`);
  const without = () => page.evaluate(async () => (await import("/daemon.js")).head.value.used === undefined);
  assert.ok(await until(without, Boolean));
  await page.keyboard.press("o");
  await page.keyboard.press("u");
  const switched = page.getByRole("button", { name: "Residuals" });
  assert.equal(await switched.getAttribute("aria-pressed"), "true");
  const known = () => page.evaluate(async () => (await import("/daemon.js")).head.value?.displaced?.length ?? 0);
  assert.ok((await until(known, (count) => count > 100)) > 100);
  for (;;) {
    await freeze(page);
    if ((await known()) > 100) break;
    await page.getByRole("button", { name: "Freeze", exact: true }).click();
  }
  // Dots lie on the pixels, arrows end where the scale puts them.
  const found = await page.evaluate(async () => {
    const [{ head }, { scale }] = await Promise.all([import("/daemon.js"), import("/used.js")]);
    const { used, displaced, size, record } = head.value;
    const marks = document.querySelector(".marks");
    const { data } = marks.getContext("2d").getImageData(0, 0, marks.width, marks.height);
    const lit = ([x, y]) => {
      const at = [x, y].map((value) => Math.floor(((value + 0.5) * marks.width) / size[0]));
      return at[0] < 0 || at[1] < 0 || at[0] >= marks.width || at[1] >= marks.height ? null : data[4 * (at[1] * marks.width + at[0]) + 3] > 0;
    };
    const dots = Array.from({ length: used.length / 2 }, (_, k) => lit(used.slice(2 * k, 2 * k + 2)));
    const tiles = Array.from({ length: displaced.length / 4 }, (_, k) => displaced.slice(4 * k, 4 * k + 4));
    const ends = tiles.map(([x, y, dx, dy]) => lit([x + scale.value * dx, y + scale.value * dy]));
    const share = (all) => all.filter((one) => one === true).length / all.filter((one) => one !== null).length;
    const inside = tiles.every(([x, y]) => x > -0.5 && y > -0.5 && x < size[0] && y < size[1]);
    const lengths = tiles.map(([, , dx, dy]) => Math.hypot(dx, dy)).sort((a, b) => a - b);
    const rms = Math.sqrt(lengths.reduce((sum, length) => sum + length * length, 0) / lengths.length);
    const dark = data.filter((_, k) => k % 4 === 3).filter((alpha) => alpha === 0).length / (data.length / 4);
    return { dots: share(dots), ends: share(ends), inside, median: lengths[Math.floor((lengths.length - 1) / 2)], rms, recorded: record.rms_px, scale: scale.value, dark, count: tiles.length };
  });
  console.log(`residuals of ${found.count} tiles: median ${found.median} px, rms ${found.rms.toFixed(3)} px (the record says ${found.recorded.toFixed(3)}), drawn ${found.scale} times as long`);
  assert.ok(found.inside && found.dots > 0.99 && found.ends > 0.99, JSON.stringify(found));
  assert.ok(found.dark > 0.3, "what is between them stays free");
  await page.locator(".picture .scale", { hasText: `Arrows enlarged ${found.scale} ×. Half of ${found.count} tiles lie within ${found.median.toFixed(2)}` }).waitFor();
  await page.screenshot({ path: join(out, "live-residuals.png") });
  await page.keyboard.press("u");
  const covered = () => page.evaluate(() => {
    const marks = document.querySelector(".marks");
    return getComputedStyle(marks).visibility === "visible" ? marks.getContext("2d").getImageData(0, 0, marks.width, marks.height).data.filter((alpha, k) => k % 4 === 3 && alpha > 0).length : 0;
  });
  assert.equal(await until(covered, (count) => count === 0), 0);
  await page.getByRole("button", { name: "Freeze", exact: true }).click();
  asked.length = 0;
  await until(async () => asked.length, (count) => count > 20);
  assert.ok(isSeldom(), `${asked}`);
  assert.deepEqual(complaints, []);
  await close();
});

test("a config that is refused is named on every view by its line, with a hint; the previous one stays active", async () => {
  const { page, close } = await opened({ bypassCSP: true });
  const file = join(on.place.folder, "stage.toml");
  const good = readFileSync(file, "utf8");
  const bad = `${good}\n[filter]\nresponse_z = 3\n`;
  try {
    writeFileSync(file, bad);
    on.daemon.reload();
    const fault = page.locator(".barred.config");
    await fault.getByText(/The config file has an error\. The previous config stays active\./).waitFor();
    const said = await fault.textContent();
    const line = 1 + bad.split("\n").indexOf("response_z = 3");
    assert.match(said, new RegExp(`Line ${line}:.*stage\\.toml.*response_z`));
    await says(page, "Tracking");
    await page.locator(".happened li.error", { hasText: "The old config stays" }).first().waitFor();
    assert.ok((await goesOn(page, await frame(page))) > 0);
    await page.goto(`${on.place.address}#health`);
    await fault.waitFor();
    await page.locator(".card.warn", { hasText: "the previous config stays active" }).waitFor();
    await looksWell(on.browser, page, "config-refused");
  } finally {
    writeFileSync(file, good);
    on.daemon.reload();
  }
  await page.locator(".barred.config").waitFor({ state: "detached" });
  await close();
});
