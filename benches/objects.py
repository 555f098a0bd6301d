#!/usr/bin/env python3
"""The score table of tracked objects: rendered clips with exact ground truth, object by object.

Each scene is rendered (kept below --out and reused), tracked on one thread, and every object is
scored in the frames that show at least half of it. It needs the renderer and its scenes in
../shared/bench, and the Python packages that benches/clips.py needs:

    cargo build --release && target/venv/bin/python benches/objects.py --check

`given`: percentage of those frames in which the object is tracking. `wrong`: number of all frames,
shown or not, with an object pose that is off by more than 1 % of its distance from the camera or
0.3 degrees. `back`: maximum number of frames from the one that shows half of the object again to
the one that reports it; 0 means at once. `--misses` names the frames that show an object and do not
report it.
"""
import argparse
import json
import os
import pathlib
import sys

import numpy as np
from scipy.spatial.transform import Rotation

import clips

SCENES = ["d-props", "d-prop"]
SHOWN = 0.5  # visible fraction from which an object must be reported
GIVEN, STAGE_GOOD = 97.0, 99.0  # minimum percentages of reported frames
MEDIAN_MM, MEDIAN_DEG = 0.5, 0.1  # maximum median errors
BACK_FRAMES = 2  # maximum frames until an object that is shown again is reported
# as in evaluate.py --tight, but by the object's own distance
WRONG_OF_DISTANCE, WRONG_DEG = 0.01, 0.3
FLAT_FRAME_TIME = 2.0  # maximum ratio of the 99th percentile to the median of the frame times
COLUMNS = ["clip", "body", "shown", "given %", "wrong", "median mm", "p95 mm", "median deg", "p95 deg", "NEES/6", "back", "ms p50", "ms p99"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES, metavar="SCENE[:N[:K]]|FILE",
                        help="a scene of --bench (its first N frames, of these every Kth), or a scene's own file [default: %(default)s]")  # fmt: skip
    parser.add_argument("--out", type=pathlib.Path, default=clips.PROJECT / "target/clips")
    parser.add_argument("--binary", type=pathlib.Path, default=clips.PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=clips.PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--misses", action="store_true", help="name the frames that show an object and do not give it")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed, times excepted")
    parser.add_argument("--check-times", action="store_true", help="the same for the times")
    chosen = parser.parse_args()
    chosen.frames = None
    for needed in (chosen.bench, chosen.binary):
        if not needed.exists():
            sys.exit(f"objects.py: {needed} is not there")
    return chosen


def clip_of(wanted, chosen):
    """Returns a scene of the bench by its name, or one of the caller's by its file."""
    file = pathlib.Path(wanted)
    if file.suffix != ".json":
        return clips.Clip(wanted, chosen)
    own = argparse.Namespace(**vars(chosen))
    # Clip's constructor reads scenes only from the bench's `scenes` folder, so it is bypassed here.
    clip = clips.Clip.__new__(clips.Clip)
    clip.name, clip.truth_only, clip.bench = file.stem, False, own.bench
    clip.scene = json.loads(file.read_text())
    clip.folder = own.out / file.stem
    return clip


