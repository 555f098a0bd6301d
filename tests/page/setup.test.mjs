// The Setup view: from an empty folder to a tracked stage, by the page alone. The daemon plays the
// fixture in place of a camera; browser.mjs has what is needed.
//   node --test tests/page/setup.test.mjs
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { existsSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, looksWell, out, pageOf, program, says, until } from "./browser.mjs";
import { snapped } from "../../src/web/page/steps/edges.js";
import { metres } from "../../src/web/page/steps/lengths.js";
import { locked } from "../../src/web/page/steps/locks.js";
import { prepareEmpty, startSetup } from "./daemon.mjs";

const FIXTURE = new URL("../../fixtures/dolly/", import.meta.url).pathname;
/** Key presses beyond text that the whole way may take. */
const PRESSES = 40;
/** Metres by which the camera may be misplaced: the middle one of the slow frames. */
const MISPLACED = 0.002;
/** The centre of the bottom edge is the origin: half the surface's height below its centre. */
const RAISED = 1.5;
/**
 * Pictures a second, and tracked records that are held against the truth: three times to and fro.
 */
const RATE = 30;
const RECORDS = 234;
/**
 * Metres between two frames up to which the camera is slow. On the way back the clip's rolling
 * shutter runs against the motion, as no camera's does: 3 mm where the camera is fast.
 */
const SLOW = 0.005;

/** @type {any} */
let browser;
before(async () => (browser = await launch()));
after(() => browser?.close());

/** Where the fixture's camera is, to and fro. */
function truth() {
  const lines = readFileSync(join(FIXTURE, "groundtruth.txt"), "utf8").split("\n").filter((line) => /^\d/.test(line));
  const there = lines.map((line) => line.split(" ").slice(1, 4).map(Number));
  return [...there, ...there.slice(1, -1).reverse()].map(([x, y, z]) => [x, y, z + RAISED]);
}

/** The next tracked records. */
function records(page) {
  return page.evaluate(
    (count) =>
      new Promise((done) => {
        const found = [];
        const socket = new WebSocket(`${location.origin.replace("http", "ws")}/ws`);
        socket.onmessage = ({ data }) => {
          const record = JSON.parse(data);
          if (record.state === "tracking") found.push({ at: record.timestamp_ns * 1e-9, position: record.pose.position_m });
          if (found.length < count) return;
          socket.close();
          done(found);
        };
      }),
    RECORDS,
  );
}

/** The middle one. @param {number[]} values */
const middle = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];
const distance = (a, b) => Math.hypot(...a.map((value, axis) => value - b[axis]));

/**
 * The middle distance of records from the truth, of all and of those where the camera is slow.
 * Which row a record is of is known but for where the clip began, which is the one that fits best.
 */
function misplaced(found) {
  const path = truth();
  const rows = found.map(({ at }) => Math.round((at - found[0].at) * RATE));
  const far = (begun) => found.map(({ position }, k) => distance(path[(begun + rows[k]) % path.length], position));
  const all = path.map((_, begun) => middle(far(begun)));
  const begun = all.indexOf(Math.min(...all));
  const isSlow = (row) => distance(path[row % path.length], path[(row + 1) % path.length]) <= SLOW;
  return { all: all[begun], slow: middle(far(begun).filter((_, k) => isSlow(begun + rows[k]))) };
}

/** A keyboard that counts its presses; text is not counted. */
function keyboard(page) {
  let count = 0;
  return {
    count: () => count,
    text: (text) => page.keyboard.type(text),
    async press(...keys) {
      for (const key of keys) {
        count += 1;
        await page.keyboard.press(key);
      }
    },
    /** Opens the chooser of files, and chooses one. */
    async choose(file) {
      const chooser = page.waitForEvent("filechooser");
      await this.press("Space");
      await (await chooser).setFiles(file);
    },
  };
}

