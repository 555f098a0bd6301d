"""What a prediction is worth: [filter] kinds on rendered clips, compared with exact ground truth.

    python benches/prediction.py FOLDER [CLIP ...] [--ahead 0.033] [--check]

FOLDER has clips as benches/clips.py leaves them (frames, stage.toml, groundtruth.txt). For each
clip and filter, it prints the error of the position predicted for `ahead` seconds after the frame,
as a multiple of the error of sending the measured pose (rms and median), and the rotation's error
in the same way. For a still clip, it prints the scatter of the predicted positions as a multiple of
that of the measured ones. --check fails beyond the bars, which apply to positions only.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

ROOT = Path(__file__).resolve().parent.parent
# Maximum error of a prediction, as a fraction of the measured pose's; and maximum growth of the
# scatter at rest.
ERROR_BARS = {"d-dolly": 0.05, "d-handheld": 0.4}
SCATTER_BAR = 1.5
SETTLED = 10  # poses: a third of a second until the velocity is known


def truth_at(folder):
    rows = np.loadtxt(folder / "groundtruth.txt")
    t, p = rows[:, 0], rows[:, 1:4]

    def at(when):
        """Interpolates the four surrounding ground truth positions (Catmull-Rom); accurate to
        microns at 30 frames a second."""
        k = int(np.clip(np.searchsorted(t, when) - 1, 1, len(t) - 3))
        s = (when - t[k]) / (t[k + 1] - t[k])
        a, b, c, d = p[k - 1 : k + 3]
        return b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))

    return at, Slerp(t, Rotation.from_quat(rows[:, 4:8])), t[1], t[-2]


def track(binary, folder, kind, ahead):
    # benches/clips.py keeps the config in a separate folder.
    config = next(c for c in (folder / "stage.toml", folder / "stagepose/stage.toml") if c.exists())
    stage = re.sub(r'(calibration|image|photo|mask) = "', rf'\1 = "{config.parent.resolve()}/', config.read_text())
    with tempfile.TemporaryDirectory() as temporary:
        config, poses = Path(temporary) / "stage.toml", Path(temporary) / "poses.jsonl"
        config.write_text(f'{stage}\n[filter]\nkind = "{kind}"\npredict_s = {ahead}\n')
        command = [binary, "replay", folder, "--config", config, "--poses", poses]
        subprocess.run([str(c) for c in command], check=True, capture_output=True)
        return [json.loads(line) for line in poses.read_text().splitlines()]


def score(records, folder, ahead):
    at, turned_at, first, last = truth_at(folder)
    told, held, predicted, measured, turns, run = [], [], [], [], [], 0
    for record in records:
        run = run + 1 if record["state"] == "tracking" else 0
        when = record["timestamp_ns"] * 1e-9 + ahead
        if run <= SETTLED or not first <= when <= last:
            continue
        predicted.append(record["pose"]["position_m"])
        measured.append(record["measured"]["position_m"])
        told.append(np.linalg.norm(predicted[-1] - at(when)))
        held.append(np.linalg.norm(measured[-1] - at(when)))
        both = Rotation.from_quat([record[key]["orientation_xyzw"] for key in ("pose", "measured")])
        turns.append((both * turned_at(when).inv()).magnitude())
    told, held = np.array(told), np.array(held)
    turned = np.sqrt(np.mean(np.square(turns), axis=0))
    scatter = np.sqrt(np.var(predicted, axis=0).sum() / np.var(measured, axis=0).sum())
    moved = np.ptp(np.array([at(w) for w in np.linspace(first, last, 50)]), axis=0).max()
    return {
        "poses": len(told), "held_mm": 1e3 * np.sqrt(np.mean(held**2)), "rms": np.sqrt(np.mean(told**2) / np.mean(held**2)),
        "median": np.median(told) / np.median(held), "scatter": scatter, "turn": turned[0] / turned[1], "is_still": moved < 1e-6,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("clips", nargs="*", default=["d-dolly", "d-handheld", "d-still"])
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/stagepose")
    parser.add_argument("--ahead", type=float, default=0.033)
    parser.add_argument("--kinds", nargs="+", default=["kalman"])
    parser.add_argument("--check", action="store_true")
    a = parser.parse_args()
    failed = False
    for clip in a.clips:
        for kind in a.kinds:
            s = score(track(a.binary, a.folder / clip, kind, a.ahead), a.folder / clip, a.ahead)
            if s["is_still"]:
                verdict, text = s["scatter"] <= SCATTER_BAR, f"scatter x {s['scatter']:.2f} (bar {SCATTER_BAR})"
            else:
                bar = next((bar for name, bar in ERROR_BARS.items() if clip.startswith(name)), float("inf"))
                verdict = s["rms"] <= bar
                text = f"error x {s['rms']:.3f} rms, x {s['median']:.3f} median of {s['held_mm']:.1f} mm (bar {bar})"
            text += f", rotation x {s['turn']:.3f}"
            # The bars only apply to the filter that is designed to predict.
            verdict |= kind != "kalman"
            failed |= not verdict
            print(f"{clip:12} {kind:9} +{1e3 * a.ahead:.0f} ms, {s['poses']} poses: {text}{'' if verdict else '  <-- beyond the bar'}", flush=True)
    sys.exit(1 if a.check and failed else 0)


if __name__ == "__main__":
    main()
