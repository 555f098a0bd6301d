#!/usr/bin/env python3
"""What a measured delay is worth: two cameras on one rig, rendered with exact stamps, of which one's
are shifted by a known delay.

    cargo build --release
    python benches/delay.py --out target/clips --check

The pair is d-delay-a (30 frames a second) and d-delay-b (25). Each case measures all delays of
DELAYS_MS; the columns are the worst error over them, the mean sigma, and the root mean square of
error / sigma. Cases:
  tracked: both configs have the stage.
  learnt: as tracked, but neither config states the readout.
  both fov: both configs have only fov_deg.
  lens: the second config has only the calibration.
  fov: the second config has only fov_deg, rounded to whole degrees.
  half: as tracked, with the first half of the second clip.
  half fov: as fov, with the first half of the second clip.
  upper half: as lens, with a mask that leaves the upper half of the second camera's pictures. Its
    rows are read a quarter of the readout before the stamp, 2.5 ms; the config states the readout.
  jitter: as tracked, all stamps of both clips shifted by 1 ms rms, at random.
  swapped: the cameras change places.
  tum, record: the second camera's poses as a log; tum is the truth, at 200 lines a second.
  slower: the same path in three times the time, tracked.
  slow, still: in ten times the time, and at rest: to be refused.
  apart: the second clip's stamps are a minute later: to be refused.
The scenes of slower, slow and still have the frames and the shake of the pair: four seconds.
"""
import argparse
import json
import pathlib
import subprocess
import sys

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

import clips

