// The Set view in a real browser: how exactly the set lies in the camera's picture, and how it is
// placed. Requirements: page.test.mjs. It also tests rendered clips with exact truth if they exist:
// STAGEPOSE_CLIPS (default target/clips) has what benches/clips.py makes.
import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { join, resolve } from "node:path";
import { test } from "node:test";
import { answers, files, freeze, looksWell, out, pageOf, until } from "./browser.mjs";
import { played, prepareClip, start } from "./daemon.mjs";

const clips = resolve(process.env.STAGEPOSE_CLIPS ?? "target/clips");

const on = played("run-set");

/** The Set view, with a picture in it and the stage's artwork at hand. */
async function opened(options = {}) {
  const found = await pageOf(on.browser, on.place.address, { view: "set", ...options });
  await found.page.locator(".aligned .figure", { hasText: /\d/ }).waitFor();
  return found;
}

/** Which way the fixture's camera goes. */
const FORWARDS = [0.79, 0.53, 0.32];
/**
 * Minimum and maximum metres between frames. Slower, the previous frame is almost the same view
 * (the fixture's maximum is 0.02); faster is only a clip that restarts.
 */
const [SLOWEST, FASTEST] = [0.01, 0.1];

const median = (values) => values.toSorted((a, b) => a - b)[Math.floor(values.length / 2)];

/**
 * Medians and 90th percentiles of the tiles' shifts in some frames, by their own pose and by that
 * of the previous frame.
 * @param {import("playwright-core").Page} page
 * @param {number} count frames
 * @param {number[] | null} direction of the camera, if the clip is played to and fro: backwards its
 *   shutter would run upwards, which no camera has
 */
async function alignments(page, count, along) {
  const found = await page.evaluate(
    async ([count, along, slowest, fastest]) => {
      const [{ measure, mode }, { painters }] = await Promise.all([import("/composite.js"), import("/daemon.js")]);
      // Drawing the set takes time here and is not what is measured.
      mode.value = "image";
      const records = new Map();
      const socket = new WebSocket(`ws://${location.host}/ws`);
      socket.onmessage = ({ data }) => {
        const record = JSON.parse(data);
        records.set(record.sequence, record);
      };
      const measured = [];
      await new Promise((done) => {
        // Neither a turn of the clip nor its beginning is among the last frames.
        const goesOn = (from, to) => {
          const step = [0, 1, 2].map((k) => to.pose.position_m[k] - from.pose.position_m[k]);
          return Math.hypot(...step) < fastest && (along === null || step.reduce((sum, part, k) => sum + part * along[k], 0) > slowest);
        };
        const paint = (_, { record, motion }) => {
          const last = [3, 2, 1].map((back) => records.get(record.sequence - back)).concat(record);
          if (last.some((one) => one?.state !== "tracking") || last.some((one, k) => k > 0 && !goesOn(last[k - 1], one))) return;
          const before = last[2];
          const [own, late] = [measure(record, motion), measure(before, motion)];
          // A shaken camera may be too far on for the previous pose to find a tile, and which
          // frames are painted is chance: such a frame is skipped.
          if (along === null && own.tiles > 0 && late.tiles === 0) return;
          measured.push({ sequence: record.sequence, own, late });
          if (measured.length === count) {
            painters.delete(paint);
            socket.close();
            done();
          }
        };
        painters.add(paint);
      });
      mode.value = "set";
      return measured;
    },
    [count, along, SLOWEST, FASTEST],
  );
  // If no tile is found, the set is far off: count that as infinitely far, to keep the order.
  const of = (key, which) => median(found.map((one) => one[which][key] ?? Infinity));
  return { median: of("median", "own"), most: of("most", "own"), tiles: of("tiles", "own"), late: of("median", "late") };
}

const told = (name, { median, most, tiles, late }) => console.log(`${name}: median ${median.toFixed(3)} px, 90 % ${most.toFixed(3)} px, ${tiles} tiles; by the frame before ${late.toFixed(3)} px`);

