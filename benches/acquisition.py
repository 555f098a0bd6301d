#!/usr/bin/env python3
"""Finding a stage from nothing, without taking anything else for it.

    cargo build --release && target/venv/bin/python benches/acquisition.py [cold|decoys|blackouts] [SCENE…]

Needs what benches/clips.py needs, and uses its rendered scenes (--out).

`cold`: runs ../shared/bench/cold.py on each scene, every third frame by itself.
`decoys`: configures twenty unrelated pictures of ../shared/data as the stage, one after another; no
    frame may report a pose.
`blackouts`: inserts twenty blackouts of 0.4 s into a scene; at least 90 % must be tracked again in
    the first lit frame, and no pose may be wrong.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys

import cv2
import numpy as np

import clips

COLD = ["d-steep", "d-whip", "d-actors", "d-dolly", "d-handheld", "d-webcam", "d-far", "d-gel", "d-haze", "d-relief"]
DECOYS_AGAINST = COLD
BLACKOUTS = ["d-dolly", "d-handheld"]
DECOYS = [
    "homog-evd/adamA.png", "homog-evd/cafeA.png", "homog-evd/catA.png", "homog-evd/foxA.png", "homog-homogr/BostonA.jpg",
    "homog-homogr/BostonLibA.png", "homog-homogr/WhiteBoardA.jpg", "homog-homogr/ExtremeZoomA.png", "homog-oxford-bikes/1.png",
    "homog-oxford-boat/1.png", "homog-oxford-graf/1.png", "homog-oxford-leuven/1.png", "homog-evd/adamB.png", "homog-evd/cafeB.png",
    "homog-evd/catB.png", "homog-evd/foxB.png", "homog-homogr/BostonB.jpg", "homog-homogr/BostonLibB.png", "homog-oxford-bikes/4.png",
    "homog-oxford-graf/4.png",
]  # fmt: skip
DECOY_EVERY = 15  # interval of the scene frames shown to the decoys; frames in between look alike
BLACKOUT_S, BACK, TIMES = 0.4, 0.9, 20
# Minimum fraction found within three frames, and of those, in the first frame.
FOUND, FIRST = {"d-steep": 0.95, "d-whip": 0.8, "d-actors": 0.92}, 0.85
FOUND_ELSE = 0.98


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["cold", "decoys", "blackouts"])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="[default: those that the bars name]")
    parser.add_argument("--out", type=pathlib.Path, default=clips.PROJECT / "target/clips")
    parser.add_argument("--work", type=pathlib.Path, help="where the clips that are put together go [default: below --out]")
    parser.add_argument("--binary", type=pathlib.Path, default=clips.PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=clips.PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed")
    chosen = parser.parse_intermixed_args()
    chosen.frames = None
    for needed in (chosen.bench, chosen.binary):
        if not needed.exists():
            sys.exit(f"acquisition.py: {needed} is not there")
    chosen.work = (chosen.work or chosen.out / "acquisition").resolve()
    chosen.binary = chosen.binary.resolve()
    return chosen


def rows_of(clip):
    return [line.split(",") for line in (clip.folder / "timestamps.csv").read_text().splitlines()[1:]]


def black_like(clip, file):
    """Saves a black picture of a clip's size."""
    width, height = clip.size()
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.full((height, width), 6, np.uint8))
    return file


def replay(chosen, folder, config):
    poses = folder / "poses.jsonl"
    clips.run([chosen.binary, "replay", folder, "--config", config, "--threads", 1, "--poses", poses])
    return [json.loads(line) for line in poses.read_text().splitlines()]


def cold(clip, chosen):
    config = clip.write_config(chosen.work / clip.name, clip)
    command = [sys.executable, "cold.py", chosen.binary, clip.folder.resolve(), config, "--work", chosen.work / clip.name / "cold"]
    done = subprocess.run([str(part) for part in command], cwd=chosen.bench, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"acquisition.py: cold.py: {done.stderr}")
    score = json.loads(done.stdout.splitlines()[-1])
    is_good = score["wrong"] == 0 and score["found"] >= FOUND.get(clip.name, FOUND_ELSE) and score["first"] >= FIRST * score["found"]
    return is_good, f"found {score['found']}, in the first frame {score['first']}, wrong {score['wrong']}, {score['p95_ms']} ms at the 95th percentile"