const step = (page, name) => page.getByRole("heading", { name, exact: true, level: 2 }).waitFor();
const next = (page) => page.locator("button.primary[aria-disabled=false]").waitFor();
/** What a browser says of pages that are not there yet. */
const isNews = (complaint) => !/status of (404|422|503)/.test(complaint);

test("lengths are read as people type them", () => {
  for (const [typed, unit, length] of [
    ["4", "m", 4],
    ["4,25", "m", 4.25],
    [" .5 ", "m", 0.5],
    ["425", "cm", 4.25],
    ["13", "ft", 3.9624],
    ["13'", "ft", 3.9624],
    ["13' 1 1/2\"", "ft", 4.0005],
    ["13’1.5”", "ft", 4.0005],
    ["13 ft 1.5 in", "ft", 4.0005],
    ["13 1", "ft", 3.9878],
    ["0' 6\"", "ft", 0.1524],
    ["4 m", "m", null],
    ["", "m", null],
    ["-", "cm", null],
    ["1e3", "m", null],
    ["13' x", "ft", null],
    ["tall", "ft", null],
  ]) {
    const found = metres(typed, unit);
    assert.ok(length === null ? found === null : found !== null && Math.abs(found - length) < 1e-9, `${typed} ${unit}: ${found}`);
  }
});

/** A mottled surface on a darker ground, seen through a lens that bends its edges. */
function drawnSurface(corners, width, height, bend) {
  const straight = (x, y) => {
    const [u, v] = [(x - width / 2) / width, (y - height / 2) / width];
    const by = 1 + bend * (u * u + v * v);
    return [width / 2 + u * by * width, height / 2 + v * by * width];
  };
  const flat = corners.map(([x, y]) => straight(x, y));
  const isIn = ([x, y]) => flat.every(([ax, ay], k) => (flat[(k + 1) % 4][0] - ax) * (y - ay) - (flat[(k + 1) % 4][1] - ay) * (x - ax) > 0);
  let seed = 1;
  const noise = () => (seed = (seed * 1103515245 + 12345) & 0x7fffffff) / 0x7fffffff - 0.5;
  return Float32Array.from({ length: width * height }, (_, at) => {
    const [x, y] = [at % width, Math.floor(at / width)];
    let sum = 0;
    for (let k = 0; k < 16; k += 1) {
      const [u, v] = [x + (0.5 + (k % 4)) / 4 - 0.5, y + (0.5 + Math.floor(k / 4)) / 4 - 0.5];
      sum += isIn(straight(u, v)) ? 170 + 40 * Math.sin(u / 9) * Math.cos(v / 7) : 60 + 10 * Math.sin(u / 13);
    }
    return sum / 16 + 4 * noise();
  });
}

test("corners three pixels off snap to the edges, also to bent ones; without edges they stay", () => {
  const [width, height] = [640, 360];
  const truly = [[120.3, 60.7], [530.2, 80.4], [510.6, 300.1], [100.9, 290.5]];
  const off = [[2, -2], [-3, 0], [2, 2], [-1, -2.8]];
  const begun = truly.map(([x, y], k) => [x + off[k][0], y + off[k][1]]);
  for (const bend of [0, -0.11, 0.15]) {
    const found = snapped({ grey: drawnSurface(truly, width, height, bend), width, height }, begun);
    const far = found.map((one, k) => (one === null ? Infinity : Math.hypot(one.at[0] - truly[k][0], one.at[1] - truly[k][1])));
    console.log(`bend ${bend}: ${far.map((px) => px.toFixed(3)).join(", ")} px from the truth`);
    assert.ok(far.every((px) => px <= 0.3), `${far}`);
    assert.ok(found.every((one) => one.sigma < 0.3), JSON.stringify(found));
  }
  const plain = new Float32Array(width * height).fill(90);
  assert.deepEqual(snapped({ grey: plain, width, height }, begun), [null, null, null, null]);
});

