#!/usr/bin/env node
// Makes the pictures of the page for the documents: every view in every colours, docs/page-VIEW-COLOURS.jpg, each of at most 60 kB. They are to be looked at.
//   STAGEPOSE=target/release/stagepose PAGE_OUT=target/page tests/page/pictures.mjs
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { PATIENCE, THEMES, freeze, launch, out, pageOf, until } from "./browser.mjs";
import { prepareShow, start } from "./daemon.mjs";

const docs = new URL("../../docs/", import.meta.url).pathname;
/** Bytes of a picture at most: a document has a dozen. */
const MOST = 60_000;
/** What is seen, and how much smaller it is drawn. */
const [SIZE, SCALE] = [{ width: 1280, height: 800 }, 0.75];

const browser = await launch();
const place = await prepareShow(join(out, "run-pictures"), browser);
const daemon = start(place.folder, "long.mjpeg", []);
const wish = (path, content) => fetch(`${place.address}api/v1/${path}`, { method: "POST", ...(content ? { body: JSON.stringify(content) } : {}) });
const list = async () => (await fetch(`${place.address}api/v1/recordings`)).json();

/** What each view is to show. @type {Record<string, (page: import("playwright-core").Page) => Promise<unknown>>} */
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
  async recordings(page) {
    await page.locator(".recordings button").last().click();
    await page.getByRole("slider").waitFor();
    const again = page.getByRole("button", { name: "Track it again" });
    if ((await page.locator(".retracking table").count()) === 0) await again.click();
    await page.locator(".retracking table").waitFor({ timeout: 300_000 });
    await page.evaluate(async () => (await import("/clip.js")).go(40));
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
  for (const [name, prepare] of Object.entries(VIEWS)) {
    if (process.argv.length > 2 && !process.argv.includes(name)) continue;
    const { page, close } = await pageOf(browser, place.address, { view: name, viewport: SIZE, deviceScaleFactor: SCALE, colorScheme: "dark", bypassCSP: true });
    await prepare(page);
    // A browser without a graphics card paints no pictures beside those that come. What says so is not what the page looks like.
    if (await page.getByRole("button", { name: "Freeze", exact: true }).count()) {
      await freeze(page);
      await page.addStyleTag({ content: ".picture figcaption { display: none; }" });
    }
    for (const theme of THEMES) {
      await page.getByLabel(theme, { exact: true }).check({ force: true });
      await until(() => page.locator("header .state").textContent(), (state) => state.includes("Tracking"));
      await page.waitForTimeout(1000);
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
  await daemon.end();
}
