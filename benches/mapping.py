#!/usr/bin/env python3
"""What a map is worth: maps walks around built sets with exact ground truth, tracks shows with the
maps, and compares the poses with the truth, beside COLMAP's.

    cargo build --release
    python benches/mapping.py --out target/clips --check
    python benches/mapping.py --out target/clips show --colmap target/colmap/bin/python

Cases are "walk>show"; the walk's config knows the lens and the first surface, a poster or artwork,
which the shows lack. Clips are rendered below --out as benches/clips.py does, and reused.

"mm" is the median distance of the camera from the truth, in the stage frame itself; "aligned mm"
after one rigid motion of the clip. With --colmap, a Python that has `pycolmap` (from PyPI, in a
virtual environment of its own), COLMAP reconstructs every third frame of the walk and locates frames
of the show by their matches with it (benches/colmap_walk.py). It has no scale, so its poses are
compared after one similarity, of the walk and of the show.
"""
import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import time

import numpy as np

import clips

CASES = {
    "show": ("d-map-walk", "d-map-show"),
    "light": ("d-map-walk", "d-map-light"),
    "moved": ("d-map-walk", "d-map-moved"),
    "busy": ("d-map-walk-busy", "d-map-show"),
    "rolling": ("d-map-walk-rs", "d-map-show"),
    "set": ("d-set-walk", "d-set-show"),
}
# Maximum values, except for the first.
BARS = {
    "show": {"given %": 99.0, "wrong %": 0.0, "aligned mm": 0.08, "mm": 0.3, "NEES/6": 3.0},
    "light": {"given %": 95.0, "wrong %": 0.0, "mm": 0.15},
    "moved": {"given %": 95.0, "beyond 3 sigma": 0.0},
    "busy": {"aligned mm": 0.12},
    "rolling": {"aligned mm": 0.12},
    "set": {"aligned mm": 0.05},
}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE", help="[default: all]")
    parser.add_argument("--out", type=pathlib.Path, default=clips.PROJECT / "target/clips", help="where the clips are")
    parser.add_argument("--work", type=pathlib.Path, help="where the maps go [default: maps below --out]")
    parser.add_argument("--binary", type=pathlib.Path, default=clips.PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=clips.PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--colmap", type=pathlib.Path, help="a Python with pycolmap")
    parser.add_argument("--every", type=int, default=9, help="COLMAP locates one frame of the show in so many")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed")
    chosen = parser.parse_args()
    chosen.frames = None
    chosen.work = chosen.work or chosen.out / "maps"
    return chosen


def walk_config(clip, folder):
    """Writes the config of a walk: the lens and the first surface."""
    config = clip.write_config(folder, clip)
    head, first, *_ = config.read_text().split("\n[[stage.surface]]")
    config.write_text(f"{head}\n[[stage.surface]]{first}")
    return config


def mapped(walk, chosen):
    """Maps a walk, once; returns the map's folder and the seconds, or what refused it."""
    folder = chosen.work / walk.name
    config = walk_config(walk, folder)
    shutil.rmtree(folder / "mapped", ignore_errors=True)
    began = time.monotonic()
    command = [chosen.binary, "map", walk.folder, "--config", config, "--output", folder / "mapped", "--json", folder / "mapped.json"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    print(done.stdout + done.stderr, file=sys.stderr, flush=True)
    return (folder / "mapped" if done.returncode == 0 else None), time.monotonic() - began


def beyond_3_sigma(evaluate, truth, poses):
    """Returns the share of the poses that are farther from the truth than 3 sigma, percent."""
    real, off = evaluate.read(truth), []
    for line in poses.read_text().splitlines():
        record = json.loads(line)
        place = real.get(round(record["timestamp_ns"] / 1e6))
        if record["state"] != "tracking" or place is None:
            continue
        error = np.array(record["measured"]["position_m"]) - place[:3]
        covariance = np.array(record["covariance"]).reshape(6, 6)[:3, :3]
        # 3 sigma of one number have the probability of 14.16 variances of three.
        off.append(error @ np.linalg.solve(covariance, error) > 14.16)
    return 100 * float(np.mean(off)) if off else None


def scored(evaluate, show, stage, chosen, name):
    folder = chosen.work / f"{name}-show"
    folder.mkdir(parents=True, exist_ok=True)
    poses, _ = clips.track(chosen.binary, show, stage / "stage.toml", folder)
    truth = show.folder / "groundtruth.txt"
    raw, aligned = evaluate.score(truth, poses, True), evaluate.score(truth, poses, True, True)
    nees = evaluate.nees6(truth, poses)
    return {"given %": 100 * raw["given"], "wrong %": 100 * raw["wrong"], "mm": raw.get("pos_mm_median"), "p95 mm": raw.get("pos_mm_p95"),
            "aligned mm": aligned.get("pos_mm_median"), "NEES/6": nees and nees[0],
            "beyond 3 sigma": beyond_3_sigma(evaluate, truth, poses)}  # fmt: skip


def similarity(places, real):
    """Returns the function that puts places where `real` has them (Umeyama 1991)."""
    centres = places.mean(0), real.mean(0)
    u, s, v = np.linalg.svd((real - centres[1]).T @ (places - centres[0]))
    signs = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    turn = u @ signs @ v
    scale = (s * np.diag(signs)).sum() / ((places - centres[0]) ** 2).sum()
    return lambda p: scale * (p - centres[0]) @ turn.T + centres[1]


def colmap(evaluate, walk, show, chosen, name):
    """Returns COLMAP's errors on the same clips."""
    folder = chosen.work / f"{name}-colmap"
    shutil.rmtree(folder, ignore_errors=True)
    script = pathlib.Path(__file__).with_name("colmap_walk.py")
    times = json.loads(clips.run([chosen.colmap, script, walk.folder, show.folder, folder, "--every", chosen.every]).splitlines()[-1])
    pairs = []
    for clip in (walk, show):
        real, found = evaluate.read(clip.folder / "groundtruth.txt"), evaluate.read(folder / f"{clip.name}.txt")
        keys = [key for key in found if key in real]
        pairs.append((np.array([found[k][:3] for k in keys]), np.array([real[k][:3] for k in keys])))
    off = lambda by, of: 1e3 * float(np.median(np.linalg.norm(similarity(*by)(of[0]) - of[1], axis=1)))  # noqa: E731
    return {"walk mm": off(pairs[0], pairs[0]), "mm by the walk's similarity": off(pairs[0], pairs[1]), "aligned mm": off(pairs[1], pairs[1])} | times


def missed(case, row):
    for name, bar in BARS[case].items():
        value = row.get(name)
        if value is None or (value < bar if name == "given %" else value > bar):
            yield f"{case}: {name} is {value}, the bar is {bar}"


def main():
    chosen = arguments()
    chosen.out, chosen.work = chosen.out.resolve(), chosen.work.resolve()
    sys.path.insert(0, str(chosen.bench))
    sys.dont_write_bytecode = True
    import evaluate

    maps, misses = {}, []
    for case in chosen.cases:
        walk, show = (clips.Clip(name, chosen) for name in CASES[case])
        walk.render(), show.render()
        if walk.name not in maps:
            maps[walk.name] = mapped(walk, chosen)
        stage, seconds = maps[walk.name]
        row = {"map s": seconds} | (scored(evaluate, show, stage, chosen, case) if stage else {})
        rows = {case: row} | ({f"{case}, COLMAP": colmap(evaluate, walk, show, chosen, case)} if chosen.colmap else {})
        for name, row in rows.items():
            print(f"| {name} | " + ", ".join(f"{key} {value:.4g}" for key, value in row.items() if value is not None) + " |", flush=True)
        misses += missed(case, rows[case])
    print("\n".join(["", *misses] if misses else ["", "within all bars"]))
    sys.exit(1 if misses and chosen.check else 0)


if __name__ == "__main__":
    main()