test("a lock ends the automatics of a camera, and holds what they changed", () => {
  const of = (pairs) => Object.entries(pairs).map(([name, value]) => ({ name, value }));
  assert.deepEqual(locked(of({ brightness: 3, auto_exposure: 3, exposure_time_absolute: 157, focus_automatic_continuous: 1, focus_absolute: 30, white_balance_automatic: 1, white_balance_temperature: null })), {
    auto_exposure: 1, focus_automatic_continuous: 0, white_balance_automatic: 0, exposure_time_absolute: 157, focus_absolute: 30,
  });
  assert.deepEqual(locked(of({ exposure_auto: 3, exposure_absolute: 9, exposure_auto_priority: 1 })), { exposure_auto: 1, exposure_auto_priority: 0, exposure_absolute: 9 });
  assert.deepEqual(locked(of({ brightness: 3 })), {}, "a camera without automatics has nothing to lock");
});

test("from an empty folder to tracking by keyboard alone; a reload loses nothing", async () => {
  const place = await prepareEmpty(join(out, "run-setup"));
  const daemon = startSetup(place);
  const { page, complaints, asked, close } = await pageOf(browser, place.address, { view: "", state: "Searching" });
  try {
    const keys = keyboard(page);
    // It begins here, for there is no config.
    await step(page, "Camera");
    await page.getByText("long.mjpeg").waitFor();
    const brightness = () => page.evaluate(() => {
      const copy = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
      copy.drawImage(document.querySelector(".picture canvas"), 0, 0, 1, 1);
      return copy.getImageData(0, 0, 1, 1).data[0];
    });
    assert.ok((await until(brightness, (level) => level > 0)) > 0, "the camera is shown before there is a config");
    await next(page);
    await keys.press("Enter");
    await step(page, "Lens");
    await keys.press("Shift+Tab", "ArrowRight", "Tab");
    await keys.choose(join(FIXTURE, "camera.toml"));
    await page.getByText("640 x 360 pixels").waitFor();
    await keys.press("Tab", "Enter");
    await step(page, "Stage");
    await keys.choose(join(FIXTURE, "backdrop.png"));
    await page.getByAltText("The artwork").waitFor();
    await page.reload();
    await step(page, "Stage");
    await page.getByAltText("The artwork").waitFor();
    await next(page);
    await keys.press("Tab", "Enter");
    await step(page, "Sizes");
    await keys.text("4");
    await keys.press("Tab");
    await keys.text("3,0");
    await page.reload();
    await step(page, "Sizes");
    assert.deepEqual([await page.getByLabel("Width").inputValue(), await page.getByLabel("Height").inputValue()], ["4", "3,0"]);
    await next(page);
    await keys.press("Enter");
    await step(page, "Origin");
    await keys.press("Tab", "Enter");
    await step(page, "Check");
    await next(page);
    await keys.press("Enter");
    await says(page, "Tracking");
    await page.getByText(/Written to .*stage\.toml/).waitFor();
    console.log(`${keys.count()} key presses`);
    assert.ok(keys.count() <= PRESSES, `${keys.count()} key presses`);
    const { all, slow } = misplaced(await records(page));
    console.log(`${(1000 * slow).toFixed(3)} mm from the truth, ${(1000 * all).toFixed(3)} mm with the fast frames`);
    assert.ok(slow <= MISPLACED, `${1000 * slow} mm`);
    assert.deepEqual([...asked], [new URL(place.address).host]);
    assert.deepEqual(complaints.filter(isNews), []);
  } finally {
    await page.screenshot({ path: join(out, "setup-end.png") });
    await close();
    await daemon.end();
  }
  const { status, stdout, stderr } = spawnSync(program, ["check", "--config", "stage.toml"], { cwd: place.folder, encoding: "utf8" });
  assert.equal(status, 0, `${stdout}${stderr}`);
});

