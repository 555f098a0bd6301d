// Who may change something: the show lock, and pairing a browser on another machine by a code.
// Requirements: page.test.mjs.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { networkInterfaces } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { SIZES, looksWell, pageOf, until } from "./browser.mjs";
import { code, played, prepareShow } from "./daemon.mjs";

/** An address of this machine that is not loopback: who comes by it is a stranger. */
const own = Object.values(networkInterfaces()).flat().find((one) => one?.family === "IPv4" && !one.internal)?.address;

const on = played("run-access", async (folder, browser) => {
  const place = await prepareShow(folder, browser);
  const file = join(folder, "stage.toml");
  writeFileSync(file, readFileSync(file, "utf8").replace('listen = "127.0.0.1:', 'listen = "0.0.0.0:'));
  return place;
});
const opened = (options = {}) => pageOf(on.browser, on.place.address, { view: "recordings", ...options });
const isLocked = async () => (await (await fetch(`${on.place.address}api/v1/session`)).json()).locked;
const lock = (page) => page.locator("button.lock");

test("the show lock is put on by a press, keeps everything as it is, and is released by holding it, by hand and by key", async () => {
  const { page, complaints, close } = await opened();
  const record = page.getByRole("button", { name: "Record", exact: true });
  await record.waitFor();
  // It can be pressed once the page knows that a session runs.
  assert.equal(await until(() => record.isDisabled(), (off) => !off), false);
  await lock(page).click();
  await lock(page).filter({ hasText: "Locked" }).waitFor();
  assert.equal(await isLocked(), true);
  await page.getByText("The show lock is on: nothing can be changed.").waitFor();
  assert.equal(await record.isDisabled(), true);
  // A short press does nothing.
  await lock(page).click();
  await page.keyboard.press("r");
  await page.locator("header .refused", { hasText: "The show lock is on" }).waitFor();
  assert.equal(await isLocked(), true);
  // Held, by the mouse.
  const { x, y, width, height } = await lock(page).boundingBox();
  await page.mouse.move(x + width / 2, y + height / 2);
  await page.mouse.down();
  await lock(page).filter({ hasText: /^\s*Lock\s*$/ }).waitFor();
  await page.mouse.up();
  assert.equal(await isLocked(), false);
  assert.equal(await until(() => record.isDisabled(), (off) => !off), false);
  // And by the keyboard alone.
  await lock(page).focus();
  await page.keyboard.press("Enter");
  await lock(page).filter({ hasText: "Locked" }).waitFor();
  await page.keyboard.down("Space");
  await lock(page).filter({ hasText: /^\s*Lock\s*$/ }).waitFor();
  await page.keyboard.up("Space");
  assert.equal(await isLocked(), false);
  assert.deepEqual(complaints, []);
  await close();
});

test("the lock stays where it is, whatever the state and whatever is refused", async () => {
  const { page, close } = await opened();
  await lock(page).click();
  await lock(page).filter({ hasText: "Locked" }).waitFor();
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    const place = await lock(page).boundingBox();
    await page.keyboard.press("r");
    await page.locator("header .refused", { hasText: "The show lock is on" }).waitFor();
    // Between two frames, so that no true state comes between.
    const places = await page.evaluate(async () => {
      const { WORDS } = await import("/ui.js");
      const word = document.querySelector("header .state b");
      const told = word.textContent;
      const found = Object.entries(WORDS).map(([state, shown]) => {
        word.textContent = shown;
        const { x, y } = document.querySelector("button.lock").getBoundingClientRect();
        return { state, x, y };
      });
      word.textContent = told;
      return found;
    });
    assert.deepEqual(places, places.map(({ state }) => ({ state, x: place.x, y: place.y })), `at ${width}`);
  }
  await fetch(`${on.place.address}api/v1/unlock`, { method: "POST" });
  await close();
});

test("a lock that another page puts on is known here, and what is tried before that is refused with its sentence", async () => {
  const { page, close } = await opened();
  await page.getByText("Not recording.").waitFor();
  await fetch(`${on.place.address}api/v1/lock`, { method: "POST" });
  await page.getByText("The show lock is on: nothing can be changed.").waitFor();
  await fetch(`${on.place.address}api/v1/unlock`, { method: "POST" });
  await page.getByRole("button", { name: "Record", exact: true, disabled: false }).waitFor();
  await close();
});

test("a browser on another machine looks on, and changes nothing until it is paired", { skip: own ? false : "this machine has no address but loopback" }, async () => {
  const address = on.place.address.replace("127.0.0.1", own);
  const { page, complaints, close } = await pageOf(on.browser, address, { view: "recordings", bypassCSP: true });
  await page.getByText("This browser is not paired: it can show everything, but change nothing.").waitFor();
  assert.equal(await page.getByRole("button", { name: "Record", exact: true }).isDisabled(), true);
  // What only a paired browser gets asks for the code, too.
  await page.goto(`${address}#health`);
  await page.locator("pre.log", { hasText: "This browser is not paired" }).waitFor();
  assert.equal(await page.locator(".pairing").count(), 0);
  await page.getByRole("button", { name: "Download backup" }).click();
  await page.getByRole("button", { name: "Not now" }).click();
  await page.goto(`${address}#recordings`);
  await page.getByRole("button", { name: "Pair …" }).first().click();
  await page.getByLabel("Code").fill("0000 0000");
  await page.getByLabel("Name of this browser").fill("The test's tablet");
  await page.getByRole("button", { name: "Pair", exact: true }).click();
  await page.locator(".pairing .refused", { hasText: "This is not the code" }).waitFor();
  assert.equal(await page.getByLabel("Code").inputValue(), "0000 0000");
  await looksWell(on.browser, page, "pairing");
  await page.getByLabel("Code").fill(code(on.place));
  await page.getByLabel("Code").press("Enter");
  await page.locator(".pairing").waitFor({ state: "detached" });
  await page.getByRole("button", { name: "Record", exact: true, disabled: false }).click();
  await page.getByText(/^Recording clip-/).waitFor();
  // It stays paired.
  await page.reload();
  await page.getByRole("button", { name: "Stop recording", disabled: false }).click();
  await page.getByText("Not recording.").waitFor();
  assert.deepEqual(complaints.filter((one) => !one.includes("401")), []);
  await close();
});
