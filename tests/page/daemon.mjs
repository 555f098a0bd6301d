// A true daemon that plays the fixture to and fro as its camera, with its page on a free port.
import { spawn, spawnSync } from "node:child_process";
import { createHash } from "node:crypto";
import {
  closeSync, copyFileSync, existsSync, linkSync, mkdirSync, openSync, readFileSync, readdirSync, renameSync, rmSync, symlinkSync, writeFileSync, writeSync,
} from "node:fs";
import { createServer } from "node:net";
import { extname, join } from "node:path";
import { after, before } from "node:test";
import { launch, out, program } from "./browser.mjs";

const FIXTURE = new URL("../../fixtures/dolly/", import.meta.url).pathname;
/** How often the fixture is played to and fro: 78 frames each, far longer than the tests take. */
const TIMES = 300;
/** The same for a clip of which little is seen: a minute and more. */
const FEW_TIMES = 40;

/**
 * A browser and a daemon for the tests of a file.
 * @param {string} name of the folder
 * @param {(folder: string, browser: any) => Promise<any>} made what the daemon plays
 * @param {string} [clip]
 * @param {string[]} [more] arguments
 */
export function played(name, made = prepare, clip = undefined, more = undefined) {
  const found = /** @type {any} */ ({});
  before(async () => {
    found.browser = await launch();
    found.place = await made(join(out, name), found.browser);
    found.daemon = start(found.place.folder, clip, more);
  });
  after(async () => {
    await found.browser?.close();
    await found.daemon?.end();
  });
  return found;
}

/** A port that was free just now. @returns {Promise<number>} */
function freePort() {
  return new Promise((done, fail) => {
    const server = createServer().on("error", fail);
    server.listen(0, "127.0.0.1", () => {
      const { port } = /** @type {import("node:net").AddressInfo} */ (server.address());
      server.close(() => done(port));
    });
  });
}

/**
 * Writes a round `times` times as `long.mjpeg`: a gigabyte, which all folders share.
 * @param {string} folder
 * @param {Buffer} round
 * @param {number} times
 */
function putLong(folder, round, times) {
  const made = join(out, `long-${createHash("sha256").update(round).digest("hex").slice(0, 16)}-${times}.mjpeg`);
  if (!existsSync(made)) {
    const begun = `${made}.${process.pid}`;
    const file = openSync(begun, "w");
    for (let k = 0; k < times; k += 1) writeSync(file, round);
    closeSync(file);
    renameSync(begun, made);
  }
  rmSync(join(folder, "long.mjpeg"), { force: true });
  linkSync(made, join(folder, "long.mjpeg"));
}

/** The fixture's pictures to and fro, as they are on its disk. */
function toAndFro() {
  const frames = readdirSync(join(FIXTURE, "frames")).sort().map((name) => readFileSync(join(FIXTURE, "frames", name)));
  return Buffer.concat([...frames, ...frames.slice(1, -1).reverse()]);
}

/**
 * Writes the config and the clip to `folder`; an existing one is replaced.
 * @param {string} folder
 */
export async function prepare(folder) {
  mkdirSync(folder, { recursive: true });
  // No set of former tests, no lock.
  for (const name of ["set.json", "sets", "state"]) rmSync(join(folder, name), { recursive: true, force: true });
  for (const name of ["backdrop.png", "flat.png", "camera.toml"]) copyFileSync(join(FIXTURE, name), join(folder, name));
  const port = await freePort();
  const config = readFileSync(join(FIXTURE, "stage.toml"), "utf8");
  writeFileSync(join(folder, "stage.toml"), `${config}\n[http]\nlisten = "127.0.0.1:${port}"\n`);
  putLong(folder, toAndFro(), TIMES);
  return { folder, address: `http://127.0.0.1:${port}/` };
}

/**
 * Like `prepare`, with the left third of the pictures hidden by a mottled cloth.
 * @param {string} folder
 * @param {import("playwright-core").Browser} browser
 */
export async function prepareCovered(folder, browser) {
  const { address } = await prepare(folder);
  const names = readdirSync(join(FIXTURE, "frames")).sort();
  const page = await browser.newPage();
  const covered = await page.evaluate(
    (pictures) =>
      Promise.all(
        pictures.map(async (one) => {
          const picture = await createImageBitmap(await (await fetch(`data:image/jpeg;base64,${one}`)).blob());
          const canvas = new OffscreenCanvas(picture.width, picture.height);
          const context = canvas.getContext("2d");
          context.drawImage(picture, 0, 0);
          const third = Math.round(picture.width / 3);
          context.fillStyle = "#555";
          context.fillRect(0, 0, third, picture.height);
          for (let k = 0; k < 400; k += 1) {
            context.fillStyle = `hsl(0 0% ${20 + ((k * 37) % 40)}%)`;
            context.fillRect((k * 53) % (third - 12), (k * 97) % picture.height, 12, 9);
          }
          const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality: 0.9 })).arrayBuffer());
          let text = "";
          for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
          return btoa(text);
        }),
      ),
    names.map((name) => readFileSync(join(FIXTURE, "frames", name)).toString("base64")),
  );
  await page.close();
  const frames = covered.map((one) => Buffer.from(one, "base64"));
  putLong(folder, Buffer.concat([...frames, ...frames.slice(1, -1).reverse()]), FEW_TIMES);
  return { folder, address };
}

