#!/usr/bin/env python3
"""Calibrates the shared sets with stagepose and, if installed, with OpenCV (classic finder,
cornerSubPix, k3 = 0).

    python3 benches/calibrate.py [--program target/release/stagepose] [--data ../shared/data]

Prints a table: boards found, rms per point, fx with 3 sigma, verdict, and the processor time of the
whole run. The rms covers the corners used; stagepose leaves outliers out, OpenCV keeps them.
"""
import argparse
import glob
import json
import os
import resource
import subprocess
import tempfile
import time

SETS = [
    ("calib-opencv-leftright/left*.jpg", "9x6", 25.0),
    ("calib-opencv-leftright/right*.jpg", "9x6", 25.0),
    ("calib-boofcv-bumblebee2/left*.jpg", "6x4", 30.0),
    ("calib-boofcv-bumblebee2/right*.jpg", "6x4", 30.0),
    ("calib-boofcv-sony/frame*.jpg", "6x4", 30.0),
    ("calib-photonvision-picam640-degenerate/img*.jpg", "7x7", 20.0),
]


def stagepose(program, files, board, square_mm):
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "out.json")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [program, "calibrate", *files, "--board", board, "--square-mm", str(square_mm), "--json", out]
        run = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "RAYON_NUM_THREADS": "1"})
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if not os.path.exists(out):
            return run.stderr.strip()
        with open(out) as file:
            result = json.load(file)
    found = sum(view["found"] for view in result["views"])
    return (
        f"{found}/{len(files)} {result['rms_px']:.3f} px, fx {result['fx']:.2f} +- {result['uncertainty']['fx']:.2f}, "
        f"{result['verdict']}, {seconds:.2f} s"
    )


def opencv(files, board, square_mm):
    import cv2
    import numpy as np

    cv2.setNumThreads(1)
    columns, rows = map(int, board.split("x"))
    grid = np.zeros((rows * columns, 3), np.float32)
    grid[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2) * square_mm * 1e-3
    started = time.process_time()
    corners = []
    for name in files:
        picture = cv2.imread(name, cv2.IMREAD_GRAYSCALE)
        found, seen = cv2.findChessboardCorners(picture, (columns, rows))
        if found:
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
            corners.append(cv2.cornerSubPix(picture, seen, (5, 5), (-1, -1), stop))
    size = picture.shape[::-1]
    result = cv2.calibrateCameraExtended([grid] * len(corners), corners, size, None, None, flags=cv2.CALIB_FIX_K3)
    seconds = time.process_time() - started
    rms, matrix, deviations = result[0], result[1], result[5]
    return f"{len(corners)}/{len(files)} {rms:.3f} px, fx {matrix[0, 0]:.2f} +- {3 * deviations[0, 0]:.2f}, {seconds:.2f} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/stagepose")
    parser.add_argument("--data", default="../shared/data")
    arguments = parser.parse_args()
    try:
        import cv2  # noqa: F401

        has_opencv = True
    except ImportError:
        has_opencv = False
        print("OpenCV is not installed for this Python: only stagepose is measured")
    for pattern, board, square_mm in SETS:
        files = sorted(glob.glob(os.path.join(arguments.data, pattern)))
        if not files:
            print(f"{pattern}: absent")
            continue
        print(f"{pattern}\n  stagepose {stagepose(arguments.program, files, board, square_mm)}")
        if has_opencv:
            print(f"  OpenCV    {opencv(files, board, square_mm)}")


if __name__ == "__main__":
    main()
