#!/usr/bin/env node
// Makes the pictures of the page for the documents: every view in every theme,
// docs/page-VIEW-COLOURS.jpg, each of at most 60 kB. Look at them before a commit.
//   STAGEPOSE=target/release/stagepose PAGE_OUT=target/page tests/page/pictures.mjs
import { linkSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { PATIENCE, THEMES, freeze, launch, out, pageOf, until } from "./browser.mjs";
import { prepare, prepareShow, start } from "./daemon.mjs";

const docs = new URL("../../docs/", import.meta.url).pathname;
/** Bytes of a picture at most: a document has a dozen. */
const MOST = 60_000;
/** What is seen, and how much smaller it is drawn. */
const [SIZE, SCALE] = [{ width: 1280, height: 800 }, 0.75];

const browser = await launch();
// One where nothing happens, and a show that goes dark again and again.
const still = await prepare(join(out, "run-pictures-still"));
const place = await prepareShow(join(out, "run-pictures"), browser);
const daemons = [still, place].map(({ folder }) => start(folder, "long.mjpeg", []));
const wish = (path, content) => fetch(`${place.address}api/v1/${path}`, { method: "POST", ...(content ? { body: JSON.stringify(content) } : {}) });
const list = async () => (await fetch(`${place.address}api/v1/recordings`)).json();

/**
 * What each view is to show.
 * @type {Record<string, (page: import("playwright-core").Page) => Promise<unknown>>}
 */
const VIEWS = {
  async live(page) {
    await page.getByRole("button", { name: "Residuals" }).click();
    await page.locator(".picture .scale", { hasText: "Arrows" }).waitFor();
    await page.waitForTimeout(8000);
  },
  async set(page) {
    await page.locator(".aligned .figure", { hasText: /\d/ }).waitFor();
    await page.getByRole("button", { name: "+ cone" }).click();
    await page.getByRole("button", { name: "+ cube" }).click();
    const field = (label) => page.locator(".chosen").getByRole("textbox", { name: new RegExp(`^${label} `) });
    await page.locator(".chosen select").selectOption("0");
    await field("Right").fill("-0.6");
    await field("Out").fill("0.3");
    await page.waitForTimeout(3000);
  },
  async setup(page) {
    await page.getByRole("button", { name: /3 Stage/ }).click();
    await page.getByText("Poster", { exact: true }).click();
    await page.getByRole("button", { name: "Make the poster" }).click();
    await page.getByAltText("The poster").waitFor();
  },
  async recordings(page) {
    await page.locator(".recordings button").last().click();
    await page.getByRole("slider").waitFor();
    const again = page.getByRole("button", { name: "Track it again" });
    if ((await page.locator(".retracking table").count()) === 0) await again.click();
    await page.locator(".retracking table").waitFor({ timeout: 300_000 });
    // Where the stage has been tracked for a while.
    await page.evaluate(async () => {
      const { clip, go } = await import("/clip.js");
      const { columns } = clip.value;
      go(columns.findIndex((_, k) => k >= 30 && columns.slice(k - 30, k + 1).every(({ state }) => state === "tracking")));
    });
    await page.waitForTimeout(1500);
  },
  async health(page) {
    await page.locator(".card").filter({ hasText: "freed" }).getByText("Last packet").click();
    await page.locator("pre.hex").first().waitFor();
  },
};

try {
  await pageOf(browser, place.address).then(({ close }) => close());
  await wish("recordings/start");
  await until(list, ({ recordings }) => recordings[0]?.frames > 60);
  await wish("recordings/mark", { text: "cue 12" });
  await until(list, ({ recordings }) => recordings[0]?.frames > 2 * place.round);
  await wish("recordings/stop");
  await until(list, ({ recording }) => recording === null);
  // From now on nothing happens there either, or a picture says that the stage is lost.
  await daemons.pop()?.end();
  linkSync(join(still.folder, "long.mjpeg"), join(place.folder, "camera.mjpeg"));
  daemons.push(start(place.folder, "camera.mjpeg", []));
  for (const [name, prepared] of Object.entries(VIEWS)) {
    if (process.argv.length > 2 && !process.argv.includes(name)) continue;
    const { page, close } = await pageOf(browser, (["live", "set", "setup"].includes(name) ? still : place).address, { view: name, viewport: SIZE, deviceScaleFactor: SCALE, colorScheme: "dark", bypassCSP: true });
    // On a machine that is busy, a browser without a graphics card draws seldom.
    page.setDefaultTimeout(5 * PATIENCE);
    await prepared(page);
    // Without a graphics card a screenshot is not painted while frames come: freeze the picture,
    // and hide the caption that says so.
    if (await page.getByRole("button", { name: "Freeze", exact: true }).count()) {
      await freeze(page);
      // A frame whose residuals are known.
      while (name === "live" && !(await page.evaluate(async () => (await import("/daemon.js")).head.value?.displaced?.length))) {
        await page.getByRole("button", { name: "Freeze", exact: true }).click();
        await page.waitForTimeout(500);
        await freeze(page);
      }
      await page.addStyleTag({ content: ".picture figcaption { display: none; }" });
    }
    for (const theme of THEMES) {
      await page.getByLabel(theme, { exact: true }).check({ force: true });
      await page.waitForTimeout(1000);
      await until(() => page.locator("header .state").textContent(), (state) => state.includes("Tracking"));
      const file = join(docs, `page-${name}-${theme}.jpg`);
      let [quality, bytes] = [85, Buffer.alloc(0)];
      do bytes = await page.screenshot({ type: "jpeg", quality, timeout: 4 * PATIENCE });
      while (bytes.length > MOST && (quality -= 5) > 20);
      writeFileSync(file, bytes);
      console.log(`${file}: ${readFileSync(file).length} bytes at ${quality}`);
    }
    await close();
  }
} finally {
  await browser.close();
  for (const daemon of daemons) await daemon.end();
}
