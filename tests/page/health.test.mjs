// The Health view: the parts, what the outputs send, the log, diagnostics, backup and restore.
// Requirements: page.test.mjs.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { crc32 } from "node:zlib";
import { looksWell, out, pageOf, says, until } from "./browser.mjs";
import { played, prepare, prepareShow, start } from "./daemon.mjs";

const on = played("run-health", prepareShow, undefined, []);
const opened = (options = {}) => pageOf(on.browser, on.place.address, { view: "health", ...options });
const card = (page, name) => page.locator(".card").filter({ has: page.getByRole("heading", { name, exact: true }) });

/** A zip of files as they are. @param {Record<string, Buffer>} files */
function zipOf(files) {
  const [parts, directory] = [[], []];
  let at = 0;
  for (const [name, bytes] of Object.entries(files)) {
    const [crc, file] = [crc32(bytes), Buffer.from(name)];
    const head = Buffer.alloc(30);
    head.writeUInt32LE(0x04034b50, 0);
    head.writeUInt16LE(20, 4);
    const entry = Buffer.alloc(46);
    entry.writeUInt32LE(0x02014b50, 0);
    [20, 20].forEach((version, k) => entry.writeUInt16LE(version, 4 + 2 * k));
    for (const [buffer, from] of [[head, 14], [entry, 16]]) {
      [crc, bytes.length, bytes.length].forEach((value, k) => buffer.writeUInt32LE(value, from + 4 * k));
      buffer.writeUInt16LE(file.length, from + 12);
    }
    entry.writeUInt32LE(at, 42);
    parts.push(head, file, bytes);
    directory.push(entry, file);
    at += 30 + file.length + bytes.length;
  }
  const end = Buffer.alloc(22);
  end.writeUInt32LE(0x06054b50, 0);
  const [count, size] = [directory.length / 2, Buffer.concat(directory).length];
  [count, count].forEach((value, k) => end.writeUInt16LE(value, 8 + 2 * k));
  [size, at].forEach((value, k) => end.writeUInt32LE(value, 12 + 4 * k));
  return Buffer.concat([...parts, ...directory, end]);
}

test("each part has a card, and packets are decoded", async () => {
  const { page, complaints, asked, close } = await opened();
  for (const [part, says] of [
    ["Camera", /pictures a second\.$/],
    ["Tracker", /./],
    ["freed", /\d sent/],
    ["Recorder", /./],
    ["Disk", /GB are free/],
    ["Clock", /./],
  ]) {
    await card(page, part).locator("p", { hasText: says }).first().waitFor();
  }
  const output = card(page, "freed");
  await output.getByText("Last packet").click();
  await output.locator("pre", { hasText: /pan_deg/ }).waitFor();
  await output.locator("pre", { hasText: /^d1 01 / }).waitFor();
  // It is the packet of now: it changes.
  const before = await output.locator("pre").last().textContent();
  const isOther = (text) => text !== before;
  assert.ok(isOther(await until(() => output.locator("pre").last().textContent(), isOther)));
  await card(page, "opentrackio").getByText("Last packet").click();
  await card(page, "opentrackio").locator("pre", { hasText: "Optical" }).waitFor();
  assert.deepEqual([...asked], [new URL(on.place.address).host]);
  assert.deepEqual(complaints, []);
  await close();
});

test("the log is read, and diagnostics are copied", async () => {
  const { page, close } = await opened({ permissions: ["clipboard-read", "clipboard-write"] });
  await page.getByRole("button", { name: "Refresh" }).click();
  await page.locator("pre.log", { hasText: /stagepose|tracking|camera/i }).waitFor();
  await page.getByRole("button", { name: "Copy diagnostics" }).click();
  await page.getByText("Copied.").waitFor();
  const text = await page.evaluate(() => navigator.clipboard.readText());
  assert.match(text, /^stagepose \d[^]*camera: [^]*stagepose_/);
  await close();
});