test("the set lies in the camera's picture to a tenth of a pixel, and the frame before is told from it", async () => {
  const { page, complaints, close } = await opened();
  const found = await alignments(page, 20, FORWARDS);
  told("fixture", found);
  assert.ok(found.tiles > 100, `${found.tiles} tiles`);
  assert.ok(found.median <= 0.1 && found.most <= 0.3, JSON.stringify(found));
  assert.ok(Number.isFinite(found.late) && found.late >= 5 * found.median, JSON.stringify(found));
  assert.deepEqual(complaints, []);
  await close();
});

for (const [name, least, most] of [
  ["d-relief", 0.15, 0.4],
  ["d-handheld", 0.3, 0.9],
]) {
  // Whole, or the part that .ci/run renders.
  const found = [name, `${name}-60-every-1`].map((folder) => join(clips, folder)).find((folder) => existsSync(join(folder, "stagepose/stage.toml")));
  test(`the set lies in the pictures of ${name}`, { skip: found ? false : `no ${join(clips, name)}, which benches/clips.py renders with ../shared/bench` }, async () => {
    const clip = await prepareClip(join(out, `run-${name}`), found);
    const daemon = start(clip.folder, "clip");
    try {
      const { page, close } = await pageOf(on.browser, clip.address, { view: "set" });
      await page.locator(".aligned .figure", { hasText: /\d/ }).waitFor();
      const aligned = await alignments(page, 12, null);
      told(name, aligned);
      assert.ok(aligned.median <= least && aligned.most <= most, JSON.stringify(aligned));
      assert.ok(Number.isFinite(aligned.late) && aligned.late >= 5 * aligned.median, JSON.stringify(aligned));
      await close();
    } finally {
      await daemon.end();
    }
  });
}

test("things are put on the set by keys and numbers, hidden by surfaces, and kept", async () => {
  const { page, complaints, close } = await opened();
  // Drawn and read within one task: a canvas of the graphics card is empty afterwards.
  const blue = () =>
    page.evaluate(async () => {
      const { again, clean } = await import("/composite.js");
      // Handles are seen before everything.
      clean.value = true;
      const drawn = document.querySelector(".composite canvas");
      const context = new OffscreenCanvas(drawn.width, drawn.height).getContext("2d");
      again();
      context.drawImage(drawn, 0, 0);
      clean.value = false;
      const { data } = context.getImageData(0, 0, drawn.width, drawn.height);
      let count = 0;
      for (let k = 0; k < data.length; k += 4) count += data[k + 2] > data[k] + 40 && data[k + 2] > 60 ? 1 : 0;
      return count / (data.length / 4);
    });
  assert.equal(await blue(), 0);
  // Still pictures: what changes is the set.
  await freeze(page);
  await page.getByRole("button", { name: "+ cube" }).focus();
  await page.keyboard.press("Enter");
  const field = (label) => page.locator(".chosen").getByRole("textbox", { name: new RegExp(`^${label} `) });
  await page.locator(".chosen select").selectOption("0");
  await field("Up").fill("0.2");
  const seen = await until(blue, (share) => share > 0.005);
  assert.ok(seen > 0.005, `${seen}`);
  // Behind the backdrop it is hidden.
  await field("Out").fill("-1");
  assert.equal(await until(blue, (share) => share === 0), 0);
  // Undone, it is where it was; half a number changes nothing and stays as typed.
  await page.getByRole("button", { name: "Undo" }).click();
  const isAsBefore = (share) => Math.abs(share - seen) < 0.002;
  assert.ok(isAsBefore(await until(blue, isAsBefore)));
  await field("Right").fill("-");
  assert.equal(await field("Right").getAttribute("aria-invalid"), "true");
  assert.equal(await field("Right").inputValue(), "-");
  await field("Right").fill("0,25");
  await page.getByLabel("image", { exact: true }).check({ force: true });
  assert.equal(await until(blue, (share) => share === 0), 0);
  await page.reload();
  await page.getByRole("button", { name: "Cube" , exact: true }).click();
  assert.equal(await field("Right").inputValue(), "0.25");
  // The handle along the surface's x moves it along x alone.
  await page.locator(".aligned .figure", { hasText: /\d/ }).waitFor();
  await freeze(page);
  const { from, to } = await page.evaluate(async () => {
    const [{ compositor }, { pixel, within, place }, { head, scene }] = await Promise.all([import("/composite.js"), import("/lens.js"), import("/daemon.js")]);
    const canvas = document.querySelector(".composite canvas");
    const { left, top, width } = canvas.getBoundingClientRect();
    const surface = scene.value.stage.surfaces[0];
    const helper = compositor.handles[0].root;
    let size = 0;
    helper.traverse((one) => one.name === "X" && one.visible && (size = Math.max(size, one.scale.x)));
    const at = (x) => {
      const point = place(surface.pose, [x, 0.2, 0]);
      const raw = pixel(scene.value.camera, within(head.value.record.pose, point));
      return raw.map((value, axis) => ((value + 0.5) * width) / scene.value.camera.width + [left, top][axis]);
    };
    return { from: at(0.25 + 0.4 * size), to: at(0.25 + 0.4 * size + 0.3) };
  });
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(...to, { steps: 5 });
  await page.mouse.up();
  const moved = await page.evaluate(async () => (await import("/things.js")).set.value.objects[0].position_m);
  assert.ok(Math.abs(moved[0] - 0.55) < 0.03 && moved[1] === 0.2 && moved[2] === 0, `${moved}`);
  assert.deepEqual(complaints, []);
  await close();
});

