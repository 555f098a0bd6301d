// Whether the daemon tracks by what this set-up wrote.
import { computed } from "../vendor/signals.js";
import { session } from "../access.js";
import { config } from "./config.js";
import { draft } from "./draft.js";

/** The daemon tracks by the config that was written, whatever was changed here since. */
export const isTracking = computed(() => draft.value.written !== null && session.value?.mode === "track" && session.value.has_config);
/** It tracks by exactly what is here. */
export const isInForce = computed(() => isTracking.value && draft.value.written === config.value);