test("the corners of a frozen picture are dragged and moved by keys, and taken back", async () => {
  const place = await prepareEmpty(join(out, "run-setup-freeze"));
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup", state: "Searching", bypassCSP: true });
  try {
    await page.getByRole("button", { name: /3 Stage/ }).click();
    await page.getByText("Freeze the picture", { exact: true }).click();
    await page.getByRole("button", { name: "Freeze", exact: true }).click();
    await page.getByAltText("The frozen picture").waitFor();
    const corners = () => page.evaluate(async () => (await import("/steps/draft.js")).shown.value.corners);
    const begun = await corners();
    assert.deepEqual(begun, [[128, 72], [512, 72], [512, 288], [128, 288]]);
    const handle = (name) => page.getByRole("button", { name: new RegExp(`^Corner \\d, ${name}`) });
    await handle("top left").focus();
    for (const key of ["ArrowLeft", "Shift+ArrowUp", "Alt+ArrowRight"]) await page.keyboard.press(key);
    assert.deepEqual((await corners())[0], [127.1, 62]);
    await page.keyboard.press("Tab");
    await page.keyboard.press("ArrowDown");
    assert.deepEqual((await corners())[1], [512, 73]);
    const box = await handle("bottom right").boundingBox();
    const width = await page.locator(".corners").evaluate((figure) => figure.clientWidth);
    const [x, y] = [box.x + 30, box.y + 30];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + 20, y - 10, { steps: 4 });
    await page.mouse.up();
    const [, , [cx, cy]] = await corners();
    const scale = 640 / width;
    assert.ok(Math.abs(cx - 512 - 20 * scale) < 0.02 && Math.abs(cy - 288 + 10 * scale) < 0.02, `${cx}, ${cy}`);
    // A corner stays in the picture.
    await page.reload();
    await page.getByAltText("The frozen picture").waitFor();
    assert.deepEqual((await corners())[2], [cx, cy], "nothing is lost");
    for (let k = 0; k < 5; k += 1) await page.getByRole("button", { name: "Undo" }).click();
    assert.deepEqual(await corners(), begun);
    // Corners that cross are no surface.
    await handle("top left").focus();
    for (let k = 0; k < 45; k += 1) await page.keyboard.press("Shift+ArrowRight");
    await page.getByText("The corners do not go round the surface.").waitFor();
    await page.getByRole("button", { name: /4 Sizes/ }).click();
    await page.getByRole("button", { name: /3 Stage/ }).click();
    await looksWell(browser, page, "setup-stage");
  } finally {
    await close();
    await daemon.end();
  }
});

test("each step says what is wrong and what to do", async () => {
  const place = await prepareEmpty(join(out, "run-setup-wrong"));
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup", state: "Searching", bypassCSP: true });
  const open = (name) => page.getByRole("button", { name: new RegExp(`\\d ${name}`) }).click();
  const choose = (name, buffer) => page.locator("input[type=file]").setInputFiles({ name, mimeType: "", buffer });
  try {
    await open("Lens");
    await page.getByLabel("Field of view across").fill("600");
    await page.getByText("5 to 170").waitFor();
    await page.getByLabel("Field of view across").fill("58,1");
    await page.getByText("Calibration file", { exact: true }).click();
    await choose("camera.toml", Buffer.from("fx = 1\n"));
    await page.locator(".refused", { hasText: /camera\.toml/ }).waitFor();
    await page.getByText("Guess its field of view", { exact: true }).click();
    assert.equal(await page.getByLabel("Field of view across").inputValue(), "58,1");
    await open("Stage");
    await choose("IMG_1.HEIC", Buffer.from("\0\0\0\x18ftypheic\0\0\0\0mif1heic\0\0\0\x08free", "latin1"));
    await page.locator(".refused", { hasText: /HEIC.*heif-convert/ }).waitFor();
    await choose("the backdrop.png", readFileSync(join(FIXTURE, "backdrop.png")));
    await page.getByText(/the-backdrop\.png, \d+ x \d+ pixels/).waitFor();
    await open("Sizes");
    await page.getByLabel("Measured in").selectOption("ft");
    await page.getByLabel("Width").fill("13' 1 1/2\"");
    await page.getByText("4.001 m").waitFor();
    await page.getByLabel("Height").fill("8");
    await page.locator(".warned", { hasText: "Measure again" }).waitFor();
    await looksWell(browser, page, "setup-sizes");
    await open("Check");
    await page.getByText("The config is complete.").waitFor();
    assert.ok(!existsSync(join(place.folder, "stage.toml")), "nothing is written before it is wanted");
    await open("Outputs");
    await page.getByLabel("Address and port").fill("no-such-host.invalid:99999");
    await page.getByRole("button", { name: "Add" }).click();
    await page.locator(".findings .error").waitFor();
    await page.getByRole("button", { name: "Remove" }).click();
    await page.locator(".findings .error").waitFor({ state: "detached" });
    await open("Camera");
    await looksWell(browser, page, "setup-camera");
  } finally {
    await close();
    await daemon.end();
  }
});

