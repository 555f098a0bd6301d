// The set-up beyond the shortest way: by touch on a phone, with a poster, from a config that exists,
// drafts of several browsers, the pan that is checked and the walk that is measured.
//   node --test tests/page/wizard.test.mjs
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { copyFileSync, existsSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, looksWell, out, pageOf, program, says } from "./browser.mjs";
import { prepareEmpty, startSetup } from "./daemon.mjs";

const FIXTURE = new URL("../../fixtures/dolly/", import.meta.url).pathname;
/** A phone. */
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };

/** @type {any} */
let browser;
before(async () => (browser = await launch()));
after(() => browser?.close());

const step = (page, name) => page.getByRole("heading", { name, exact: true, level: 2 }).waitFor();
const next = (page) => page.locator("button.primary[aria-disabled=false]");
const open = (page, name) => page.getByRole("button", { name: new RegExp(`\\d ${name}`) }).click();
/** The draft as this page has it. */
const draftOf = (page) => page.evaluate(async () => (await import("/steps/draft.js")).draft.value);
/** Waits until this is true in the page; `waitForFunction` takes any promise for true. */
async function becomes(page, isTrue) {
  const end = Date.now() + 30_000;
  while (!(await page.evaluate(isTrue))) {
    assert.ok(Date.now() < end, `not within 30 s: ${isTrue}`);
    await page.waitForTimeout(100);
  }
}

/** Waits until the daemon has what this page has. */
const kept = (page) =>
  becomes(page, async () => {
    const { edited } = (await import("/steps/draft.js")).draft.value;
    return edited > 0 && (await (await fetch("/api/v1/setup/draft")).json())?.edited === edited;
  });

/** Waits until the field with this label has this value; the field may be drawn anew meanwhile. */
async function holds(page, label, value) {
  const end = Date.now() + 30_000;
  while (Date.now() < end && (await page.getByLabel(label).inputValue()) !== value) await page.waitForTimeout(100);
  assert.equal(await page.getByLabel(label).inputValue(), value);
}

/** Fills the shortest way: lens, artwork, sizes. */
async function fill(page) {
  await open(page, "Lens");
  await page.getByText("Calibration file", { exact: true }).click();
  await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "camera.toml"));
  await page.getByText("640 x 360 pixels").waitFor();
  await open(page, "Stage");
  await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "backdrop.png"));
  await page.getByAltText("The artwork").waitFor();
  await open(page, "Sizes");
  await page.getByLabel("Width").fill("4");
  await page.getByLabel("Height").fill("3");
}

/** Writes the config and waits until it tracks. */
async function track(page) {
  await open(page, "Check");
  await next(page).click();
  await page.getByText(/Written to .*stage\.toml/).waitFor();
  await says(page, "Tracking");
}

test("by touch on a phone from an empty folder to tracking; a second browser goes on from there", async () => {
  const place = await prepareEmpty(join(out, "run-wizard-phone"));
  let daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "", state: "Searching", ...PHONE });
  try {
    await step(page, "Camera");
    await next(page).tap();
    await step(page, "Lens");
    await page.getByText("Calibration file", { exact: true }).tap();
    await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "camera.toml"));
    await page.getByText("640 x 360 pixels").waitFor();
    await next(page).tap();
    await step(page, "Stage");
    await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "backdrop.png"));
    await page.getByAltText("The artwork").waitFor();
    await next(page).tap();
    await step(page, "Sizes");
    await page.getByLabel("Width").fill("4");
    await page.getByLabel("Height").fill("3");
    await kept(page);
    // The daemon ends, and a browser that never saw this has all of it.
    await daemon.end();
    daemon = startSetup(place);
    const other = await pageOf(browser, place.address, { view: "setup", state: "Searching" });
    await other.page.getByRole("button", { name: /4 Sizes/ }).click();
    await becomes(other.page, async () => (await import("/steps/draft.js")).draft.value.edited > 0);
    await holds(other.page, "Width", "4");
    await holds(other.page, "Height", "3");
    await other.close();
    await says(page, "Searching");
    await next(page).tap();
    await step(page, "Origin");
    await next(page).tap();
    await step(page, "Check");
    await next(page).tap();
    await says(page, "Tracking");
    const size = await page.evaluate(() => [document.documentElement.scrollWidth - innerWidth, Math.min(...[...document.querySelectorAll(".step button, .progress button")].map((one) => one.getBoundingClientRect().height))]);
    assert.ok(size[0] <= 0 && size[1] >= 24, `${size}`);
  } finally {
    await page.screenshot({ path: join(out, "wizard-phone.png"), fullPage: true });
    await close();
    await daemon.end();
  }
  assert.equal(spawnSync(program, ["check", "--config", "stage.toml"], { cwd: place.folder }).status, 0);
});

