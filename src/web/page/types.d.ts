// What the program sends, as types. Made from its own answers, do not change it by hand:
// `STAGEPOSE_REMAKE=1 cargo test --lib types_tests`.

/** How a body stands; `stale` where the camera gives no pictures */
export type State = "searching" | "tracking" | "coasting" | "lost" | "stale";

/** How a job stands */
export type JobState = "running" | "done" | "failed";

/** How much a finding matters: with an error a config cannot be used */
export type Grade = "error" | "warning" | "note";

/** How much an event matters */
export type Level = "error" | "warn" | "info";

/** How a part of the daemon stands */
export type PartLevel = "good" | "warn" | "bad" | "off";

/** Where a body is: metres, and a unit quaternion */
export type Pose = {
  orientation_xyzw: number[];
  position_m: number[];
};

/** A record, as docs/protocols.md has it */
export type PoseRecord = {
  covariance: number[] | null;
  essential: { inliers: number; rotation_xyzw: number[]; translation_direction: number[] } | null;
  homography: number[] | null;
  inliers: number | null;
  measured: Pose | null;
  model: string | null;
  objects: { covariance: number[] | null; name: string; pose: Pose | null; state: State }[];
  pose: Pose | null;
  rms_px: number | null;
  sequence: number;
  state: State;
  timestamp_ns: number;
};

/** How the camera moves in its own axes: m/s and rad/s */
export type Motion = {
  turn_rate: number[];
  velocity: number[];
};

/** What is said of a frame beside its picture, in /ws/view */
export type Head = {
  displaced?: number[];
  epoch: number;
  hidden?: number[];
  mend: string | null;
  motion: Motion | null;
  reason: string | null;
  record: PoseRecord;
  says: string | null;
  size: number[];
  used?: number[];
};

/** How things stand: /api/v1/state, and between frames in /ws/view */
export type Known = {
  age_s: number | null;
  objects: { name: string; state: State }[];
  sequence: number | null;
  state: State | null;
  timestamp_ns?: number;
};

/** The lens, as a calibration file has it */
export type Camera = {
  cx: number;
  cy: number;
  distortion: number[];
  fx: number;
  fy: number;
  height: number;
  skew: number;
  valid_radius: number | null;
  width: number;
};

/** A surface in its body, metres */
export type Surface = {
  mesh_m?: number[][][];
  name: string;
  outline_m: number[][];
  picture_px: number[];
  pose: Pose;
  size_m: number[];
};

/** Camera and bodies of a session: /api/v1/scene */
export type Scene = {
  camera: Camera;
  objects: { name: string; surfaces: Surface[] }[];
  overscan: { bottom: number; height: number; left: number; right: number; top: number; width: number };
  readout_s: number;
  stage: { name: string; surfaces: Surface[] };
};

/** What is to be said of a config */
export type Finding = {
  key: string | null;
  level: Grade;
  line: number | null;
  mend: string | null;
  sentence: string;
};

/** What is there to set a stage up with: /api/v1/setup */
export type Means = {
  cameras: { controls: { name: string; value: number | null }[]; device: string; held_by: string[]; name: string }[];
  listens: string | null;
  plays: string | null;
  shown: string | null;
};

/** A file that the daemon keeps for the config, as the answer to its upload */
export type Kept = {
  file: string;
  fov_deg: number | null;
  height: number;
  width: number;
};

/** Who is here and may change something: /api/v1/session */
export type Session = {
  config_file: string;
  findings: Finding[];
  has_config: boolean;
  locked: boolean;
  mode: string;
  needs_pairing: boolean;
  page: string;
  paired: boolean;
  version: string;
};

/** A part of the daemon: /api/v1/health */
export type Part = {
  level: PartLevel;
  mend: string | null;
  part: string;
  sentence: string;
};

/** What an output has sent: /api/v1/outputs */
export type Output = {
  dropped: number;
  failed: number;
  last: unknown;
  last_hex: string;
  latency_us: number;
  name: string;
  per_s: number | null;
  protocol: string;
  sent: number;
  withheld: number;
};

/** A recording in the list */
export type Recording = {
  begun_unix_ms: number;
  frames: number;
  id: string;
  open: boolean;
  seconds: number;
};

/** What was recorded: /api/v1/recordings */
export type RecordingList = {
  folder: string;
  recording: string | null;
  recordings: Recording[];
  ring_s: number;
};

/** Some rows of a recording */
export type Column = {
  rms_px: number | null;
  row: number;
  rows: number;
  state: State;
  states: Partial<Record<State, number>>;
};

/** A recording over time: /api/v1/recordings/ID/timeline */
export type Timeline = {
  columns: Column[];
  events: { event: string; level: Level; row: number; says: string; text?: string; timestamp_ns: number }[];
  first_ns: number | null;
  frames: number;
  last_ns: number | null;
  retracked: boolean;
};

/** How far something goes */
export type Spread = {
  max: number;
  median: number;
  p95: number;
};

/** What was recorded, and what today's config makes of it */
export type Compared = {
  angle_deg: Spread | null;
  both_tracked: number;
  position_mm: Spread | null;
  rms_px: { recorded: Spread | null; retracked: Spread | null };
  rows: number;
  same_record: number;
  same_state: number;
  states: { recorded: Partial<Record<State, number>>; retracked: Partial<Record<State, number>> };
};

/** The same recording by today's config: /api/v1/recordings/ID/retracked */
export type Retracked = {
  columns: Column[];
  compared: Compared | null;
  events: { event: string; level: Level; row: number; says: string; text?: string; timestamp_ns: number }[];
  first_ns: number | null;
  frames: number;
  last_ns: number | null;
};

/** How far a job is, in /ws/events */
export type Job = {
  done: number;
  event: string;
  job: number;
  kind: string;
  level: Level;
  says: string;
  state: JobState;
  text: string;
  timestamp_ns: number;
  unix_ms: number;
};

/** What has happened, in /ws/events */
export type Happening = {
  event: string;
  level: Level;
  reason?: string;
  says: string;
  text?: string;
  timestamp_ns: number;
  unix_ms: number;
};
