// A reporter for node's test runner that counts the tests that did not run, and says which and why:
// a summary says only how many.
//   node --test --test-reporter=spec --test-reporter-destination=stdout \
//       --test-reporter=./tests/page/skipped.mjs --test-reporter-destination=stderr …

/** What the runner says of tests that nobody asked for. */
const NOT_ASKED_FOR = "test name does not match pattern";

/** @param {AsyncIterable<{type: string, data: {name: string, skip?: string | boolean}}>} events */
export default async function* skipped(events) {
  const found = [];
  for await (const { type, data } of events) {
    if ((type === "test:pass" || type === "test:fail") && data.skip !== undefined && data.skip !== NOT_ASKED_FOR) found.push(data);
  }
  if (found.length > 0) yield `${found.length} of the page's tests did not run:\n`;
  for (const { name, skip } of found) yield `  NOT RUN: ${name}: ${typeof skip === "string" ? skip : "no reason is given"}\n`;
}