test("two browsers that change the set-up at once lose nothing", async () => {
  const place = await prepareEmpty(join(out, "run-wizard-two"));
  const daemon = startSetup(place);
  const opened = () => pageOf(browser, place.address, { view: "setup", state: "Searching" });
  const [first, second] = [await opened(), await opened()];
  const fov = (page) => page.getByLabel("Field of view across");
  try {
    for (const { page } of [first, second]) await open(page, "Lens");
    await fov(first.page).fill("61");
    await kept(first.page);
    await fov(second.page).fill("62");
    await second.page.getByText("Another browser changed this set-up as well").waitFor();
    assert.equal(await fov(second.page).inputValue(), "62", "what is typed stays");
    await second.page.getByRole("button", { name: "Keep what is here" }).click();
    await kept(second.page);
    await fov(first.page).fill("63");
    await first.page.getByText("Another browser changed this set-up as well").waitFor();
    await first.page.getByRole("button", { name: "Take the other" }).click();
    assert.equal(await fov(first.page).inputValue(), "62");
  } finally {
    await first.close();
    await second.close();
    await daemon.end();
  }
});

test("a poster is made, and its size is known; several surfaces are written, origins by points too", async () => {
  const place = await prepareEmpty(join(out, "run-wizard-poster"));
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup", state: "Searching", bypassCSP: true });
  // A busy machine paints a poster for a minute.
  page.setDefaultTimeout(240_000);
  try {
    await open(page, "Stage");
    await page.getByText("Poster", { exact: true }).click();
    await page.getByRole("button", { name: "Make the poster" }).click();
    await page.getByAltText("The poster").waitFor();
    const sheet = await page.request.get(`${place.address}api/v1/prints/poster-a3-1.pdf`);
    assert.ok(sheet.ok() && (await sheet.body()).subarray(0, 4).toString() === "%PDF");
    await looksWell(browser, page, "wizard-poster");
    await page.getByRole("button", { name: "+ Surface" }).click();
    await page.locator("input[type=file]").setInputFiles(join(FIXTURE, "flat.png"));
    await page.getByAltText("The artwork").waitFor();
    await page.getByLabel("to its right").fill("1,5");
    await page.getByLabel("Turned to the left").fill("20");
    await open(page, "Sizes");
    await page.getByRole("button", { name: "Surface 2" }).click();
    await page.getByLabel("Width").fill("1.2");
    await page.getByLabel("Height").fill("2.4");
    await open(page, "Origin");
    await page.getByText("Three points", { exact: true }).click();
    const { surfaces } = await draftOf(page);
    const [width, height] = [surfaces[0].width, surfaces[0].height].map(Number);
    assert.ok(width > 0.2 && height > 0.2, `${width} x ${height}`);
    const rows = [[0, 5, 1], [width, 5, 1], [0, 5, 1 + height]];
    for (const [k, at] of rows.entries()) {
      for (const [axis, name] of ["to the right", "upstage", "up"].entries()) await page.getByLabel(new RegExp(`^${name}\\s*m?$`)).nth(k).fill(`${at[axis]}`);
    }
    assert.equal(await page.locator(".warned").count(), 0);
    await page.getByLabel(/^to the right/).nth(1).fill(`${width + 0.05}`);
    await page.locator(".warned", { hasText: "Measure again" }).waitFor();
    await page.getByLabel(/^to the right/).nth(1).fill(`${width}`);
    await looksWell(browser, page, "wizard-origin");
    await open(page, "Check");
    await page.getByText("The config is complete.").waitFor();
    await next(page).click();
    await page.getByText(/Written to .*stage\.toml/).waitFor();
    const text = readFileSync(join(place.folder, "stage.toml"), "utf8");
    assert.match(text, /image = "prints\/poster-a3-1-picture\.png"/);
    assert.match(text, /rotation_deg = \[20\.0, 0\.0, 0\.0\]/);
    assert.match(text, /"top left" = \[0\.0, 5\.0, 1\./);
    // On paper there is the sheet alone.
    await open(page, "Outputs");
    await page.emulateMedia({ media: "print" });
    assert.ok((await page.locator(".sheet").isVisible()) && !(await page.locator(".picture").isVisible()) && !(await page.locator("header").isVisible()));
    assert.match(await page.locator(".sheet").innerText(), /poster-a3-1-picture\.png, 0\.2/);
    await page.emulateMedia({ media: "screen" });
  } finally {
    await page.screenshot({ path: join(out, "wizard-poster-end.png") });
    await close();
    await daemon.end();
  }
  const { status, stdout, stderr } = spawnSync(program, ["check", "--config", "stage.toml", "--no-device"], { cwd: place.folder, encoding: "utf8" });
  assert.equal(status, 0, `${stdout}${stderr}`);
  assert.match(stdout, /surface 2|stage surface 2|flat/i);
});

test("the steps go on from a config that exists, and keep what they do not show", async () => {
  const place = await prepareEmpty(join(out, "run-wizard-config"));
  for (const name of ["backdrop.png", "flat.png", "camera.toml"]) copyFileSync(join(FIXTURE, name), join(place.folder, name));
  const file = join(place.folder, "stage.toml");
  const more = '\n[recorder]\nring_s = 5.0\n\n[[output]]\nkind = "osc"\nname = "desk"\nto = ["127.0.0.1:9000"]\nrate_hz = 50.0\n';
  writeFileSync(file, `${readFileSync(join(FIXTURE, "stage.toml"), "utf8")}${more}`);
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup" });
  try {
    await becomes(page, async () => (await import("/steps/draft.js")).draft.value.edited > 0);
    await open(page, "Sizes");
    await holds(page, "Width", "4");
    await holds(page, "Height", "3");
    assert.equal((await draftOf(page)).surfaces.length, 2);
    const before = await page.evaluate(async () => (await (await fetch("/api/v1/scene")).json()).stage.surfaces.map(({ pose }) => pose.position_m));
    await page.getByLabel("Width").fill("4.01");
    await open(page, "Check");
    await next(page).click();
    await page.getByText(/Written to .*stage\.toml/).waitFor();
    const text = readFileSync(file, "utf8");
    assert.match(text, /size_m = \[4\.01, 3\.0\]/);
    assert.match(text, /\[recorder\]\nring_s = 5\.0/);
    assert.match(text, /name = "desk"/);
    assert.match(text, /rate_hz = 50\.0/);
    await says(page, "Tracking");
    const now = await page.evaluate(async () => (await (await fetch("/api/v1/scene")).json()).stage.surfaces.map(({ pose }) => pose.position_m));
    for (const [k, at] of before.entries()) for (const [axis, value] of at.entries()) assert.ok(Math.abs(now[k][axis] - value) < 1e-6, `${now} is not ${before}`);
  } finally {
    await close();
    await daemon.end();
  }
});

/** Milliseconds that the daemon's own work may take on a busy machine. */
const LONG = 900_000;
/** Tests that wait for such work take minutes. */
const long = { skip: process.env.PAGE_LONG ? false : "it takes minutes: PAGE_LONG=1 runs it" };

test("a pan is checked, and each finding is said", long, async () => {
  const place = await prepareEmpty(join(out, "run-wizard-pan"));
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup", state: "Searching", bypassCSP: true });
  page.setDefaultTimeout(LONG);
  try {
    await fill(page);
    await track(page);
    await page.getByRole("button", { name: "Begin the pan" }).click();
    await page.getByRole("timer").waitFor();
    await page.getByRole("region", { name: "What the pan showed" }).waitFor();
    assert.ok(Number.parseInt(await page.locator(".pan .facts dd").first().textContent(), 10) > 50);
    await looksWell(browser, page, "wizard-check");
  } finally {
    await page.screenshot({ path: join(out, "wizard-pan-end.png") });
    await close();
    await daemon.end();
  }
});

test("a click in the live picture moves the origin; a walk is guided, cancelled, and measured", long, async () => {
  const place = await prepareEmpty(join(out, "run-wizard-walk"));
  const daemon = startSetup(place);
  const { page, close } = await pageOf(browser, place.address, { view: "setup", state: "Searching", bypassCSP: true });
  try {
    await fill(page);
    await track(page);
    // A click in the middle of the picture is on the backdrop: the origin moves there.
    await open(page, "Origin");
    const box = await page.locator(".picture").boundingBox();
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    const { at } = await draftOf(page);
    const moved = at.map(Number);
    assert.ok(Math.abs(moved[1]) < 0.05 && moved[2] < -0.3 && moved[2] > -3, `${at}`);
    await looksWell(browser, page, "wizard-cube");
    await open(page, "Stage");
    await page.getByRole("button", { name: "Walk", exact: true }).click();
    await page.getByRole("button", { name: "Begin the walk" }).click();
    await page.getByLabel("What is still missing").waitFor();
    await page.waitForTimeout(4000);
    await page.getByRole("button", { name: "End the walk" }).click();
    await page.getByRole("button", { name: "Measure the surface" }).click();
    await page.getByRole("button", { name: "Cancel" }).click();
    await page.locator(".refused", { hasText: "cancelled" }).waitFor();
    await page.getByRole("button", { name: "Measure the surface" }).click();
    page.setDefaultTimeout(LONG);
    await page.getByRole("region", { name: "What the walk measured" }).waitFor();
    await looksWell(browser, page, "wizard-walk");
    assert.ok(existsSync(join(place.folder, "walks")));
  } finally {
    await page.screenshot({ path: join(out, "wizard-walk-end.png") });
    await close();
    await daemon.end();
  }
});
