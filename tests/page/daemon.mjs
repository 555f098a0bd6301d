// A true daemon that plays the fixture to and fro as its camera, with its page on a free port.
import { spawn } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { extname, join } from "node:path";

const FIXTURE = new URL("../../fixtures/dolly/", import.meta.url).pathname;
/** How often the fixture is played to and fro: 78 frames each, far longer than the tests take. */
const TIMES = 300;

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

/** The config and the clip, in `folder`; one that is there already is written anew. @param {string} folder */
export async function prepare(folder) {
  mkdirSync(folder, { recursive: true });
  for (const name of ["backdrop.png", "flat.png", "camera.toml"]) copyFileSync(join(FIXTURE, name), join(folder, name));
  const port = await freePort();
  const config = readFileSync(join(FIXTURE, "stage.toml"), "utf8");
  writeFileSync(join(folder, "stage.toml"), `${config}\n[http]\nlisten = "127.0.0.1:${port}"\n`);
  const frames = readdirSync(join(FIXTURE, "frames")).sort().map((name) => readFileSync(join(FIXTURE, "frames", name)));
  const once = Buffer.concat([...frames, ...frames.slice(1, -1).reverse()]);
  writeFileSync(join(folder, "long.mjpeg"), Buffer.concat(Array(TIMES).fill(once)));
  return { folder, address: `http://127.0.0.1:${port}/` };
}

/** Starts it; waits for nothing. @param {string} program @param {string} folder @param {string} [clip] */
export function start(program, folder, clip = "long.mjpeg") {
  const daemon = spawn(program, ["run", "--config", "stage.toml", "--play", clip, "--log", "error"], { cwd: folder, stdio: ["ignore", "ignore", "inherit"] });
  const ended = new Promise((done) => daemon.once("exit", done));
  return {
    /** Stands still, as a machine that hangs. */
    stand: () => daemon.kill("SIGSTOP"),
    /** Goes on. */
    goOn: () => daemon.kill("SIGCONT"),
    /** Ends without a word. */
    async end() {
      daemon.kill("SIGKILL");
      await ended;
    },
  };
}

/** A rendered clip with its config, played over and over, as links in `folder`. @param {string} folder @param {string} clip */
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
  return { folder, address: `http://127.0.0.1:${port}/`, rows: rows.length };
}
