// Values as TOML, and tables of values that are TOML already.

/** @import { Table, Texts } from "./types.js" */

/** A text in TOML. @param {string} text */
export const quoted = (text) => JSON.stringify(text);

/** A number in TOML, to tenths of a millimetre. @param {number} value */
export function written(value) {
  const text = `${Number(value.toFixed(4))}`;
  return text.includes(".") ? text : `${text}.0`;
}

/** Three lengths or so in TOML. @param {number[]} values */
export const list = (values) => `[${values.map(written).join(", ")}]`;

/** A key, quoted where it has to be. @param {string} name */
const key = (name) => (/^[\w-]+$/.test(name) ? name : quoted(name));

/** @param {Texts} value @returns {value is Table} */
const isTable = (value) => typeof value === "object" && !Array.isArray(value);

/**
 * Lines of a table: its values, then the tables within it.
 * @param {Table} table
 * @param {string[]} path its keys
 * @returns {string[]}
 */
export function lines(table, path) {
  const entries = Object.entries(table);
  const values = entries.flatMap(([name, value]) => (typeof value === "string" ? [`${key(name)} = ${value}`] : []));
  const within = entries.flatMap(([name, value]) => {
    const at = [...path, name];
    const title = at.map(key).join(".");
    if (Array.isArray(value)) return value.flatMap((item) => (isTable(item) ? ["", `[[${title}]]`, ...lines(item, at)] : []));
    return isTable(value) ? ["", `[${title}]`, ...lines(value, at)] : [];
  });
  return [...values, ...within];
}
