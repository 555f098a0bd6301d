#!/usr/bin/env python3
"""What a survey is worth: surveys walks with exact ground truth, and compares places, heights and
lens.

    cargo build --release
    python benches/survey.py --out target/clips --check             # all cases
    python benches/survey.py --out target/clips cloth relief:2       # a layout takes a seed

Cases:
  cloth: d-cloth-walk is surveyed, then d-cloth is tracked with the result. "mesh mm" is the rms
    distance of the exported stage mesh from the true cloth, along its normal.
  lens: d-lens-walk with `--lens refine`.
  relief and set: d-relief and d-set-walk, with all surfaces but the first configured wrongly, by up
    to 30 mm and 2 degrees in each axis.
  shutter: d-cloth-walk with a readout of 18 ms, configured as 0, with `--lens refine`.
  long: the frames of d-set-walk to and fro, two minutes at 30 a second, also configured wrongly.
    Only the duration counts; errors mean little, as each frame appears a dozen times.
Clips are rendered below --out as benches/clips.py does, and reused. Columns without a limit in BARS
are only printed.

Errors of places are in the stage frame itself. NEES/6 of places is
(error² / sigma_mm² + turn² / sigma_deg²) / 2, averaged over the surfaces, as both sigmas are those
of the whole vector. Poses are compared after one rigid motion of the clip (evaluate.py --align).
"""
import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import time
import tomllib

import numpy as np
from scipy.spatial.transform import Rotation

import clips

