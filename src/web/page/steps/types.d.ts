// Types that refer to themselves, which comments cannot say.

/**
 * Values of a config that the steps do not show, as TOML's text by their keys: they are written as
 * they were.
 */
export type Texts = string | Table | Texts[];

/** A table of a config. */
export interface Table {
  [key: string]: Texts;
}
