// The page's modules have types in their comments; the TypeScript compiler holds them to these. It sees the libraries' own declarations in place of the
// packed modules.
//   PAGE_OUT=target/page node --test tests/page/types.test.mjs
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { cpSync, mkdirSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { test } from "node:test";

const out = resolve(process.env.PAGE_OUT ?? "target/page");
const page = new URL("../../src/web/page/", import.meta.url).pathname;

/** What stands for each packed module. */
const DECLARED = {
  preact: 'export * from "preact";',
  hooks: 'export * from "preact/hooks";',
  signals: 'export * from "@preact/signals";',
  "signals-core": 'export * from "@preact/signals-core";',
  htm: 'export { default } from "htm";',
  three: 'export * from "three";\nexport { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";\nexport { TransformControls } from "three/addons/controls/TransformControls.js";',
};

test("the modules' types hold", () => {
  const copy = join(out, "checked");
  rmSync(copy, { recursive: true, force: true });
  mkdirSync(copy, { recursive: true });
  cpSync(page, copy, { recursive: true, filter: (path) => !path.includes("/vendor/") || path.endsWith("/vendor/") });
  mkdirSync(join(copy, "vendor"), { recursive: true });
  for (const [name, text] of Object.entries(DECLARED)) writeFileSync(join(copy, `vendor/${name}.d.ts`), text);
  const options = { allowJs: true, checkJs: true, noEmit: true, strict: true, skipLibCheck: true, target: "es2022", module: "es2022", moduleResolution: "bundler", lib: ["es2022", "dom", "dom.iterable"], types: [] };
  writeFileSync(join(copy, "tsconfig.json"), JSON.stringify({ compilerOptions: options, include: ["**/*.js"] }));
  assert.ok(readdirSync(copy).length > 10);
  const { status, stdout, stderr } = spawnSync("node", [join(out, "node_modules/typescript/bin/tsc"), "-p", copy], { encoding: "utf8" });
  assert.equal(status, 0, `${stdout}${stderr}`);
});