test("a daemon that ends takes nothing along; another browser asks before it replaces a config", async () => {
  const place = await prepareEmpty(join(out, "run-setup-two"));
  let daemon = startSetup(place);
  const opened = () => pageOf(browser, place.address, { view: "setup", state: "" });
  const primary = (page) => page.locator("button.primary[aria-disabled=false]");
  const fill = async (page, width) => {
    await page.getByRole("button", { name: /3 Stage/ }).click();
    await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "backdrop.png"));
    await page.getByAltText("The artwork").waitFor();
    await page.getByRole("button", { name: /4 Sizes/ }).click();
    await page.getByLabel("Width").fill(width);
    await page.getByLabel("Height").fill("3");
  };
  const first = await opened();
  const second = await opened();
  try {
    await fill(first.page, "4");
    await daemon.end();
    await says(first.page, "No contact");
    await first.page.getByLabel("Width").fill("4.0");
    await first.page.getByRole("button", { name: /6 Check/ }).click();
    daemon = startSetup(place);
    await primary(first.page).click();
    await first.page.getByText(/Written to/).waitFor();
    const file = join(place.folder, "stage.toml");
    assert.match(readFileSync(file, "utf8"), /size_m = \[4\.0, 3\.0\]/);
    await fill(second.page, "4.1");
    await second.page.getByRole("button", { name: /6 Check/ }).click();
    await primary(second.page).click();
    await second.page.getByText("holds another config").waitFor();
    assert.match(readFileSync(file, "utf8"), /size_m = \[4\.0, 3\.0\]/, "nothing is replaced unasked");
    await second.page.getByRole("button", { name: "Replace it" }).click();
    await second.page.getByText(/Written to/).waitFor();
    assert.match(readFileSync(file, "utf8"), /size_m = \[4\.1, 3\.0\]/);
    const [former] = readdirSync(join(place.folder, "former"));
    assert.match(readFileSync(join(place.folder, "former", former, "stage.toml"), "utf8"), /size_m = \[4\.0, 3\.0\]/);
    // Its own config it changes without a question.
    await second.page.getByRole("button", { name: /4 Sizes/ }).click();
    await second.page.getByLabel("Width").fill("4.05");
    await second.page.getByRole("button", { name: /6 Check/ }).click();
    await primary(second.page).click();
    await until(() => Promise.resolve(readFileSync(file, "utf8")), (text) => text.includes("4.05"));
    assert.match(readFileSync(file, "utf8"), /size_m = \[4\.05, 3\.0\]/);
  } finally {
    await first.page.screenshot({ path: join(out, "setup-two-first.png") });
    await second.page.screenshot({ path: join(out, "setup-two-second.png") });
    await first.close();
    await second.close();
    await daemon.end();
  }
});
