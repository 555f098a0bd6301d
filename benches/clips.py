#!/usr/bin/env python3
"""The score table: rendered clips with exact ground truth, tracked by stagepose and by OpenCV.

Each scene is rendered (kept below --out and reused), tracked on one thread, and scored against its
ground truth. The result is one Markdown table. The trackers built from OpenCV's parts run in the
same session. It needs the renderer and its scenes in ../shared/bench and the Python packages of
its requirements.txt:

    python3 -m venv target/venv && target/venv/bin/pip install -r ../shared/bench/requirements.txt
    cargo build --release && target/venv/bin/python benches/clips.py --check
"""
import argparse
import concurrent.futures
import json
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
from scipy.spatial.transform import Rotation

PROJECT = pathlib.Path(__file__).resolve().parent.parent


class Bar:
    """The limits for a clip. Errors are medians over the frames with a right pose."""

    def __init__(self, good, wrong="tight", good_of="all", permille=None, peer=None, times_peer=1.0, essential_deg=None,
                 nees=None):  # fmt: skip
        self.good = good  # minimum fraction of frames with a right pose
        self.wrong = wrong  # rule by which a pose is wrong; none may be
        self.good_of = good_of  # of all frames, or of those that show the stage
        self.permille = permille  # maximum position error, thousandths of the distance
        # maximum position error, in multiples of this peer's
        self.peer, self.times_peer = peer, times_peer
        # maximum error of the essential matrix' rotation and direction
        self.essential_deg = essential_deg
        # minimum and maximum mean of NEES/6, the squared error normalised by the covariance; 1 is
        # honest
        self.nees = nees


BARS = {
    "d-dolly":    Bar(good=0.98, permille=0.8, peer="orb", essential_deg=2.0),
    "d-1080p":    Bar(good=0.98, permille=0.8, peer="orb", nees=(0.5, 2.0)),
    "d-relief":   Bar(good=0.98, permille=0.8, peer="orb", nees=(0.5, 2.0)),
    # 70 % of a clip that shows the stage in 77 % of its frames
    "d-blackout": Bar(good=0.91, good_of="visible", peer="orb"),
    "d-handheld": Bar(good=0.95, wrong="plain", peer="sift", times_peer=1.3),
    "d-steep":    Bar(good=0.40),
    # light adds up as light does: along sRGB, clipped, along a curve with contrast, in motion
    "d-linear":          Bar(good=0.98, permille=0.02, nees=(0.3, 2.0)),
    "d-linear-clip":     Bar(good=0.98, permille=0.02, nees=(0.3, 2.0)),
    "d-linear-tone":     Bar(good=0.98, permille=0.03, nees=(0.3, 2.0)),
    "d-linear-steep":    Bar(good=0.98, permille=0.03),
    "d-linear-handheld": Bar(good=0.98, permille=0.05),
}
AGAINST = "before"  # name of the --against build in the table
RUNS_AGAINST = 3  # runs of each build; the fastest counts, because other load only slows it
WORSE = 0.02  # fraction by which error, good and NEES may be worse than the older build's
SLOWER = 0.03  # fraction by which a frame may take longer
DECOY = "decoy"  # d-dolly's clip with d-still's stage: no pose may be reported
# maximum median time of a 1280 x 720 frame on one thread; it must also be below orb's in the same
# run
TIME_BAR_MS = 40.0

COLUMNS = ["clip", "frames", "tracker", "good %", "wrong %", "plain wrong %", "median mm", "permille", "rotation deg",
           "ms p50", "ms p95", "E rotation deg", "E direction deg", "NEES/6"]  # fmt: skip


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE[:N[:K]]",
                        help=f"only its first N frames, of these every Kth; {DECOY} is one too [default: all that have a bar]")  # fmt: skip
    parser.add_argument("--frames", type=int, help="only the first N frames of scenes that say nothing else")
    parser.add_argument("--peers", default="orb,sift", help="orb, sift, lk with commas between; bars = those that the bars name; or nothing")
    parser.add_argument("--out", type=pathlib.Path, default=PROJECT / "target/clips")
    parser.add_argument("--binary", type=pathlib.Path, default=PROJECT / "target/release/stagepose")
    parser.add_argument("--against", type=pathlib.Path, help="an older build: each clip is tracked by both in turn, and what got worse is named")
    parser.add_argument("--bench", type=pathlib.Path, default=PROJECT.parent / "shared/bench", help="where render.py and the scenes are")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="scenes rendered at a time; tracking is one at a time")
    parser.add_argument("--check", action="store_true", help="end with 1 when a bar is missed, times excepted")
    parser.add_argument("--check-times", action="store_true", help="the same for the times")
    chosen = parser.parse_args()
    chosen.scenes = chosen.scenes or [*BARS, DECOY]
    if not chosen.bench.is_dir():
        sys.exit(f"clips.py: {chosen.bench} is not there; give --bench")
    if not chosen.binary.exists():
        sys.exit(f"clips.py: {chosen.binary} is not there; run `cargo build --release`, or give --binary")
    if chosen.against is not None and not chosen.against.exists():
        sys.exit(f"clips.py: {chosen.against} is not there")
    return chosen


