#!/usr/bin/env python3
"""Refined poses of rendered clips against live ones, by exact truth.

Each scene is rendered (kept below --out and reused) and tracked by `replay` and by `refine`. The
table has median and 95 % of the position error, the mean squared error in sigmas per degree of
freedom (NEES/6), and the median second difference of the error from frame to frame (jitter).
`--check` fails where errors or jitter grow, or where NEES/6 leaves 0.4 to 2.5.

    target/venv/bin/python benches/refine.py --check
"""
import json
import sys

import clips
import numpy as np
from scipy.spatial.transform import Rotation

SCENES = ["d-handheld", "d-whip", "d-actors", "d-dolly", "d-steep"]
# Range of NEES/6 of refined poses. Noise of neighbouring frames is not independent, so that slow
# cameras' covariances are too small.
NEES = (0.4, 2.5)


def tracked(poses):
    """Returns the tracked records by their row."""
    records = enumerate(json.loads(line) for line in poses.read_text().splitlines())
    return {row: record for row, record in records if record["state"] == "tracking"}


def scores(records, rows_scored, truth):
    """Returns the number of poses, and of some rows' the errors' median and 95 % (mm), NEES/6, and
    the jitter (mm)."""
    errors, squared, rows = [], [], []
    for row in rows_scored:
        record = records[row]
        true = truth.get(round(record["timestamp_ns"] / 1e6))
        if true is None:
            continue
        position, rotation = clips.pose(true)
        found = record["pose"]
        turn = (rotation * Rotation.from_quat(found["orientation_xyzw"]).inv()).as_rotvec()
        error = np.concatenate([position - found["position_m"], turn])
        covariance = np.array(record["covariance"]).reshape(6, 6)
        squared.append(error @ np.linalg.solve(covariance, error) / 6)
        errors.append(error[:3] * 1e3)
        rows.append(row)
    size = np.linalg.norm(errors, axis=1)
    bends = [errors[k + 1] - 2 * errors[k] + errors[k - 1] for k in range(1, len(rows) - 1) if rows[k + 1] - rows[k - 1] == 2]
    return len(records), np.median(size), np.percentile(size, 95), np.mean(squared), np.median(np.linalg.norm(bends, axis=1))


def main():
    chosen = clips.arguments()
    sys.path.insert(0, str(chosen.bench))
    import evaluate

    names = SCENES if chosen.scenes == [*clips.BARS, clips.DECOY] else chosen.scenes
    missed = []
    print("| clip | poses | median mm | 95 % mm | NEES/6 | jitter mm |\n|---|---|---|---|---|---|")
    for name in names:
        clip = clips.Clip(name, chosen)
        clip.render()
        config = clip.write_config(clip.folder / "config", clip)
        live, _ = clips.track(chosen.binary, clip, config, clip.folder)
        refined = clip.folder / "refined.jsonl"
        clips.run([chosen.binary, "refine", clip.folder, "--config", config, "--poses", refined])
        truth = evaluate.read(clip.folder / "groundtruth.txt")
        live, refined = tracked(live), tracked(refined)
        # Rows that only tracking backward found have no live pose to be compared with.
        both = sorted(live.keys() & refined.keys())
        before, after = scores(live, both, truth), scores(refined, both, truth)
        pairs = [f"{a:.3f} / {b:.3f}" for a, b in zip(before[1:], after[1:])]
        print(f"| {name} | {before[0]} / {after[0]} | {' | '.join(pairs)} |", flush=True)
        worse = [k for k in (1, 2, 4) if after[k] > before[k]]
        if worse or after[0] < before[0] or not NEES[0] < after[3] < NEES[1]:
            missed.append(name)
    if chosen.check and missed:
        sys.exit(f"refine.py: worse than live, or dishonest: {', '.join(missed)}")


if __name__ == "__main__":
    main()
