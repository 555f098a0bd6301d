// A browser before the page of a daemon, for the tests.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

/** Where the packages are and screenshots go. */
export const out = resolve(process.env.PAGE_OUT ?? "target/page");
/** The program under test. */
export const program = resolve(process.env.STAGEPOSE ?? "target/release/stagepose");
const { chromium } = createRequire(join(out, "package.json"))("playwright-core");
/** A judge of accessibility, as a script. */
export const axe = readFileSync(createRequire(join(out, "package.json")).resolve("axe-core/axe.min.js"), "utf8");
/** The page's files instead of the program's, to try a change before it is built. */
export const files = process.env.PAGE_DIR && resolve(process.env.PAGE_DIR);

/** Widths of a phone, a tablet and a desk, with their heights. */
export const SIZES = [
  [360, 740],
  [820, 1180],
  [1440, 900],
];
export const THEMES = ["dark", "light", "stage"];
/** Milliseconds that anything may take before a test gives up; nothing is judged by time. */
export const PATIENCE = 60_000;

/** A browser that draws in 3D without a graphics card. */
export function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", ...(files ? ["--disable-features=LocalNetworkAccessChecks"] : [])],
  });
}

/** Waits until the daemon answers. @param {string} address */
export async function answers(address) {
  for (const begun = Date.now(); ; ) {
    try {
      return await fetch(address);
    } catch (error) {
      if (Date.now() - begun > PATIENCE) throw error;
      await new Promise((done) => setTimeout(done, 200));
    }
  }
}

/** Serves a file of the page from PAGE_DIR, with the headers that the program sends. */
async function fromFiles(route, address) {
  const { pathname } = new URL(route.request().url());
  if (pathname.startsWith("/api/")) return route.continue();
  const file = pathname === "/" ? "index.html" : pathname.slice(1);
  const type = { html: "text/html", js: "text/javascript", css: "text/css", svg: "image/svg+xml", txt: "text/plain" }[file.split(".").pop()];
  // Without a daemon there are no files either.
  const answer = await fetch(address).catch(() => null);
  if (answer === null) return route.abort();
  const policy = answer.headers.get("content-security-policy");
  return route.fulfill({ body: readFileSync(join(files, file)), headers: { "content-type": type, "content-security-policy": policy } });
}

/**
 * Opens a page and waits for its state; collects its errors and warnings. `view` is the part of its
 * address after the hash.
 */
export async function pageOf(browser, address, { view = "live", state = "Tracking", ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, bypassCSP: false, ...options });
  if (files) await context.route("**/*", (route) => fromFiles(route, address));
  context.setDefaultTimeout(PATIENCE);
  const page = await context.newPage();
  const complaints = [];
  const asked = new Set();
  page.on("console", (said) => ["error", "warning"].includes(said.type()) && complaints.push(said.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  page.on("request", (request) => asked.add(new URL(request.url()).host));
  await page.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`));
  });
  // The daemon may still be starting.
  await answers(address);
  await page.goto(`${address}#${view}`);
  await says(page, state);
  return { page, complaints, asked, close: () => context.close() };
}

/**
 * Takes a picture of a view in every theme and width. Each must fit and be accessible; the stage
 * theme must have no light but amber. The page needs `bypassCSP`: the judge is a script of its own.
 */
export async function looksWell(browser, page, name) {
  for (const theme of THEMES) {
    await page.getByLabel(theme, { exact: true }).check({ force: true });
    for (const [width, height] of SIZES) {
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(150);
      const png = await page.screenshot({ path: join(out, `${name}-${theme}-${width}.png`) });
      const room = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert.ok(room <= 0, `${name}, ${theme} at ${width}: ${room} px sideways`);
      if (theme === "stage") assert.equal(await share(browser, png, "g > 140 || b > 40"), 0, `${name} at ${width}`);
      await page.addScriptTag({ content: axe });
      const { violations } = await page.evaluate(() => axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"] }));
      assert.deepEqual(violations.map(({ id, nodes }) => `${name}, ${theme} ${width}: ${id} ${nodes[0].html}`), []);
    }
  }
}

/** Waits for a state in the bar. */
export async function says(page, state) {
  await page.locator("header .state", { hasText: state }).waitFor({ timeout: PATIENCE });
}

/**
 * Freezes the picture at a frame with a pose: where the clip turns round, or on a busy machine, one
 * may have none.
 */
export async function freeze(page) {
  const button = page.getByRole("button", { name: "Freeze", exact: true });
  for (;;) {
    await button.click();
    await page.locator("button[aria-pressed=true]", { hasText: "Freeze" }).waitFor();
    const isPosed = await page.evaluate(async () => Boolean((await import("/daemon.js")).head.value?.record.pose));
    if (isPosed) return;
    await button.click();
    await page.waitForTimeout(100);
  }
}

/**
 * Repeats a question until the answer is right; returns the last answer.
 * @template T
 * @param {() => Promise<T>} asked
 * @param {(found: T) => boolean} isRight
 * @returns {Promise<T>}
 */
export async function until(asked, isRight) {
  for (const begun = Date.now(); ; ) {
    const found = await asked();
    if (isRight(found) || Date.now() - begun > PATIENCE) return found;
    await new Promise((done) => setTimeout(done, 50));
  }
}

/** The share of a PNG's pixels for which a condition holds, an expression of r, g and b. */
export async function share(browser, png, condition) {
  const page = await browser.newPage();
  const counted = await page.evaluate(
    async ([base64, condition]) => {
      const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
      const picture = await createImageBitmap(new Blob([bytes]));
      const canvas = new OffscreenCanvas(picture.width, picture.height);
      const context = canvas.getContext("2d");
      context.drawImage(picture, 0, 0);
      const { data } = context.getImageData(0, 0, picture.width, picture.height);
      const holds = new Function("r", "g", "b", `return ${condition}`);
      let count = 0;
      for (let k = 0; k < data.length; k += 4) count += holds(data[k], data[k + 1], data[k + 2]) ? 1 : 0;
      return count / (data.length / 4);
    },
    [png.toString("base64"), condition],
  );
  await page.close();
  return counted;
}