# ---- clips


class Clip:
    """A rendered scene: the folder that replay reads, and what is known about it."""

    def __init__(self, wanted, chosen, truth_only=False):
        name, *part = wanted.split(":")
        self.name, self.truth_only, self.bench = name, truth_only, chosen.bench
        file = chosen.bench / "scenes" / f"{name}.json"
        if not file.exists():
            sys.exit(f"clips.py: there is no scene {name}: {file} is missing")
        self.scene = json.loads(file.read_text())
        whole = self.scene["frames"]
        frames = min(int(part[0]) if part else chosen.frames or whole, whole)
        every = int(part[1]) if len(part) > 1 else 1
        part = "" if (frames, every) == (whole, 1) else f"-{frames}-every-{every}"
        self.scene["frames"] = -(-frames // every)
        self.scene["fps"] = self.scene.get("fps", 30) / every
        self.folder = chosen.out / (name + part + ("-truth" if truth_only else ""))

    def render(self):
        """Renders the scene, unless the same one is there already."""
        kept = self.folder / "scene.json"
        text = json.dumps(self.scene, indent=1)
        # The renderer writes surfaces.json near the end, so it marks a complete clip.
        if kept.exists() and kept.read_text() == text and (self.folder / "surfaces.json").exists():
            return
        (self.folder / "surfaces.json").unlink(missing_ok=True)
        self.folder.mkdir(parents=True, exist_ok=True)
        kept.write_text(text)
        print(f"rendering {self.folder.name}: {self.scene['frames']} frames", file=sys.stderr, flush=True)
        run([sys.executable, self.bench / "render.py", kept, self.folder, *(["--truth-only"] if self.truth_only else [])])

    def surfaces(self):
        return json.loads((self.folder / "surfaces.json").read_text())

    def size(self):
        return self.scene["camera"]["width"], self.scene["camera"]["height"]

    def share_visible(self):
        """Returns the fraction of the frames in which the camera is not covered."""
        stamps = np.arange(self.scene["frames"]) / self.scene["fps"]
        covered = np.zeros(len(stamps), bool)
        for first, last in self.scene.get("blackout", []):
            covered |= (first <= stamps) & (stamps < last)
        return 1.0 - covered.mean()

    def write_config(self, folder, stage):
        """Writes camera.toml and stage.toml: this clip's camera with the surfaces of the clip
        `stage`."""
        folder.mkdir(parents=True, exist_ok=True)
        camera = json.loads((self.folder / "camera.json").read_text())
        camera["distortion"] = camera.pop("dist")
        (folder / "camera.toml").write_text("".join(f"{key} = {value}\n" for key, value in camera.items()))
        readout_s = float(self.scene.get("readout_s", 0.0))
        shutter = f"readout_s = {readout_s}" if readout_s else 'shutter = "global"'
        # The other scenes average grey levels, as if camera and pictures encoded nothing.
        transfer = "" if "linear" in self.scene else 'transfer = "linear"\n'
        text = f'[camera]\ncalibration = "camera.toml"\n{shutter}\n{transfer}'
        for body in dict.fromkeys(surface["body"] for surface in stage.surfaces()):
            section = "stage" if body == "stage" else "object"
            text += "" if body == "stage" else f'\n[[object]]\nname = "{body}"\n'
            for surface in (s for s in stage.surfaces() if s["body"] == body):
                image = os.path.relpath(stage.folder / surface["image"], folder)
                text += f'\n[[{section}.surface]]\nimage = "{image}"\nsize_m = {surface["size_m"]}\n{transfer}'
                if body == "stage":
                    text += f'position_m = {surface["position_m"]}\norientation_xyzw = {surface["orientation_xyzw"]}\n'
                else:
                    # The object's frame is that of its surface.
                    text += "orientation_xyzw = [0, 0, 0, 1]\n"
        (folder / "stage.toml").write_text(text)
        return folder / "stage.toml"


def put_together(folder, shown):
    """Makes a clip of links to pictures in this order: (timestamp in nanoseconds, picture). A
    picture may appear several times."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "frames").mkdir(parents=True)
    lines = ["#timestamp [ns],filename"]
    for stamp, picture in shown:
        link = folder / "frames" / picture.name
        if not link.exists():
            link.symlink_to(picture.resolve())
        lines.append(f"{stamp},{link.name}")
    (folder / "timestamps.csv").write_text("\n".join(lines) + "\n")


def run(command):
    """Runs a program and returns what it printed; its failure ends this script."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"clips.py: {' '.join(str(part) for part in command)} ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def track(binary, clip, config, folder):
    """Runs replay on one thread and returns the records' file and the summary."""
    poses, summary = folder / "poses.jsonl", folder / "summary.json"
    run([binary, "replay", clip.folder, "--config", config, "--threads", 1, "--poses", poses, "--summary", summary])
    return poses, json.loads(summary.read_text())


# ---- scores


def pose(numbers):
    """Returns position and rotation from seven numbers, x y z and the quaternion."""
    return np.array(numbers[:3]), Rotation.from_quat(numbers[3:7])


def reference_camera(surface):
    """Returns the pose in the stage of the virtual camera on a surface's axis, at the distance of
    its width (C3)."""
    rotation = Rotation.from_quat(surface["orientation_xyzw"])
    looking_back = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    return np.array(surface["position_m"]) + rotation.apply([0.0, 0.0, surface["size_m"][0]]), rotation * looking_back


def consistency(evaluate, clip, poses):
    """Returns the median errors of the essential matrix in degrees, and the mean NEES/6 (squared
    error normalised by the covariance)."""
    truth = evaluate.read(clip.folder / "groundtruth.txt")
    reference_position, reference_rotation = reference_camera(clip.surfaces()[0])
    rotation_deg, direction_deg, nees = [], [], []
    for record in (json.loads(line) for line in poses.read_text().splitlines()):
        true = truth.get(round(record["timestamp_ns"] / 1e6))
        if record["state"] != "tracking" or true is None:
            continue
        position, rotation = pose(true)
        measured, covariance = record["measured"], np.array(record["covariance"]).reshape(6, 6)
        turn = (rotation * Rotation.from_quat(measured["orientation_xyzw"]).inv()).as_rotvec()
        error = np.concatenate([position - measured["position_m"], turn])
        nees.append(error @ np.linalg.solve(covariance, error) / 6)
        if record["essential"]:
            true_rotation = rotation.inv() * reference_rotation
            true_direction = rotation.inv().apply(reference_position - position)
            true_direction /= np.linalg.norm(true_direction)
            given = Rotation.from_quat(record["essential"]["rotation_xyzw"])
            rotation_deg.append(np.degrees((given.inv() * true_rotation).magnitude()))
            cosine = true_direction @ record["essential"]["translation_direction"]
            direction_deg.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    middle = lambda values: float(np.median(values)) if values else None
    return middle(rotation_deg), middle(direction_deg), float(np.mean(nees)) if nees else None


def score(evaluate, clip, tracker, estimate):
    """Returns a row of the table: errors by the clip's own rule of wrong poses, and the counts of
    wrong poses by both rules."""
    truth = clip.folder / "groundtruth.txt"
    tight, plain = evaluate.score(truth, estimate, True), evaluate.score(truth, estimate, False)
    rule = plain if clip.name in BARS and BARS[clip.name].wrong == "plain" else tight
    return {
        "clip": clip.folder.name, "frames": rule["frames"], "tracker": tracker, "good %": 100 * rule["good"],
        "wrong %": 100 * tight["wrong"], "plain wrong %": 100 * plain["wrong"], "median mm": rule.get("pos_mm_median"),
        "permille": rule.get("pos_permille"), "rotation deg": rule.get("rot_deg_median"),
    }  # fmt: skip


def score_clip(evaluate, clip, chosen):
    """Returns the rows of one clip: stagepose, then the older build, then the peers."""
    folder = clip.folder / "stagepose"
    config = clip.write_config(folder, clip)
    builds = {"stagepose": chosen.binary} | ({AGAINST: chosen.against} if chosen.against else {})
    times = {name: [] for name in builds}
    # The builds take turns, so that a machine that slows down slows both.
    for _ in range(RUNS_AGAINST if chosen.against else 1):
        for name, binary in builds.items():
            (folder / name).mkdir(exist_ok=True)
            poses, summary = track(binary, clip, config, folder / name)
            times[name].append(summary["stage_ms"]["total"])
    rows = []
    for name in builds:
        poses = folder / name / "poses.jsonl"
        row = score(evaluate, clip, name, poses)
        row["ms p50"], row["ms p95"] = (min(run[percentile] for run in times[name]) for percentile in ("p50", "p95"))
        row["E rotation deg"], row["E direction deg"], row["NEES/6"] = consistency(evaluate, clip, poses)
        rows.append(row)
    for peer in peers(clip, chosen):
        estimate = clip.folder / f"opencv-{peer}.txt"
        printed = json.loads(run([sys.executable, chosen.bench / "opencv_track.py", clip.folder, peer, estimate]).splitlines()[-1])
        rows.append(score(evaluate, clip, f"OpenCV {peer}", estimate) | {"ms p50": printed["ms_median"], "ms p95": printed["ms_p95"]})
    return rows


def peers(clip, chosen):
    if chosen.peers == "bars":
        return [BARS[clip.name].peer] if clip.name in BARS and BARS[clip.name].peer else []
    return [peer for peer in chosen.peers.split(",") if peer]


def score_decoy(clip, stage, chosen):
    """Returns the decoy's row, which has no errors because there is nothing to find."""
    folder = clip.folder / DECOY
    _, summary = track(chosen.binary, clip, clip.write_config(folder, stage), folder)
    wrong = 100 * summary["tracking"] / summary["frames"]
    total = summary["stage_ms"]["total"]
    return {"clip": DECOY, "frames": summary["frames"], "tracker": "stagepose", "wrong %": wrong, "plain wrong %": wrong,
            "ms p50": total["p50"], "ms p95": total["p95"]}  # fmt: skip


# ---- bars


def missed(clip, rows):
    """Yields a sentence for each bar that a clip's rows miss."""
    bar, ours = BARS.get(clip.name), rows[0]
    if bar is None:
        return
    shown = clip.share_visible() if bar.good_of == "visible" else 1.0
    if ours["good %"] < 100 * bar.good * shown - 1e-9:
        yield f"good is {ours['good %']:.1f} %, at least {100 * bar.good * shown:.1f} % are wanted"
    column = "wrong %" if bar.wrong == "tight" else "plain wrong %"
    if ours[column] > 0:
        yield f"{column[:-2]} is {ours[column]:.1f} %, none may be"
    if ours["median mm"] is None:
        return
    if bar.permille is not None and ours["permille"] > bar.permille:
        yield f"position is {ours['permille']:.2f} permille off, at most {bar.permille} are wanted"
    theirs = next((row["median mm"] for row in rows if row["tracker"] == f"OpenCV {bar.peer}"), None)
    if theirs is not None and ours["median mm"] > bar.times_peer * theirs:
        yield f"position is {ours['median mm']:.2f} mm off, at most {bar.times_peer} x {bar.peer}'s {theirs:.2f} mm are wanted"
    if bar.nees is not None and not bar.nees[0] <= ours["NEES/6"] <= bar.nees[1]:
        yield f"NEES/6 is {ours['NEES/6']:.2f}, {bar.nees[0]} to {bar.nees[1]} are wanted"
    for column in ["E rotation deg", "E direction deg"] if bar.essential_deg is not None else []:
        if ours[column] is None or ours[column] > bar.essential_deg:
            yield f"{column} is {ours[column]}, at most {bar.essential_deg} is wanted"


def missed_times(clip, rows):
    """Yields a sentence for each time bar that a clip's rows miss."""
    if clip.size() != (1280, 720):
        return
    ours = rows[0]["ms p50"]
    theirs = next((row["ms p50"] for row in rows if row["tracker"] == "OpenCV orb"), None)
    if ours > TIME_BAR_MS:
        yield f"a frame takes {ours:.1f} ms, at most {TIME_BAR_MS} are wanted"
    if theirs is not None and ours >= theirs:
        yield f"a frame takes {ours:.1f} ms, less than orb's {theirs:.1f} are wanted"


def worse(rows):
    """Yields a sentence for each number that is worse than the older build's."""
    now, before = rows[0], next((row for row in rows if row["tracker"] == AGAINST), None)
    if before is None:
        return
    for column in ("wrong %", "plain wrong %"):
        if now[column] > before[column]:
            yield f"{column} is {now[column]:.2f}, and was {before[column]:.2f}"
    if now["good %"] < (1 - WORSE) * before["good %"]:
        yield f"good is {now['good %']:.1f} %, and was {before['good %']:.1f}"
    if None not in (now["median mm"], before["median mm"]) and now["median mm"] > (1 + WORSE) * before["median mm"]:
        yield f"position is {now['median mm']:.4f} mm off, and was {before['median mm']:.4f}"
    if None not in (now["NEES/6"], before["NEES/6"]):
        # Compares the distance from 1 on a logarithmic scale: a sigma twice too wide is as wrong as
        # one twice too narrow.
        off = lambda row: abs(np.log(row["NEES/6"]))
        if off(now) > off(before) + WORSE:
            yield f"NEES/6 is {now['NEES/6']:.3f}, and was {before['NEES/6']:.3f}"


def slower(rows):
    """Yields a sentence if a frame takes longer than with the older build."""
    now, before = rows[0], next((row for row in rows if row["tracker"] == AGAINST), None)
    if before is not None and now["ms p50"] > (1 + SLOWER) * before["ms p50"]:
        yield f"a frame takes {now['ms p50']:.2f} ms, and took {before['ms p50']:.2f}"


def cell(value):
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 10 else f"{value:.1f}"
    return "-" if value is None else str(value)


def print_row(cells):
    print("| " + " | ".join(cells) + " |", flush=True)


def conclude(faults, late, chosen):
    """Prints the missed bars; ends with 1 if that was requested, for times and for the rest
    separately."""
    for sentence in faults + late:
        print(f"missed: {sentence}", file=sys.stderr)
    if (chosen.check and faults) or (chosen.check_times and late):
        sys.exit(1)


def main():
    chosen = arguments()
    chosen.out = chosen.out.resolve()
    # The renderer's folder may be read-only, so compiled code goes elsewhere.
    os.environ.setdefault("NUMBA_CACHE_DIR", str(chosen.out / "numba"))
    sys.path.insert(0, str(chosen.bench))
    sys.dont_write_bytecode = True
    import evaluate

    clips = [Clip(name, chosen) for name in chosen.scenes if name != DECOY]
    decoy = [Clip("d-dolly", chosen), Clip("d-still", chosen, truth_only=True)] if DECOY in chosen.scenes else []
    with concurrent.futures.ThreadPoolExecutor(chosen.jobs) as pool:
        # Keyed by folder, so that a clip requested twice is rendered once.
        list(pool.map(Clip.render, {clip.folder: clip for clip in clips + decoy}.values()))

    print_row(COLUMNS)
    print_row(["---"] * len(COLUMNS))
    faults, late = [], []
    for clip in clips:
        rows = score_clip(evaluate, clip, chosen)
        for row in rows:
            print_row([cell(row.get(column)) for column in COLUMNS])
        faults += [f"{clip.folder.name}: {sentence}" for sentence in [*missed(clip, rows), *worse(rows)]]
        late += [f"{clip.folder.name}: {sentence}" for sentence in [*missed_times(clip, rows), *slower(rows)]]
    if decoy:
        row = score_decoy(*decoy, chosen)
        print_row([cell(row.get(column)) for column in COLUMNS])
        if row["wrong %"] > 0:
            faults.append(f"{DECOY}: {row['wrong %']:.1f} % of the frames have a pose, though the stage is not there")
    conclude(faults, late, chosen)


if __name__ == "__main__":
    main()