def rows_of(path):
    """Returns the rows of a text file of numbers, by their timestamp in milliseconds."""
    lines = (line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#"))
    return {round(float(line[0]) * 1e3): np.array(line[1:], float) for line in lines}


def errors(record, truth, distance_m):
    """Returns position error in metres, rotation error in degrees, NEES/6, and whether the pose is
    wrong."""
    position, rotation = clips.pose(truth)
    found, turned = clips.pose([*record["pose"]["position_m"], *record["pose"]["orientation_xyzw"]])
    error = np.concatenate([position - found, (rotation * turned.inv()).as_rotvec()])
    nees = error @ np.linalg.solve(np.array(record["covariance"]).reshape(6, 6), error) / 6
    off_m, off_deg = np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
    return off_m, off_deg, nees, off_m > WRONG_OF_DISTANCE * distance_m or off_deg > WRONG_DEG


def longest_return(shown, given):
    """Returns the longest wait, in frames, from the first frame that shows the object again to the
    first that reports it, and where it began. Without a report, it counts until the object
    disappears or the clip ends."""
    worst, where = 0, None
    for k in range(len(shown)):
        if not shown[k] or (k > 0 and shown[k - 1]):
            continue
        wait = next((j - k for j in range(k, len(shown)) if given[j] or not shown[j]), len(shown) - k)
        if wait > worst:
            worst, where = wait, k
    return worst, where


def score_object(clip, name, records):
    """Returns a row of the table, the missed frames, the wrong frames, and where the longest wait
    began."""
    truth, visible = (rows_of(clip.folder / f"object_{name}_{kind}.txt") for kind in ("groundtruth", "visible"))
    camera = rows_of(clip.folder / "groundtruth.txt")
    shown, given, off, wrong, misses = [], [], [], [], []
    for record in records:
        stamp = round(record["timestamp_ns"] / 1e6)
        ours = next(o for o in record["objects"] if o["name"] == name)
        shown.append(stamp in visible and visible[stamp][0] >= SHOWN)
        given.append(ours["state"] == "tracking")
        if given[-1]:
            found = errors(ours, truth[stamp], np.linalg.norm(truth[stamp][:3] - camera[stamp][:3]))
            off.append(found[:3])
            if found[3]:
                wrong.append(f"{record['sequence']} ({1e3 * found[0]:.1f} mm, {found[1]:.2f} deg, NEES/6 {found[2]:.1f})")
        elif shown[-1]:
            misses.append(f"{record['sequence']} ({visible[stamp][0]:.2f} seen, {ours['state']})")
    off = np.array(off).reshape(-1, 3)
    back, where = longest_return(shown, given)
    good = [g for s, g in zip(shown, given) if s]
    middle = lambda column, share: float(np.percentile(column, share)) if len(column) else None
    row = {
        "clip": clip.folder.name, "body": name, "shown": sum(shown), "given %": 100 * float(np.mean(good)) if good else None, "wrong": len(wrong),
        "median mm": middle(1e3 * off[:, 0], 50), "p95 mm": middle(1e3 * off[:, 0], 95), "median deg": middle(off[:, 1], 50),
        "p95 deg": middle(off[:, 1], 95), "NEES/6": float(off[:, 2].mean()) if len(off) else None, "back": back,
    }  # fmt: skip
    return row, misses, wrong, where


def score_stage(evaluate, clip, poses, summary):
    """Returns the row of the stage itself, with the times of a frame."""
    row = evaluate.score(clip.folder / "groundtruth.txt", poses, True)
    total = summary["stage_ms"]["total"]
    nees = evaluate.nees6(clip.folder / "groundtruth.txt", poses)
    return {
        "clip": clip.folder.name, "body": "stage", "shown": row["frames"], "given %": 100 * row["good"], "wrong": round(row["wrong"] * row["frames"]),
        "median mm": row.get("pos_mm_median"), "p95 mm": row.get("pos_mm_p95"), "median deg": row.get("rot_deg_median"),
        "p95 deg": row.get("rot_deg_p95"), "NEES/6": nees and nees[0], "ms p50": total["p50"], "ms p99": total["p99"],
    }  # fmt: skip


def missed(row):
    """Yields a sentence for each bar that a row misses."""
    who = f"{row['clip']}, {row['body']}"
    least = STAGE_GOOD if row["body"] == "stage" else GIVEN
    if row["given %"] is not None and row["given %"] < least:
        yield f"{who}: given in {row['given %']:.1f} %, at least {least} % are wanted"
    if row["wrong"]:
        yield f"{who}: {row['wrong']} wrong poses, none may be"
    for column, most in (("median mm", MEDIAN_MM), ("median deg", MEDIAN_DEG), ("back", BACK_FRAMES)):
        if row.get(column) is not None and row[column] > most:
            yield f"{who}: {column} is {row[column]:.3g}, at most {most} is wanted"


def main():
    chosen = arguments()
    chosen.out = chosen.out.resolve()
    # The renderer's folder may be read-only, so compiled code goes elsewhere.
    os.environ.setdefault("NUMBA_CACHE_DIR", str(chosen.out / "numba"))
    sys.path.insert(0, str(chosen.bench))
    sys.dont_write_bytecode = True
    import evaluate

    clips.print_row(COLUMNS)
    clips.print_row(["---"] * len(COLUMNS))
    faults, late, notes = [], [], []
    for wanted in chosen.scenes:
        clip = clip_of(wanted, chosen)
        clip.render()
        folder = clip.folder / "stagepose"
        poses, summary = clips.track(chosen.binary, clip, clip.write_config(folder, clip), folder)
        records = [json.loads(line) for line in poses.read_text().splitlines()]
        rows = [score_stage(evaluate, clip, poses, summary)]
        for name in [o["name"] for o in records[0]["objects"]]:
            row, misses, wrong, where = score_object(clip, name, records)
            rows.append(row)
            notes += [f"{clip.folder.name}, {name}: {kind} {', '.join(of)}" for kind, of in (("wrong in", wrong), ("missed in", misses)) if of]
            notes += [f"{clip.folder.name}, {name}: longest wait begins at {where}"] if where is not None else []
        for row in rows:
            clips.print_row([clips.cell(row.get(column)) for column in COLUMNS])
            faults += missed(row)
        if rows[0]["ms p99"] > FLAT_FRAME_TIME * rows[0]["ms p50"]:
            late.append(f"{clip.folder.name}: the slowest frames take {rows[0]['ms p99'] / rows[0]['ms p50']:.1f} medians, at most {FLAT_FRAME_TIME:g} are wanted")
    for sentence in notes if chosen.misses else []:
        print(sentence, file=sys.stderr)
    clips.conclude(faults, late, chosen)


if __name__ == "__main__":
    main()