/**
 * A folder without a config, with the clip that the daemon plays in place of a camera.
 * @param {string} folder
 */
export async function prepareEmpty(folder) {
  rmSync(folder, { recursive: true, force: true });
  mkdirSync(folder, { recursive: true });
  putLong(folder, toAndFro(), TIMES);
  const port = await freePort();
  return { folder, address: `http://127.0.0.1:${port}/`, listen: `127.0.0.1:${port}` };
}

/**
 * Starts `stagepose setup` there.
 * @param {{folder: string, listen: string}} place
 */
export const startSetup = ({ folder, listen }) => start(folder, "long.mjpeg", ["--listen", listen, "--log", "error"], "setup");

/** Frames to and fro, and those of the dark that follows: longer than a pose is predicted for. */
const DARK = 30;
const ROUND = 78;
/** A show's rounds: far longer than the tests take. */
const ROUNDS = 250;

/**
 * The fixture to and fro, then a second of darkness, repeated; with outputs, and a recorder that
 * keeps the last seconds.
 * @param {string} folder
 * @param {import("playwright-core").Browser} browser
 */
export async function prepareShow(folder, browser) {
  rmSync(folder, { recursive: true, force: true });
  const { address } = await prepare(folder);
  const port = await freePort();
  const outputs = ["freed", "opentrackio", "osc", "psn"].map((kind) => `[[output]]\nname = "${kind}"\nkind = "${kind}"\nto = ["127.0.0.1:${port}"]\n`);
  const file = join(folder, "stage.toml");
  writeFileSync(file, `${readFileSync(file, "utf8")}\n[recorder]\nfolder = "recordings"\nring_s = 5\n\n[log]\nlevel = "info"\n\n${outputs.join("\n")}`);
  const page = await browser.newPage();
  const dark = await page.evaluate(async () => {
    const canvas = new OffscreenCanvas(640, 360);
    canvas.getContext("2d").fillRect(0, 0, 640, 360);
    return [...new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg" })).arrayBuffer())];
  });
  await page.close();
  putLong(folder, Buffer.concat([toAndFro(), ...Array(DARK).fill(Buffer.from(dark))]), ROUNDS);
  return { folder, address, round: ROUND + DARK };
}

/** Where the daemon of this folder keeps its pairings and its lock. @param {string} folder */
const stateOf = (folder) => join(folder, "state");

/** The pairing code that the program prints. @param {{folder: string, address: string}} place */
export function code({ folder, address }) {
  const told = spawnSync(program, ["pair", "--port", new URL(address).port, "--state", join(stateOf(folder), "stagepose")], { encoding: "utf8" });
  return /\b\d{4}\s?\d{4}\b/.exec(told.stdout)?.[0] ?? `${told.stdout}${told.stderr}`;
}

/**
 * Starts the daemon without waiting for it.
 * @param {string} folder
 * @param {string | null} [clip] none is the config's camera
 * @param {string[]} [more] arguments
 * @param {string} [command]
 */
export function start(folder, clip = "long.mjpeg", more = ["--log", "error"], command = "run") {
  const daemon = spawn(program, [command, "--config", "stage.toml", ...(clip === null ? [] : ["--play", clip]), ...more], { cwd: folder, env: { ...process.env, XDG_STATE_HOME: stateOf(folder) }, stdio: ["ignore", "ignore", more.includes("error") ? "inherit" : "ignore"] });
  const ended = new Promise((done) => daemon.once("exit", done));
  return {
    /** Bytes of memory that it has. */
    memory: () => 1024 * Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${daemon.pid}/status`, "utf8"))?.[1]),
    /** Stands still, as a machine that hangs. */
    stand: () => daemon.kill("SIGSTOP"),
    /** Goes on. */
    goOn: () => daemon.kill("SIGCONT"),
    /** Reads its config anew. */
    reload: () => daemon.kill("SIGHUP"),
    /** Ends without a word. */
    async end() {
      daemon.kill("SIGKILL");
      await ended;
    },
  };
}

/**
 * A rendered clip with its config, repeated, as links in `folder`.
 * @param {string} folder
 * @param {string} clip
 */
export async function prepareClip(folder, clip) {
  rmSync(folder, { recursive: true, force: true });
  mkdirSync(join(folder, "clip/frames"), { recursive: true });
  const port = await freePort();
  const config = readFileSync(join(clip, "stagepose/stage.toml"), "utf8").replaceAll('"../', `"${clip}/`);
  writeFileSync(join(folder, "stage.toml"), `${config}\n[http]\nlisten = "127.0.0.1:${port}"\n`);
  copyFileSync(join(clip, "stagepose/camera.toml"), join(folder, "camera.toml"));
  const rows = readFileSync(join(clip, "timestamps.csv"), "utf8").trim().split("\n").slice(1).map((row) => row.split(","));
  const span = Number(rows.at(-1)?.[0]) + Number(rows[1][0]);
  let table = "#timestamp [ns],filename\n";
  for (let k = 0; k < 100 * rows.length; k += 1) {
    const [stamp, file] = rows[k % rows.length];
    const name = `${String(k).padStart(6, "0")}${extname(file.trim())}`;
    symlinkSync(join(clip, "frames", file.trim()), join(folder, "clip/frames", name));
    table += `${Number(stamp) + Math.floor(k / rows.length) * span},${name}\n`;
  }
  writeFileSync(join(folder, "clip/timestamps.csv"), table);
  return { folder, address: `http://127.0.0.1:${port}/` };
}

/** Squares of a picture's number, and pixels along one: large enough for a JPEG. */
const BITS = 9;
const SQUARE = 16;
/** Seconds that the page is watched with numbered pictures. */
export const SOAK_S = Number(process.env.PAGE_SOAK_S ?? 120);
/**
 * Numbered pictures: five times to and fro, 13 s at the fixture's rate; and how often they are
 * played: far longer than the tests take.
 */
const NUMBERED = 390;
const PLAYED = Math.ceil((SOAK_S + 600) / 13);
/** Numbered pictures a second: the fixture's. */
const RATE = 30;

/**
 * The fixture to and fro, each picture with its row's number as squares along its lower edge, the
 * highest bit first; drawn by the browser. After NUMBERED rows the numbers restart.
 * @param {string} folder
 * @param {import("playwright-core").Browser} browser
 */
export async function prepareNumbered(folder, browser) {
  const { address } = await prepare(folder);
  rmSync(join(folder, "clip"), { recursive: true, force: true });
  mkdirSync(join(folder, "clip/frames"), { recursive: true });
  const page = await browser.newPage();
  const names = readdirSync(join(FIXTURE, "frames")).sort();
  const pictures = names.map((name) => readFileSync(join(FIXTURE, "frames", name)).toString("base64"));
  await page.evaluate(async (pictures) => {
    globalThis.pictures = await Promise.all(pictures.map(async (one) => createImageBitmap(await (await fetch(`data:image/jpeg;base64,${one}`)).blob())));
  }, pictures);
  let table = "#timestamp [ns],filename\n";
  const step = 78;
  for (let from = 0; from < NUMBERED; from += step) {
    const made = await page.evaluate(
      async ([from, step, bits, square]) => {
        const { pictures } = globalThis;
        const canvas = new OffscreenCanvas(pictures[0].width, pictures[0].height);
        const context = canvas.getContext("2d");
        const all = [];
        for (let row = from; row < from + step; row += 1) {
          const k = row % (2 * pictures.length - 2);
          context.drawImage(pictures[k < pictures.length ? k : 2 * pictures.length - 2 - k], 0, 0);
          for (let bit = 0; bit < bits; bit += 1) {
            context.fillStyle = (row >> (bits - 1 - bit)) & 1 ? "#fff" : "#000";
            context.fillRect(bit * square, canvas.height - square, square, square);
          }
          const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality: 0.85 })).arrayBuffer());
          let text = "";
          for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
          all.push(btoa(text));
        }
        return all;
      },
      [from, step, BITS, SQUARE],
    );
    made.forEach((one, k) => {
      writeFileSync(join(folder, "clip/frames", numbered(from + k)), Buffer.from(one, "base64"));
    });
  }
  await page.close();
  for (let row = 0; row < PLAYED * NUMBERED; row += 1) {
    if (row >= NUMBERED) symlinkSync(numbered(row % NUMBERED), join(folder, "clip/frames", numbered(row)));
    table += `${Math.round(row * (1e9 / RATE))},${numbered(row)}\n`;
  }
  writeFileSync(join(folder, "clip/timestamps.csv"), table);
  return { folder, address, bits: BITS, square: SQUARE, numbers: NUMBERED, rate: RATE };
}

/** @param {number} row */
function numbered(row) {
  return `${String(row).padStart(6, "0")}.jpg`;
}