CASES = ["cloth", "lens", "relief:1", "relief:2", "set:1", "set:2", "set:3", "shutter", "long"]
SIDES_DEG = 20.0  # minimum angle between the walk's views of a point whose height is compared
# maximum error of a configured place, metres and degrees, along and about each axis
LARGEST_SLIP = (0.03, 2.0)
# Maximum values; pairs are minimum and maximum.
BARS = {
    "cloth": {"median mm": 0.15, "wrong %": 0.0, "NEES/6": (0.4, 3.0), "heights mm": 0.5, "mesh mm": 0.5},
    "lens": {"focal %": 0.03, "centre px": 0.5, "picture px": 0.2, "median mm": 0.3, "wrong %": 0.0},
    "relief": {"places mm": 0.06, "turns deg": 0.01, "NEES/6": (0.3, 3.0)},
    "set": {"places mm": 0.06, "worst mm": 0.3, "NEES/6": (0.3, 3.0)},
    "shutter": {"readout ms off": 0.5, "median mm": 0.3, "wrong %": 0.0},
    "long": {"seconds": 180.0},  # on two otherwise idle cores
}
LONG_FRAMES = 3600  # two minutes at 30 a second
SHUTTER_S = 0.018


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE[:SEED]", default=CASES, help="[default: all]")
    parser.add_argument("--out", type=pathlib.Path, default=clips.PROJECT / "target/clips", help="where the clips are and the surveys go")
    parser.add_argument("--work", type=pathlib.Path, help="where the surveys go instead")
    parser.add_argument("--binary", type=pathlib.Path, default=clips.PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=clips.PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed")
    chosen = parser.parse_args()
    chosen.frames = None
    chosen.work = chosen.work or chosen.out / "surveys"
    return chosen


# ---- running


def rendered(scene, chosen, name=None, changes=None):
    """Returns the clip of a scene of the bench, possibly with changes."""
    clip = clips.Clip(scene, chosen)
    if changes:
        clip.scene |= changes
        clip.folder = chosen.out / name
        for plane in clip.scene["planes"]:
            plane["texture"] = str((chosen.bench.parent / "data" / plane["texture"]).resolve())
    clip.render()
    return clip


def survey(clip, config, folder, chosen, *more):
    """Surveys a clip; returns its result, and its duration in seconds."""
    out = folder / "surveyed.json"
    shutil.rmtree(folder / "surveyed", ignore_errors=True)
    command = [chosen.binary, "survey", clip.folder, "--config", config, "--output", folder / "surveyed", "--json", out, "--report", folder / "report.html"]
    began = time.monotonic()
    done = subprocess.run([str(part) for part in [*command, *more]], capture_output=True, text=True)
    print(done.stdout + done.stderr, file=sys.stderr, flush=True)
    return (json.loads(out.read_text()) if done.returncode == 0 else None), time.monotonic() - began


def tracked(evaluate, clip, folder, chosen):
    """Returns the scores of a clip that is tracked with the surveyed stage."""
    poses, _ = clips.track(chosen.binary, clip, folder / "surveyed/stage.toml", folder)
    truth = clip.folder / "groundtruth.txt"
    aligned, raw = evaluate.score(truth, poses, True, True), evaluate.score(truth, poses, True)
    return {"given %": 100 * aligned["given"], "wrong %": 100 * aligned["wrong"], "median mm": aligned.get("pos_mm_median"),
            "rotation deg": aligned.get("rot_deg_median"), "NEES/6": evaluate.nees6(truth, poses, True)[0], "unaligned mm": raw.get("pos_mm_median")}  # fmt: skip


# ---- the cases


def wrong_layout(clip, folder, seed):
    """Writes the clip's config with wrong places for all surfaces but the first."""
    config = clip.write_config(folder, clip)
    random = np.random.default_rng(seed)
    surfaces = clip.surfaces()
    stage = [s for s in surfaces if s["body"] == "stage"]
    for surface in stage[1:]:
        surface["position_m"] = (np.array(surface["position_m"]) + random.uniform(-1, 1, 3) * LARGEST_SLIP[0]).tolist()
        turn = Rotation.from_rotvec(np.radians(random.uniform(-1, 1, 3) * LARGEST_SLIP[1]))
        surface["orientation_xyzw"] = (turn * Rotation.from_quat(surface["orientation_xyzw"])).as_quat().tolist()
    text = config.read_text().split("\n[[stage.surface]]")[0]
    for surface in stage:
        image = (clip.folder / surface["image"]).resolve()
        text += f'\n[[stage.surface]]\nimage = "{image}"\nsize_m = {surface["size_m"]}\nposition_m = {surface["position_m"]}\norientation_xyzw = {surface["orientation_xyzw"]}\n'
    config.write_text(text)
    return config, stage


def case_layout(scene, seed, evaluate, chosen):
    clip = rendered(scene, chosen)
    folder = chosen.work / f"{scene}-{seed}"
    config, _ = wrong_layout(clip, folder, seed)
    found, seconds = survey(clip, config, folder, chosen)
    if found is None:
        return {"seconds": seconds}
    shifts, turns, nees, places = [], [], [], []
    for true, s in list(zip(clip.surfaces(), found["surfaces"]))[1:]:
        places.append((s["position_m"], true["position_m"]))
        shifts.append(1e3 * np.linalg.norm(np.subtract(*places[-1])))
        turn = Rotation.from_quat(s["orientation_xyzw"]) * Rotation.from_quat(true["orientation_xyzw"]).inv()
        turns.append(np.degrees(turn.magnitude()))
        nees.append(0.5 * ((shifts[-1] / s["sigma_mm"]) ** 2 + (turns[-1] / s["sigma_deg"]) ** 2))
    apart = apart_mm(*np.array(places).transpose(1, 0, 2))
    return {"places mm": np.median(shifts), "worst mm": max(shifts), "against each other mm": np.median(apart), "turns deg": np.median(turns), "worst deg": max(turns),
            "NEES/6": np.mean(nees), "seconds": seconds}  # fmt: skip


def case_cloth(evaluate, chosen):
    walk, show = rendered("d-cloth-walk", chosen), rendered("d-cloth", chosen)
    folder = chosen.work / "d-cloth"
    found, seconds = survey(walk, walk.write_config(folder, walk), folder, chosen)
    if found is None:
        return {"seconds": seconds}
    heights_mm, share = heights_off(walk, folder / "surveyed/shape-1.toml")
    mesh_mm = mesh_off(walk, folder, chosen)
    return tracked(evaluate, show, folder, chosen) | {"heights mm": heights_mm, "mesh mm": mesh_mm, "seen from two sides %": 100 * share,
            "seconds": seconds}  # fmt: skip


def case_lens(evaluate, chosen):
    walk = rendered("d-lens-walk", chosen)
    folder = chosen.work / "d-lens-walk"
    found, seconds = survey(walk, walk.write_config(folder, walk), folder, chosen, "--lens", "refine")
    if found is None:
        return {"seconds": seconds}
    return lens_off(walk.scene["camera"], found["camera"]) | tracked(evaluate, walk, folder, chosen) | {"seconds": seconds}


def case_shutter(evaluate, chosen):
    """Cloth filmed with an unconfigured rolling shutter."""
    walk = rendered("d-cloth-walk", chosen, "d-cloth-walk-rolling", {"readout_s": SHUTTER_S})
    folder = chosen.work / "d-cloth-walk-rolling"
    config = walk.write_config(folder, walk)
    config.write_text(config.read_text().replace(f"readout_s = {SHUTTER_S}", "readout_s = 0.0"))
    found, seconds = survey(walk, config, folder, chosen, "--lens", "refine")
    if found is None:
        return {"seconds": seconds}
    readout_s = (found.get("shutter") or {}).get("readout_s")
    off = {"readout ms off": None if readout_s is None else 1e3 * abs(readout_s - SHUTTER_S)}
    return lens_off(walk.scene["camera"], found["camera"]) | off | tracked(evaluate, walk, folder, chosen) | {"seconds": seconds}


def case_long(evaluate, chosen):
    """A walk of two minutes around fifteen wrongly configured surfaces."""
    walk = rendered("d-set-walk", chosen)
    folder = chosen.work / "d-set-walk-long"
    config, _ = wrong_layout(walk, folder, 1)
    frames = sorted((walk.folder / "frames").iterdir())
    there_and_back = frames + frames[-2:0:-1]
    walk.folder = folder / "clip"
    clips.put_together(walk.folder, [(k * 10**9 // 30, there_and_back[k % len(there_and_back)]) for k in range(LONG_FRAMES)])
    _, seconds = survey(walk, config, folder, chosen)
    return {"seconds": seconds}


# ---- against the truth


def apart_mm(found, true):
    """Returns the distances of places from the true ones after one rigid motion of all (Kabsch,
    1976), mm."""
    centres = found.mean(axis=0), true.mean(axis=0)
    turn, _ = Rotation.align_vectors(true - centres[1], found - centres[0])
    return 1e3 * np.linalg.norm(turn.apply(found - centres[0]) + centres[1] - true, axis=1)


def lens_off(true, found):
    """Returns the errors of a lens: focal lengths, centre, and where it puts the rays of the whole
    picture."""
    k = np.array([[x, y] for x in np.linspace(0, true["width"] - 1, 41) for y in np.linspace(0, true["height"] - 1, 23)])
    rays = undistorted(true | {"distortion": true["dist"]}, k)
    moved = np.linalg.norm(projected(found, rays) - k, axis=1)
    focal = max(abs(found[key] / true[key] - 1) for key in ("fx", "fy"))
    return {"focal %": 100 * focal, "centre px": np.hypot(found["cx"] - true["cx"], found["cy"] - true["cy"]), "picture px": moved.max(),
            "picture rms px": np.sqrt((moved**2).mean())}  # fmt: skip


def projected(lens, n):
    k1, k2, p1, p2, k3 = lens["distortion"]
    x, y = n.T
    r2 = x * x + y * y
    f = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack([lens["fx"] * (x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + lens["cx"],
                            lens["fy"] * (y * f + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + lens["cy"]])  # fmt: skip


def undistorted(lens, pixels):
    centre, focal = np.array([lens["cx"], lens["cy"]]), np.array([lens["fx"], lens["fy"]])
    n = (pixels - centre) / focal
    for _ in range(100):
        n = n + (pixels - projected(lens, n)) / focal
    return n


def spline_at(grid, size, points):
    """Returns the heights of a shape file's grid (src/geometry/bspline.rs) at points of its
    surface."""
    counts = grid["intervals"]
    coefficients = np.array(grid["metres"]).reshape(counts[1] + 3, counts[0] + 3)
    where, weights = [], []
    for axis in range(2):
        at = (points[:, axis] / size[axis] + 0.5) * counts[axis]
        first = np.clip(np.floor(at).astype(int), 0, counts[axis] - 1)
        t = at - first
        s = 1 - t
        weights.append(np.array([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3]) / 6)
        where.append(first)
    return sum(weights[1][j] * weights[0][i] * coefficients[where[1] + j, where[0] + i] for j in range(4) for i in range(4))


def heights_off(walk, shape_file):
    """Returns the rms error in mm of the first surface's heights where the walk sees it from two
    sides, and that fraction of it."""
    plane, size = walk.scene["planes"][0], walk.surfaces()[0]["size_m"]
    points = np.array([[((i + 0.5) / 60 - 0.5) * size[0], ((j + 0.5) / 40 - 0.5) * size[1]] for i in range(60) for j in range(40)])
    # The reference plane of a bent surface is a convention: the survey uses the least-squares plane
    # over the whole surface.
    true = without_plane(points, billowed(plane, points))
    shape = tomllib.loads(shape_file.read_text())
    off = spline_at(shape["height"], size, points) - true
    seen = widest_angle_deg(walk, points, true) >= SIDES_DEG
    return 1e3 * np.sqrt((off[seen] ** 2).mean()), seen.mean()


def billowed(plane, points):
    """Returns the true heights of a cloth at points of its plane, metres."""
    billow = plane["billow"]
    return billow["m"] * sum(np.sin(kx * points[:, 0] + ky * points[:, 1] + phase) for kx, ky, _, phase in billow["waves"])


def without_plane(points, heights):
    """Returns heights without their least-squares plane."""
    basis = np.column_stack([np.ones(len(points)), points])
    return heights - basis @ np.linalg.lstsq(basis, heights, rcond=None)[0]


def mesh_off(walk, folder, chosen):
    """Returns the rms distance in mm of the exported mesh of the first surface from the true cloth
    where the walk sees it from two sides; a plane is a convention, as above."""
    mesh, surface = folder / "mesh.obj", walk.surfaces()[0]
    command = [chosen.binary, "export", "--config", folder / "surveyed/stage.toml", "--to", "obj", "--output", mesh]
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
    first = mesh.read_text().split("\no ")[1]
    y_up = np.array([[float(v) for v in line.split()[1:]] for line in first.splitlines() if line.startswith("v ")])
    in_stage = np.column_stack([y_up[:, 0], -y_up[:, 2], y_up[:, 1]])
    in_surface = Rotation.from_quat(surface["orientation_xyzw"]).inv().apply(in_stage - surface["position_m"])
    points = in_surface[:, :2]
    true = without_plane(points, billowed(walk.scene["planes"][0], points))
    off = without_plane(points, in_surface[:, 2]) - true
    seen = widest_angle_deg(walk, points, true) >= SIDES_DEG
    return 1e3 * np.sqrt((off[seen] ** 2).mean())


def widest_angle_deg(walk, points, heights):
    """Returns the widest angle between the walk's views of each point of the first surface,
    degrees."""
    surface, camera = walk.surfaces()[0], walk.scene["camera"]
    lens = camera | {"distortion": camera["dist"]}
    places = Rotation.from_quat(surface["orientation_xyzw"]).apply(np.column_stack([points, heights])) + surface["position_m"]
    directions, seen = [], []
    for row in np.loadtxt(walk.folder / "groundtruth.txt")[::5]:
        towards = places - row[1:4]
        in_camera = Rotation.from_quat(row[4:8]).inv().apply(towards)
        pixel = projected(lens, in_camera[:, :2] / in_camera[:, 2:])
        seen.append((in_camera[:, 2] > 0) & (pixel > 0).all(1) & (pixel < [camera["width"] - 1, camera["height"] - 1]).all(1))
        directions.append(towards / np.linalg.norm(towards, axis=1, keepdims=True))
    widest = np.zeros(len(points))
    for k in range(len(seen)):
        for other in range(k):
            angle = np.degrees(np.arccos(np.clip((directions[k] * directions[other]).sum(1), -1, 1)))
            widest = np.maximum(widest, np.where(seen[k] & seen[other], angle, 0))
    return widest


# ---- the table


def missed(case, row):
    """Yields a sentence for each bar that a row misses."""
    for name, bar in BARS[case].items():
        least, largest = bar if isinstance(bar, tuple) else (-np.inf, bar)
        value = row.get(name)
        if value is None or not least <= value <= largest:
            yield f"{case}: {name} is {'not known' if value is None else f'{value:.4g}'}, the bar is {bar}"


def main():
    chosen = arguments()
    sys.path.insert(0, str(chosen.bench))
    import evaluate

    misses = []
    for wanted in chosen.cases:
        case, _, seed = wanted.partition(":")
        if case not in BARS:
            sys.exit(f"survey.py: there is no case {case}; there are {', '.join(BARS)}")
        of_case = {"cloth": case_cloth, "lens": case_lens, "shutter": case_shutter, "long": case_long}.get(case)
        row = of_case(evaluate, chosen) if of_case else case_layout(f"d-{case}" + "-walk" * (case == "set"), int(seed or 1), evaluate, chosen)
        print(f"| {wanted} | " + ", ".join(f"{name} {value:.4g}" for name, value in row.items() if value is not None) + " |", flush=True)
        misses += missed(case, row)
    print("\n".join(["", *misses] if misses else ["", "within all bars"]))
    sys.exit(1 if misses and chosen.check else 0)


if __name__ == "__main__":
    main()
