// The linter's rules for the page and for its tests; lint.test.mjs runs it. By hand, from the
// repository's root, with the packages in target/page:
//   target/page/node_modules/.bin/eslint --config tests/page/eslint.config.mjs \
//       src/web/page tests/page
import { createRequire } from "node:module";
import { resolve } from "node:path";

const packages = createRequire(resolve("target/page/package.json"));
const js = packages("@eslint/js");
const globals = packages("globals");
const tslint = packages("typescript-eslint");
const ts = packages("typescript");

/**
 * Refuses the type `any` where it is written, in comments too. The rules of
 * `recommendedTypeChecked` refuse to use what has it from elsewhere.
 */
const noAny = {
  meta: { type: "problem", schema: [], messages: { any: "`any` switches the compiler off: say what it is, or `unknown`." } },
  create(context) {
    const { sourceCode } = context;
    const look = (node) => {
      if (node.kind === ts.SyntaxKind.AnyKeyword) {
        const loc = { start: sourceCode.getLocFromIndex(node.getStart()), end: sourceCode.getLocFromIndex(node.end) };
        context.report({ loc, messageId: "any" });
      }
      for (const comment of node.jsDoc ?? []) look(comment);
      ts.forEachChild(node, look);
    };
    return { Program: (program) => look(sourceCode.parserServices.esTreeNodeToTSNodeMap.get(program)) };
  },
};

/** Rules for all, beside the recommended ones. */
const rules = {
  eqeqeq: ["error", "always", { null: "ignore" }],
  "no-implicit-coercion": "error",
  "no-var": "error",
  "object-shorthand": "error",
  "prefer-const": ["error", { destructuring: "all" }],
};

export default tslint.config(
  { ignores: ["src/web/page/vendor/*.js"] },
  { linterOptions: { reportUnusedDisableDirectives: "error" } },
  js.configs.recommended,
  { rules },
  {
    files: ["src/web/page/**/*.js", "src/web/page/**/*.d.ts"],
    extends: [tslint.configs.recommendedTypeChecked],
    languageOptions: {
      parserOptions: {
        project: resolve("src/web/page/tsconfig.json"),
        // With CI=true the parser would keep no types for a text that differs from its file.
        disallowAutomaticSingleRunInference: true,
      },
    },
    plugins: { page: { rules: { "no-any": noAny } } },
    rules: {
      "page/no-any": "error",
      "no-shadow": "error",
      // The compiler knows what there is.
      "no-undef": "off",
      "@typescript-eslint/switch-exhaustiveness-check": "error",
    },
  },
  {
    // What a test hands to the browser is a function of its own: names of this file mean nothing
    // there, and are used again.
    files: ["tests/page/**/*.mjs"],
    languageOptions: { globals: { ...globals.node, ...globals.browser } },
  },
);