test("a model that names other files, or is none, is refused with a sentence", async () => {
  const { page, complaints, close } = await opened();
  const glb = (said, length) => {
    const json = Buffer.from(JSON.stringify(said).padEnd(Math.ceil(JSON.stringify(said).length / 4) * 4));
    const head = Buffer.alloc(20);
    [0x46546c67, 2, 20 + json.length, length ?? json.length, 0x4e4f534a].forEach((value, k) => head.writeUInt32LE(value, 4 * k));
    return Buffer.concat([head, json]);
  };
  const give = (name, buffer) => page.locator("input[type=file]").setInputFiles({ name, mimeType: "model/gltf-binary", buffer });
  const asset = { version: "2.0" };
  for (const [name, buffer, says] of [
    ["text.glb", Buffer.from("this is a text, not a model"), "text.glb is not a glTF binary file. Export it as .glb."],
    ["short.glb", glb({ asset }, 4000), "short.glb is incomplete. Copy it again."],
    ["far.glb", glb({ asset, buffers: [{ uri: "http://example.com/a.bin", byteLength: 4 }] }), "far.glb refers to other files."],
    ["old.glb", glb({ asset: { version: "1.0" } }), "old.glb cannot be read"],
  ]) {
    await give(name, buffer);
    await page.locator(".refused", { hasText: says }).waitFor();
  }
  await give("empty.glb", glb({ asset, scene: 0, scenes: [{ nodes: [] }] }));
  await page.getByRole("button", { name: "empty", exact: true }).waitFor();
  assert.equal(await page.locator(".refused").count(), 0);
  assert.deepEqual(complaints, []);
  await close();
});

