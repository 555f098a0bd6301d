// The linter over the page and its tests, by eslint.config.mjs; the packages are in target/page.
//   node --test tests/page/lint.test.mjs
import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { test } from "node:test";

const { ESLint } = createRequire(resolve("target/page/package.json"))("eslint");
const linter = new ESLint({ overrideConfigFile: "tests/page/eslint.config.mjs" });

const reported = (results) => results.flatMap(({ filePath, messages }) => messages.map(({ line, column, ruleId, message }) => `${filePath}:${line}:${column} ${message} (${ruleId})`));

test("the linter finds nothing in the page, nor in its tests", async () => {
  const results = await linter.lintFiles(["src/web/page", "tests/page"]);
  assert.ok(results.length > 40, `${results.length} files`);
  assert.deepEqual(reported(results), []);
});

test("the linter sees `any` in a comment, where it comes from elsewhere, and a promise that nobody waits for", async () => {
  const rulesOf = async (text) => (await linter.lintText(text, { filePath: "src/web/page/pages.js" }))[0].messages.map(({ ruleId }) => ruleId);
  assert.deepEqual(await rulesOf("/** @param {any} of */\nexport const kind = (of) => typeof of;\n"), ["page/no-any"]);
  assert.deepEqual(await rulesOf('export const name = JSON.parse("{}").name;\n'), ["@typescript-eslint/no-unsafe-assignment", "@typescript-eslint/no-unsafe-member-access"]);
  assert.deepEqual(await rulesOf('fetch("./api/v1/session");\n'), ["@typescript-eslint/no-floating-promises"]);
  assert.deepEqual(await rulesOf("export const isFirst = (/** @type {number} */ k) => k == 0;\n"), ["eqeqeq"]);
});