test("a backup is downloaded; what a restore would change is said before it is done", async () => {
  const { page, complaints, close } = await opened();
  const waited = page.waitForEvent("download");
  await page.getByRole("link", { name: "Download backup" }).click();
  const path = await (await waited).path();
  const choose = (name, buffer) => page.locator("input[type=file]").setInputFiles({ name, mimeType: "application/zip", buffer });
  await choose("same.zip", readFileSync(path));
  // The daemon's own backups give what the config names a number.
  await page.getByText(/Restoring same\.zip replaces the config, and adds .*backdrop\.png.* Changes in the config:/).waitFor();
  await page.locator(".planned pre", { hasText: '+ calibration = "0-camera.toml"' }).waitFor();
  await page.getByRole("button", { name: "Cancel" }).click();
  // What is none is refused with a sentence.
  for (const [name, buffer, sentence] of [
    ["text.zip", Buffer.from("no zip at all, but longer than the end of one"), "This is not a complete zip file."],
    ["other.zip", zipOf({ "a.txt": Buffer.from("a") }), "other.zip has no stage.toml"],
    ["cut.zip", readFileSync(path).subarray(0, 2000), "This is not a complete zip file."],
  ]) {
    await choose(name, buffer);
    await page.getByText(sentence).waitFor();
  }
  const file = join(on.place.folder, "stage.toml");
  const before = readFileSync(file, "utf8");
  const given = (text) => zipOf({ "stage.toml": Buffer.from(text), ...Object.fromEntries(["backdrop.png", "flat.png", "camera.toml"].map((name) => [name, readFileSync(join(on.place.folder, name))])) });
  await choose("equal.zip", given(before));
  await page.getByText("The config does not change.").waitFor();
  // A config that cannot be used changes nothing.
  await choose("wrong.zip", given(before.replace("ring_s = 5", "ring_s = -5")));
  // It is tried before it is offered.
  await page.locator("[role=status]", { hasText: /wrong\.zip cannot be restored\. Nothing was changed\. Line \d+: .*ring_s/i }).waitFor();
  assert.equal(await page.getByRole("button", { name: "Restore", exact: true }).count(), 0);
  assert.equal(readFileSync(file, "utf8"), before);
  await choose("seven.zip", given(before.replace("ring_s = 5", "ring_s = 7")));
  const lines = page.locator(".planned pre");
  await lines.filter({ hasText: "+ ring_s = 7" }).waitFor();
  assert.equal((await lines.textContent()).trim(), "− ring_s = 5\n+ ring_s = 7");
  await page.getByRole("button", { name: "Restore", exact: true }).click();
  await page.getByText("seven.zip is restored, and the config was reloaded.").waitFor();
  assert.ok(readFileSync(file, "utf8").includes("ring_s = 7"));
  const ring = async () => (await (await fetch(`${on.place.address}api/v1/recordings`)).json()).ring_s;
  assert.equal(await until(ring, (ring_s) => ring_s === 7), 7);
  assert.deepEqual(complaints.filter((one) => !one.includes("422")), []);
  await close();
});

test("the view is accessible in every theme and width", async () => {
  const { page, close } = await opened({ bypassCSP: true });
  await card(page, "freed").getByText("Last packet").click();
  await page.locator("pre.hex").first().waitFor();
  await looksWell(on.browser, page, "health");
  await close();
});

test("a camera that is not there is bad, with what to do; a daemon that is gone is said to be", async () => {
  const place = await prepare(join(out, "run-no-camera"));
  const file = join(place.folder, "stage.toml");
  const config = readFileSync(file, "utf8");
  writeFileSync(file, config.includes("[camera]") ? config.replace("[camera]", '[camera]\ndevice = "/dev/video77"') : `${config}\n[camera]\ndevice = "/dev/video77"\n`);
  const daemon = start(place.folder, null);
  const { page, close } = await pageOf(on.browser, place.address, { view: "health", state: "" });
  try {
    await card(page, "Camera").locator(".mend").waitFor();
    await card(page, "Camera").getByText("Bad").waitFor();
    await card(page, "Tracker").getByText("No frame has come yet.").waitFor();
    await page.getByText("The config has no [[output]]: only this page shows the poses.").waitFor();
    await page.screenshot({ path: join(out, "health-no-camera.png") });
    await page.goto(`${place.address}#live`);
    await page.locator(".says").waitFor();
    await page.screenshot({ path: join(out, "live-no-camera.png") });
    await page.goto(`${place.address}#recordings`);
    await page.getByText("There are no recordings yet.").waitFor();
    await page.goto(`${place.address}#health`);
    await daemon.end();
    await says(page, "No contact");
    await page.getByText("Below is its last report.").waitFor();
    await page.screenshot({ path: join(out, "health-no-contact.png") });
  } finally {
    await close();
    await daemon.end();
  }
});