DELAYS_MS = [7.3, 41.0, 118.0, -23.0]
CASES = ["tracked", "learnt", "both fov", "lens", "fov", "half", "half fov", "upper half", "jitter", "swapped", "tum", "record", "slower", "slow", "slow fov", "still", "still fov", "apart"]
REFUSED = ["slow", "slow fov", "still", "still fov", "apart"]
MOST_MS = 1.0  # maximum error of any delay
HONEST = (0.1, 2.0)  # root mean square of error / sigma; a clip's errors are few, and alike


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", default=CASES, help="[default: all]")
    parser.add_argument("--out", type=pathlib.Path, default=clips.PROJECT / "target/clips", help="where the clips are")
    parser.add_argument("--binary", type=pathlib.Path, default=clips.PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=clips.PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed")
    parser.add_argument("--render", action="store_true", help="only render the clips")
    chosen = parser.parse_args()
    chosen.frames = None
    return chosen


def rendered(scene, times, chosen):
    """Returns the clip of a scene whose path takes `times` as long; 0: it stands still."""
    clip = clips.Clip(scene, chosen)
    if times != 1:
        path = clip.scene["path"]
        clip.scene["path"] = [key | {"t": key["t"] * times} for key in path] if times else path[:1]
        clip.folder = chosen.out / f"{scene}-{times}"
    for plane in clip.scene["planes"]:
        plane["texture"] = str((chosen.bench.parent / "data" / plane["texture"]).resolve())
    clip.render()
    return clip


def stamps(clip):
    rows = (clip.folder / "timestamps.csv").read_text().split("\n")[1:]
    return [(int(row.split(",")[0]), clip.folder / "frames" / row.split(",")[1]) for row in rows if row]


def shifted(clip, folder, delay_ms, jitter_ms=0.0, share=1.0, seed=1):
    """Makes a clip with other stamps; returns its folder."""
    random = np.random.default_rng(seed)
    rows = stamps(clip)
    rows = rows[: round(len(rows) * share)]
    shown = [(round(at + 1e6 * (delay_ms + jitter_ms * random.standard_normal()) + 1e9), picture) for at, picture in rows]
    clips.put_together(folder, shown)
    return folder


def without_stage(clip, config, case):
    """Writes a config that knows only the lens."""
    camera = config.read_text().split("[[stage.surface]]")[0]
    if case == "upper half":
        width, height = clip.size()
        rows = [b"\xff" * width if row < height // 2 else b"\0" * width for row in range(height)]
        config.with_name("mask.pgm").write_bytes(b"P5\n%d %d\n255\n" % (width, height) + b"".join(rows))
        camera += 'mask = "mask.pgm"\n'
    if case.endswith("fov"):
        scene = clip.scene["camera"]
        degrees = round(np.degrees(2 * np.arctan(scene["width"] / 2 / scene["fx"])))
        camera = camera.replace('calibration = "camera.toml"', f"fov_deg = {degrees}")
    other = config.with_name("lens.toml")
    other.write_text(camera)
    return other


def tum_log(clip, file, delay_ms):
    """Writes the true poses of the clip's camera at 200 lines a second."""
    truth = np.loadtxt(clip.folder / "groundtruth.txt")
    spline = RotationSpline(truth[:, 0], Rotation.from_quat(truth[:, 4:]))
    lines = []
    for at in np.arange(truth[0, 0], truth[-1, 0], 0.005):
        x, y, z, w = spline(at).as_quat()
        lines.append(f"{at + 1.0 + delay_ms / 1e3:.9f} 0 0 0 {x:.9f} {y:.9f} {z:.9f} {w:.9f}\n")
    file.write_text("".join(lines))
    return file


def second(case, clip, config, folder, delay_ms, chosen):
    """Returns the arguments for the second camera."""
    share = 0.5 if case in ("half", "half fov") else 1.0
    jitter_ms = 1.0 if case == "jitter" else 0.0
    if case == "tum":
        return ["--with-log", tum_log(clip, folder / "b.txt", delay_ms)]
    frames = shifted(clip, folder / "b", delay_ms + (60_000 if case == "apart" else 0), jitter_ms, share, 2)
    if case == "record":
        chosen_poses = folder / "b.jsonl"
        clips.run([chosen.binary, "replay", frames, "--config", config, "--poses", chosen_poses])
        return ["--with-log", chosen_poses]
    if case.endswith(("lens", "fov")) or case == "upper half":
        config = without_stage(clip, config, case)
    return ["--with", config, "--with-clip", frames]


def measured(case, delay_ms, chosen):
    """Measures a delay; returns the JSON."""
    times = {"slower": 3, "slow": 10, "still": 0}.get(case.split(" ")[0], 1)
    a, b = (rendered(f"d-delay-{name}", times, chosen) for name in "ab")
    if case == "swapped":
        a, b = b, a
    folder = chosen.out / "delays" / f"{case.replace(' ', '-')}-{delay_ms}"
    configs = [clip.write_config(folder / name, clip) for name, clip in (("of-a", a), ("of-b", b))]
    if case == "both fov":
        configs[0] = without_stage(a, configs[0], case)
    if case == "learnt":
        for config in configs:
            config.write_text("".join(line for line in config.read_text().splitlines(True) if not line.startswith("readout_s")))
    first = shifted(a, folder / "a", 0.0, 1.0 if case == "jitter" else 0.0, 1.0, 1)
    out = folder / "delay.json"
    command = [chosen.binary, "delay", "--config", configs[0], "--clip", first, *second(case, b, configs[1], folder, delay_ms, chosen)]
    done = subprocess.run([str(part) for part in [*command, "--json", out]], capture_output=True, text=True)
    print(f"{case} {delay_ms}: exit {done.returncode}\n{done.stdout}{done.stderr}", file=sys.stderr, flush=True)
    return json.loads(out.read_text()), done.returncode


def scored(case, chosen):
    """Returns the row of a case, and whether its bars are met."""
    delays = DELAYS_MS[1:2] if case in REFUSED or case == "slower" else DELAYS_MS
    results = [(delay, *measured(case, delay, chosen)) for delay in delays]
    verdicts = ", ".join(dict.fromkeys(found["verdict"] for _, found, _ in results))
    if case in REFUSED:
        is_good = all(code == 1 and found["verdict"] == "do not use" for _, found, code in results)
        return f"| {case} | | | | {verdicts}: {results[0][1]['reasons'][0]} |", is_good
    known = [(1e3 * found["delay_s"] - delay, 1e3 * found["sigma_s"]) for delay, found, _ in results if found["delay_s"] is not None]
    errors, sigmas = np.array(known).reshape(-1, 2).T
    worst, rms = np.abs(errors).max(initial=0.0), np.sqrt(np.mean((errors / sigmas) ** 2))
    is_good = len(known) == len(delays) and worst <= MOST_MS and HONEST[0] <= rms <= HONEST[1] and all(code == 0 for *_, code in results)
    return f"| {case} | {worst:.3f} | {sigmas.mean():.3f} | {rms:.2f} | {verdicts} |", is_good


def main():
    chosen = arguments()
    if chosen.render:
        for times in (1, 3, 10, 0):
            [rendered(f"d-delay-{name}", times, chosen) for name in "ab"]
        return
    print("| case | worst error ms | sigma ms | error / sigma, rms | verdict |\n|---|---|---|---|---|")
    missed = []
    for case in chosen.cases:
        row, is_good = scored(case, chosen)
        print(row + ("" if is_good else " **missed**"), flush=True)
        missed += [] if is_good else [case]
    if chosen.check and missed:
        sys.exit(f"delay.py: missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
