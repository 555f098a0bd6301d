#!/usr/bin/env python3
"""The scatter of a real camera at rest: stagepose and OpenCV's Lucas-Kanade on the same surface.

A folder of pictures from a still camera has no picture of a stage, so this makes one: a rectangle
of the floor in the first picture is flattened and becomes the artwork of a surface of known size
and place. Both trackers then follow it, and the standard deviations of the camera's position are
compared. The artwork's own noise shifts both alike.

    python3 -m venv target/venv && target/venv/bin/pip install -r ../shared/bench/requirements.txt
    cargo build --release && target/venv/bin/python benches/still.py
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys

import cv2
import numpy as np

PROJECT = pathlib.Path(__file__).resolve().parent.parent
SHARED = PROJECT.parent / "shared"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=pathlib.Path, default=SHARED / "data/static-euroc-v101", help="*.png named by their stamps in ns")
    parser.add_argument("--out", type=pathlib.Path, default=PROJECT / "target/clips/still")
    parser.add_argument("--binary", type=pathlib.Path, default=PROJECT / "target/release/stagepose")
    parser.add_argument("--bench", type=pathlib.Path, default=SHARED / "bench")
    parser.add_argument("--camera", type=float, nargs=9, default=[752, 480, 458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359],
                        help="width height fx fy cx cy k1 k2 p1 [p2 and k3 are taken as 1.76187114e-05 and 0]")  # fmt: skip
    parser.add_argument("--normal", type=float, nargs=3, default=[0.0, -0.9, -0.436], help="of the floor, in camera axes")
    parser.add_argument("--height", type=float, default=1.0, help="of the camera above the floor, metres")
    parser.add_argument("--corner-px", type=float, nargs=2, default=[335.0, 262.0], help="the rectangle's far left corner in the first picture")
    parser.add_argument("--size", type=float, nargs=2, default=[1.5, 1.1], help="of the rectangle, metres: across the picture, towards the camera")
    parser.add_argument("--texels-per-m", type=float, default=400.0)
    return parser.parse_args()


def lay_flat(chosen, grey, matrix, distortion):
    """Returns the rectangle's artwork, and the fraction of it that the picture shows."""
    normal = np.array(chosen.normal) / np.linalg.norm(chosen.normal)
    ray = np.append(cv2.undistortPoints(np.array([[chosen.corner_px]]), matrix, distortion)[0, 0], 1.0)
    corner = ray * (-chosen.height / (normal @ ray))
    across = np.cross(normal, [0.0, 0.0, 1.0])
    across *= np.sign(across[0]) / np.linalg.norm(across)
    towards = np.cross(across, normal)
    towards *= -np.sign(towards[2])
    w, h = (round(s * chosen.texels_per_m) for s in chosen.size)
    u, v = np.meshgrid((np.arange(w) + 0.5) / chosen.texels_per_m, (np.arange(h) + 0.5) / chosen.texels_per_m)
    points = corner + u[..., None] * across + v[..., None] * towards
    seen = cv2.projectPoints(points.reshape(-1, 3), np.zeros(3), np.zeros(3), matrix, distortion)[0].reshape(h, w, 2).astype(np.float32)
    inside = (seen[..., 0] > 1) & (seen[..., 1] > 1) & (seen[..., 0] < grey.shape[1] - 2) & (seen[..., 1] < grey.shape[0] - 2)
    art = cv2.remap(grey, seen, None, cv2.INTER_CUBIC)
    return np.where(inside, art, 128).astype(np.uint8), inside.mean()


def scatter(positions):
    positions = np.array(positions) * 1e3
    deviation = positions.std(0, ddof=1)
    steps = positions - positions.mean(0)
    return np.linalg.norm(deviation), float((steps[1:] * steps[:-1]).sum() / (steps**2).sum()), len(positions)


def main():
    chosen = arguments()
    pictures = sorted(chosen.pictures.glob("*.png"))
    if not pictures:
        sys.exit(f"still.py: there is no picture in {chosen.pictures}; give --pictures")
    width, height, fx, fy, cx, cy, k1, k2, p1 = chosen.camera
    matrix, distortion = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array([k1, k2, p1, 1.76187114e-05, 0.0])
    out = chosen.out
    (out / "frames").mkdir(parents=True, exist_ok=True)
    rows = ["#timestamp [ns],filename"]
    for picture in pictures:
        link = out / "frames" / picture.name
        if not link.exists():
            link.symlink_to(picture.resolve())
        rows.append(f"{picture.stem},{picture.name}")
    (out / "timestamps.csv").write_text("\n".join(rows) + "\n")
    art, share = lay_flat(chosen, cv2.imread(str(pictures[0]), cv2.IMREAD_GRAYSCALE), matrix, distortion)
    cv2.imwrite(str(out / "reference.png"), art)
    numbers = dict(width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy, skew=0.0)
    (out / "camera.json").write_text(json.dumps(numbers | {"dist": distortion.tolist()}))
    (out / "reference.json").write_text(json.dumps({"image": "reference.png", "size_m": chosen.size}))
    (out / "camera.toml").write_text("".join(f"{k} = {v}\n" for k, v in (numbers | {"distortion": distortion.tolist()}).items()))
    (out / "stage.toml").write_text(f'[camera]\ncalibration = "camera.toml"\nshutter = "global"\n[[stage.surface]]\nimage = "reference.png"\nsize_m = {chosen.size}\n')
    print(f"{len(pictures)} pictures; the surface: {chosen.size} m, {100 * share:.0f} % of it in the picture")
    poses, lk = out / "poses.jsonl", out / "opencv-lk.txt"
    subprocess.run([chosen.binary, "replay", out, "--config", out / "stage.toml", "--poses", poses], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([sys.executable, chosen.bench / "opencv_track.py", out, "lk", lk], check=True, stdout=subprocess.DEVNULL)
    records = [json.loads(line) for line in poses.read_text().splitlines()]
    tracked = [r for r in records if r["state"] == "tracking"]
    results = {"stagepose": [r["measured"]["position_m"] for r in tracked],
               "OpenCV lk": [[float(v) for v in line.split()[1:4]] for line in lk.read_text().splitlines() if line]}  # fmt: skip
    print("| tracker | frames | scatter of the position, mm | lag 1 |\n|---|---|---|---|")
    for name, positions in results.items():
        if len(positions) < 3:
            print(f"| {name} | {len(positions)} | - | - |")
            continue
        deviation, lag, count = scatter(positions)
        print(f"| {name} | {count} | {deviation:.4f} | {lag:.2f} |")
    claimed = [np.sqrt(np.trace(np.reshape(r["covariance"], (6, 6))[:3, :3])) * 1e3 for r in tracked]
    if claimed:
        print(f"stagepose's own standard deviation: {np.mean(claimed):.4f} mm")


if __name__ == "__main__":
    main()