test("the set is kept by the daemon for every browser; what cannot be saved now is saved later; of two changes a person chooses", async () => {
  const route = `${on.place.address}api/v1/`;
  const kept = async () => (await (await fetch(`${route}set`)).json()).objects.map(({ name }) => name);
  const same = (names) => (now) => JSON.stringify(now) === JSON.stringify(names);
  const isKept = async (names) => assert.deepEqual(await until(kept, same(names)), names);
  const listed = async (page, names) => assert.deepEqual(await until(() => page.locator(".things .list button").allTextContents(), same(names)), names);
  await answers(on.place.address);
  await fetch(`${route}set`, { method: "PUT", body: JSON.stringify({ objects: [] }) });
  // Without pictures: drawing the set takes its time, and is not what is looked at.
  const still = async (page) => {
    await page.getByRole("button", { name: "Freeze", exact: true }).click();
    return page;
  };
  const reloaded = async (page) => {
    await page.reload();
    return still(page);
  };
  const [first, second] = [await pageOf(on.browser, on.place.address, { view: "set" }), await pageOf(on.browser, on.place.address, { view: "set" })];
  for (const { page } of [first, second]) await still(page);
  await first.page.getByRole("button", { name: "+ cone" }).click();
  await first.page.getByText("Saved beside the config.").waitFor();
  await isKept(["Cone"]);
  // Another browser, opened now, has it; its model is kept too.
  await reloaded(second.page);
  await listed(second.page, ["Cone"]);
  const json = Buffer.from(JSON.stringify({ asset: { version: "2.0" }, scene: 0, scenes: [{ nodes: [] }] }).padEnd(64));
  const head = Buffer.alloc(20);
  [0x46546c67, 2, 20 + json.length, json.length, 0x4e4f534a].forEach((value, k) => head.writeUInt32LE(value, 4 * k));
  await second.page.locator("input[type=file]").setInputFiles({ name: "A door.glb", mimeType: "model/gltf-binary", buffer: Buffer.concat([head, json]) });
  await isKept(["Cone", "A-door"]);
  assert.equal((await fetch(`${route}sets/A-door.glb`)).status, 200);
  await reloaded(first.page);
  await listed(first.page, ["Cone", "A-door"]);
  await until(() => first.page.evaluate(async () => (await import("/models.js")).models.value.has("A-door.glb")), (isThere) => isThere);
  // Under the lock it stays in the browser, and is saved when the lock is released.
  await fetch(`${route}lock`, { method: "POST" });
  await first.page.getByRole("button", { name: "+ cube" }).click();
  await first.page.getByText("Not saved yet; this browser keeps it.").waitFor();
  assert.deepEqual(await kept(), ["Cone", "A-door"]);
  await fetch(`${route}unlock`, { method: "POST" });
  await isKept(["Cone", "A-door", "Cube"]);
  // The second has not seen that, and changes the set as well.
  await second.page.getByRole("button", { name: "+ grid" }).click();
  await second.page.getByText("Not saved: another browser changed the set.").waitFor();
  assert.deepEqual(await kept(), ["Cone", "A-door", "Cube"]);
  await second.page.getByRole("button", { name: "Keep mine" }).click();
  await isKept(["Cone", "A-door", "Grid"]);
  await first.page.getByRole("button", { name: "+ cone" }).click();
  await first.page.getByRole("button", { name: "Take theirs" }).click();
  await listed(first.page, ["Cone", "A-door", "Grid"]);
  await isKept(["Cone", "A-door", "Grid"]);
  await Promise.all([first.close(), second.close()]);
  await fetch(`${route}set`, { method: "PUT", body: JSON.stringify({ objects: [] }) });
});

test("the Set view is accessible in every theme and width", async () => {
  const { page, close } = await opened({ bypassCSP: true });
  await page.getByRole("button", { name: "+ cone" }).click();
  await page.getByLabel("wipe", { exact: true }).check({ force: true });
  await looksWell(on.browser, page, "set");
  await close();
});

test("the first view is small, and the set not large", { skip: files ? "the program's own files are what is measured, and PAGE_DIR stands for them" : false }, async () => {
  const sent = async (view, until) => {
    const context = await on.browser.newContext();
    const page = await context.newPage();
    const client = await context.newCDPSession(page);
    await client.send("Network.enable");
    const [files, bytes] = [new Map(), new Map()];
    // What is loaded some seconds later is not part of the first view, however long that takes.
    client.on("Network.requestWillBeSent", ({ requestId, request }) => files.set(requestId, new URL(request.url).pathname));
    client.on("Network.loadingFinished", ({ requestId, encodedDataLength }) => files.get(requestId) !== "/seen.js" && bytes.set(files.get(requestId), encodedDataLength));
    await page.goto(`${on.place.address}#${view}`);
    await page.locator(until).first().waitFor();
    await page.waitForTimeout(500);
    await context.close();
    return { all: [...bytes.values()].reduce((sum, some) => sum + some, 0), each: [...bytes].map(([file, some]) => `${file} ${some}`).join(", ") };
  };
  await answers(on.place.address);
  const [live, set] = [await sent("live", ".stage canvas"), await sent("set", ".composite canvas")];
  console.log(`sent for the first view ${live.all} bytes, for the set ${set.all} bytes`);
  assert.ok(live.all <= 60_000, live.each);
  // The stage's pictures are not the page's.
  const pictures = await Promise.all([0, 1].map(async (k) => Number((await (await fetch(`${on.place.address}api/v1/surfaces/${k}/picture`)).arrayBuffer()).byteLength)));
  assert.ok(set.all - pictures[0] - pictures[1] <= 300_000, `${set.each} with ${pictures}`);
});