def decoys(clip, chosen):
    data = chosen.bench.parent / "data"
    folder = chosen.work / clip.name / "decoys"
    clips.put_together(folder, [(int(stamp), clip.folder / "frames" / name.strip()) for stamp, name in rows_of(clip)[::DECOY_EVERY]])
    given = {}
    for decoy in DECOYS:
        config = folder / "stage.toml"
        clip.write_config(folder, clip)
        camera = config.read_text().split("\n[[stage.surface]]")[0]
        # As wide as the real stage.
        width = clip.surfaces()[0]["size_m"][0]
        rows, columns = cv2.imread(str(data / decoy), 0).shape
        height = width * rows / columns
        config.write_text(f'{camera}\n[[stage.surface]]\nimage = "{data / decoy}"\nsize_m = [{width}, {height}]\n')
        given[decoy] = sum(record["state"] == "tracking" for record in replay(chosen, folder, config))
    named = ", ".join(f"{decoy} {count}" for decoy, count in given.items() if count)
    return not named, f"{sum(given.values())} poses given to {len(DECOYS)} decoys {named}"


def blackouts(clip, chosen):
    rows = rows_of(clip)
    black = black_like(clip, chosen.work / clip.name / "black.png")
    step_ns = int(rows[1][0]) - int(rows[0][0])
    lit = max(2, len(rows) // (TIMES + 1))
    shown, first, stamp = [], [], 0
    sources = []  # for each row shown, the timestamp of its picture in the scene
    for k, (source, name) in enumerate(rows[: lit * (TIMES + 1)]):
        if k and k % lit == 0:
            dark = round(BLACKOUT_S * 1e9 / step_ns)
            shown += [(stamp + n * step_ns, black) for n in range(dark)]
            sources += [None] * dark
            stamp += dark * step_ns
            first.append(len(shown))
        shown.append((stamp, clip.folder / "frames" / name.strip()))
        sources.append(int(source))
        stamp += step_ns
    folder = chosen.work / clip.name / "blackouts"
    clips.put_together(folder, shown)
    records = replay(chosen, folder, clip.write_config(folder, clip))
    back = [records[k]["state"] == "tracking" for k in first]
    within_two = [any(r["state"] == "tracking" for r in records[k : k + 2]) for k in first]
    wrong = sum(is_wrong(clip, record, source) for record, source in zip(records, sources) if record["state"] == "tracking")
    text = f"{sum(back)} of {len(back)} tracked in the first lit frame, {sum(within_two)} in the first two; {wrong} poses wrong"
    return sum(back) >= BACK * len(back) and wrong == 0, text


def is_wrong(clip, record, source):
    """Whether a pose is off by more than 1 % of the distance or 0.3 degrees, or belongs to a black
    frame."""
    if source is None:
        return True
    truth = {line.split()[0]: line.split()[1:] for line in (clip.folder / "groundtruth.txt").read_text().splitlines() if line[0] != "#"}
    nearest = min(truth, key=lambda stamp: abs(float(stamp) * 1e9 - source))
    position, rotation = clips.pose([float(number) for number in truth[nearest]])
    found = record["measured"]
    turn = (clips.Rotation.from_quat(found["orientation_xyzw"]).inv() * rotation).magnitude()
    return np.linalg.norm(position - found["position_m"]) > 0.01 * np.linalg.norm(position) or np.degrees(turn) > 0.3


def main():
    chosen = arguments()
    kind = {"cold": cold, "decoys": decoys, "blackouts": blackouts}[chosen.kind]
    missed = []
    for name in chosen.scenes or {"cold": COLD, "decoys": DECOYS_AGAINST, "blackouts": BLACKOUTS}[chosen.kind]:
        clip = clips.Clip(name, chosen)
        clip.render()
        is_good, text = kind(clip, chosen)
        print(f"{name}: {text}", flush=True)
        if not is_good:
            missed.append(name)
    if missed:
        print(f"missed: {', '.join(missed)}")
        if chosen.check:
            sys.exit(1)


if __name__ == "__main__":
    main()
