"""Times of finding and describing features on one core, compared with OpenCV's: SIFT with SIFT, the
live corners with ORB.

    python benches/features.py STAGEPOSE [PICTURES…] [--rounds 5] [--check]

Every picture is resized to 640 x 480. In each round, `stagepose detectors` and OpenCV process the
same picture right after one another; the fastest round of each counts. ORB detects as many features
as the live detector. Without pictures, it uses the first ones of ../shared's photographs. `--check`
fails if SIFT takes more than 1.5 times OpenCV's time, or the live corners more than 0.7 times
ORB's. A result over its bar is first measured again, up to MORE_ROUNDS times: the fastest round
converges to the undisturbed time of either program, so a program that really is slower stays over
the bar.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2

BARS = {"sift": 1.5, "live": 0.7}
SIZE = (640, 480)
# Repetitions per picture and program in one round; the fastest counts. Raised, the bench takes
# longer; lowered, other load on the machine shows.
TRIES = 6
# Further rounds for a result over its bar, enough to outlast a disturbance of a minute. Raised, a
# program that really is too slow is reported later.
MORE_ROUNDS = 12


@dataclass
class Timed:
    """The fastest times so far in milliseconds, and the keypoint counts, of stagepose and of
    OpenCV."""

    ms: float = float("inf")
    count: int = 0
    their_ms: float = float("inf")
    their_count: int = 0

    @property
    def ratio(self):
        return self.ms / self.their_ms


def ours(program, name, picture, folder):
    """Returns stagepose's milliseconds for one picture, and its keypoint count."""
    table = folder / "table.json"
    command = [program, "detectors", *[picture] * (TRIES + 1), *["--homography", folder / "same"] * TRIES, "--only", name, "--json", table]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "RAYON_NUM_THREADS": "1"})
    rows = json.loads(table.read_text())
    return min(row["features_ms"] for row in rows) / 2, rows[0]["keypoints"][0]


def theirs(name, picture, count):
    """Returns the same for OpenCV."""
    grey = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
    detector = cv2.SIFT_create() if name == "sift" else cv2.ORB_create(nfeatures=count)
    fastest, found = float("inf"), []
    for _ in range(TRIES):
        begun = time.perf_counter()
        found, _ = detector.detectAndCompute(grey, None)
        fastest = min(fastest, time.perf_counter() - begun)
    return 1e3 * fastest, len(found)


def measure(program, name, picture, folder, times):
    """Measures one round of one picture: stagepose, then OpenCV."""
    ms, times.count = ours(program, name, picture, folder)
    their_ms, times.their_count = theirs(name, picture, times.count)
    times.ms, times.their_ms = min(times.ms, ms), min(times.their_ms, their_ms)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    parser.add_argument("pictures", type=Path, nargs="*")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    data = Path(__file__).resolve().parent.parent.parent / "shared/data"
    pictures = arguments.pictures or sorted(data.glob("homog-oxford-*/1.png"))
    if not pictures:
        sys.exit("NOT RUN: no pictures are given, and ../shared is not beside this folder")
    program = arguments.program.resolve()
    cv2.setNumThreads(1)
    print(f"{'picture':<32}{'':<6}{'keypoints':>10}{'ms':>8}{'OpenCV':>10}{'ms':>8}{'ratio':>8}")
    worst = dict.fromkeys(BARS, 0.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "same").write_text("1 0 0 0 1 0 0 0 1")
        # Each round covers all pictures, so that a disturbance of some seconds hits no picture in
        # all its rounds.
        timed = {(picture, kind): Timed() for picture in pictures for kind in BARS}
        small = {picture: folder / f"{number}.png" for number, picture in enumerate(pictures)}
        for picture, file in small.items():
            cv2.imwrite(str(file), cv2.resize(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE), SIZE, interpolation=cv2.INTER_AREA))
        for _ in range(arguments.rounds):
            for (picture, kind), times in timed.items():
                measure(program, kind, small[picture], folder, times)
        for _ in range(MORE_ROUNDS if arguments.check else 0):
            for (picture, kind), times in timed.items():
                if times.ratio > BARS[kind]:
                    print(f"{picture.parent.name} {kind}: {times.ratio:.2f}, measured again", file=sys.stderr)
                    measure(program, kind, small[picture], folder, times)
    for (picture, kind), of in timed.items():
        worst[kind] = max(worst[kind], of.ratio)
        words = f"{picture.parent.name}/{picture.name}"
        print(f"{words:<32}{kind:<6}{of.count:>10}{of.ms:>8.1f}{of.their_count:>10}{of.their_ms:>8.1f}{of.ratio:>8.2f}")
    over = [kind for kind, bar in BARS.items() if worst[kind] > bar]
    for kind, bar in BARS.items():
        print(f"{kind}: at worst {worst[kind]:.2f} (bar {bar})")
    if arguments.check and over:
        sys.exit("over the bar: " + ", ".join(over))


if __name__ == "__main__":
    main()
