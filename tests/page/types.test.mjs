// The page's modules have types in their comments; the TypeScript compiler holds them to these, as
// src/web/page/tsconfig.json says. It sees the libraries' own declarations (vendor/*.d.ts) in place
// of the packed modules. The packages are in target/page.
//   node --test tests/page/types.test.mjs
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { test } from "node:test";

const tsc = (...more) => spawnSync("node", ["target/page/node_modules/typescript/bin/tsc", "-p", "src/web/page", ...more], { encoding: "utf8" });

test("the modules' types hold", () => {
  const { status, stdout, stderr } = tsc();
  assert.equal(status, 0, `${stdout}${stderr}`);
});

test("the compiler sees every module, and none of the packed ones", () => {
  const seen = tsc("--listFilesOnly").stdout.split("\n").flatMap((path) => path.split("src/web/page/").slice(1));
  for (const name of ["app.js", "gl/compose.js", "types.d.ts", "vendor/three.d.ts"]) assert.ok(seen.includes(name), `${name} is not among ${seen}`);
  assert.deepEqual(seen.filter((name) => name.startsWith("vendor/") && !name.endsWith(".d.ts")), []);
});
