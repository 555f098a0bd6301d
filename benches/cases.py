#!/usr/bin/env python3
"""Checks the inputs of ../shared/cases against their right values.

    cargo build --release
    python3 benches/cases.py                # all; needs ffmpeg
    python3 benches/cases.py 01 14 --show   # some, with what they print
    python3 benches/cases.py --except 07    # all but this one

Every folder there has a run.sh, which prints what the program makes of an input from the field, and
an expected.txt, which describes the right result. The right values are asserted here. Ends with 1
if one is missed, and if a folder has no assertion yet. Uses the standard library only.
"""
import argparse
import os
import pathlib
import re
import subprocess
import sys
import time

PROJECT = pathlib.Path(__file__).resolve().parent.parent
SECONDS = 300  # a case that takes longer hangs
# Maximum error of a correctly read input. Poses of the fixture are right to 0.2 mm; a wrongly read
# input is centimetres off.
NEAR_MM = 1.0
# A video with few colours or few bits is slightly worse.
FAIR_MM = 2.0
# Maximum position error in sigmas: for a vector of three numbers, more than four is no coincidence.
MOST_SIGMAS = 4.0


class Missed(Exception):
    """A result that is not as it should be."""


def need(is_right, words):
    if not is_right:
        raise Missed(words)


# ---- what a case prints


def blocks(text):
    """Returns the parts after "== NAME" lines, by name; text after a colon on that line belongs to
    the part."""
    found = {}
    for part in re.split(r"^== ", text, flags=re.M)[1:]:
        name, _, rest = part.partition("\n")
        name, _, words = name.partition(": ")
        found[name.strip()] = words + "\n" + rest
    return found


def block(text, name):
    """Returns one part, by its name or the beginning of its name."""
    parts = blocks(text)
    for key in [name, *(key for key in parts if key.startswith(name))]:
        if key in parts:
            return parts[key]
    raise Missed(f"nothing was printed for {name!r}")


class Poses:
    """The line printed by off.py: the number of poses, their errors, and their stated sigma."""

    def __init__(self, text):
        count = re.search(r"measured (\d+)", text)
        self.count = int(count[1]) if count else 0
        numbers = re.search(r"; off ([\d.]+) mm \(most ([\d.]+)\), ([\d.]+) degrees(?:; told one sigma ([\d.]+) mm)?", text)
        self.off_mm, self.most_mm, self.off_deg, self.sigma_mm = (float(n) if n else None for n in numbers.groups()) if numbers else [None] * 4

    def need(self, least, most_mm, what):
        need(self.count >= least, f"{what}: {self.count} poses, not {least}")
        need(self.off_mm <= most_mm, f"{what}: {self.off_mm} mm off, not {most_mm}")
        need(self.off_deg <= 0.1, f"{what}: {self.off_deg} degrees off")


def without(text, what, words):
    found = re.search(what, text, flags=re.I)
    need(not found, f"{words}: {found[0] if found else ''}")


def has(text, what, words):
    need(re.search(what, text, flags=re.I), words)


# ---- the right values


def ros_roi(text):
    for name in ("roi", "roi-baxter"):
        part = block(text, name)
        poses = Poses(part)
        if poses.count:
            poses.need(36, NEAR_MM, name)
        else:
            has(part, rf"{name}\.yaml[: ](.* )?line \d+", f"{name}: neither read right nor refused by its line")
        without(part, "artwork|order of the corners", f"{name}: the artwork is blamed")


def rotated_video(text):
    Poses(block(text, "as-it-lies")).need(36, NEAR_MM, "as it lies")
    for degrees in ("180", "90"):
        part = block(text, f"shown-turned-{degrees}")
        Poses(part).need(36, NEAR_MM, f"turned by {degrees}")
        has(part, rf"(turn|rotat).*{degrees}|{degrees}.*(turn|rotat)|270", f"turned by {degrees}: no word that the file says so")
    without(block(text, "check shown-turned-180"), "stands elsewhere|upside down", "check blames the stage")


def rgb_video(text):
    names = ["screen-x264rgb.mkv", "png.mov", "raw-bgr24.avi", "animation.mov", "ffv1-bgr0.mkv", "huffyuv-rgb.avi", "palette.gif"]
    for name in names:
        Poses(block(text, name)).need(11, FAIR_MM, name)


def sensor_crop(text):
    for factor in ("0.667", "0.85", "1.1", "1.25"):
        poses = Poses(block(text, f"focal length told {factor} "))
        is_contained = poses.count == 0 or poses.off_mm <= MOST_SIGMAS * (poses.sigma_mm or 0.0)
        # A twentieth of 240 frames: poses may be reported until the lens is found to differ.
        need(poses.count <= 12 or is_contained, f"{factor}: {poses.count} poses {poses.off_mm} mm off, one sigma {poses.sigma_mm}")


def fisheye_calibration(text):
    for name in ("calibrate", "calibrate --k3"):
        part = block(text, name)
        has(part, "Verdict: do not use", f"{name}: a lens that is not supported is called fit")
        need("-- check with that file" not in part, f"{name}: the file is written")
        has(part, "fisheye|very wide", f"{name}: the lens is not named")


def photo_corners(text):
    for name in ("exact", "to whole pixels", "one corner a pixel off", "each up to a pixel off", "each a pixel off", "two pixels"):
        part = block(text, name)
        poses = Poses(part)
        need(poses.count >= 36, f"{name}: {poses.count} poses of 40")
        without(part, "focal length|zoom", f"{name}: the lens is blamed")
        need(name == "exact" or poses.off_mm <= MOST_SIGMAS * poses.sigma_mm, f"{name}: {poses.off_mm} mm off, one sigma {poses.sigma_mm}")
    Poses(block(text, "exact")).need(40, NEAR_MM, "exact")


def stamps_unit(text):
    for name, unit in (("divided by 1000000", "millisecond|million"), ("divided by 1000", "microsecond|thousand")):
        part = block(text, name)
        without(part, r"(exposure_s|readout_s) =", f"{name}: the config is blamed")
        has(part, "stamp", f"{name}: the stamps are not named")
        has(part, unit, f"{name}: their unit is not named")


def size_change(text):
    for name, rows in (("smaller", 78), ("larger", 78), ("and-back", 117)):
        part = block(text, name)
        end = re.search(r"exit code (\d+).*, (\d+) rows", part)
        need(end and end[1] == "0", f"{name}: exit code {end and end[1]}")
        need(int(end[2]) >= rows, f"{name}: {end[2]} rows")
        Poses(part).need(36, 2 * FAIR_MM, name)


def osc_listen(text):
    without(text, "not an OSC packet", "the sender is blamed")
    lines = text.splitlines()
    need(len(lines) >= 7 and all(line.strip() for line in lines), "a datagram has no line, or an empty one")
    for what, least in ((r"/a 4", 2), (r"/b\b", 3), (r"/info\b", 1), (r"/go\b", 1), (r"/cue\b", 1)):
        need(len(re.findall(what, text)) >= least, f"{what} is shown less than {least} times")


def utf16_calibration(text):
    lines = dict(line.split(": ", 1) for line in text.splitlines() if ": " in line)
    for name in ("powershell.yaml", "no-bom.yml"):
        is_read = not lines[name].startswith("stagepose:")
        need(is_read or "UTF-16" in lines[name], f"{name}: {lines[name]}")
    words = lines["uncalibrated.yaml"].replace("uncalibrated.yaml", "")
    has(words, "uncalibrated|not (been )?calibrated|never calibrated", f"uncalibrated.yaml: {words}")


def folder_and_single_picture(text):
    for form, words in (("bmp", "BMP"), ("tif", "TIFF?"), ("webp", "WebP")):
        line = re.search(rf"^{form}: (.*)$", text, flags=re.M)
        need(line and "is empty" not in line[1], f"{form}: the folder is called empty")
        has(line[1].replace(f"clip {form}", ""), rf"{words}|PNG|JPEG", f"{form}: the forms are not named")
    single = text[text.index("single: "):]
    without(single, "next frame|come too rarely", "a single picture waits for a frame that never comes")
    has(single, "one picture|single picture|two or more|give a clip", "a single picture: not said what to give")


def transparent_artwork(text):
    Poses(block(text, "same-on-white")).need(14, NEAR_MM, "on white")
    part = block(text, "logo-on-transparency")
    has(part.replace("logo-on-transparency", ""), "transparen", "no word of what is transparent")
    if Poses(part).count or "good" in part.splitlines()[0]:
        Poses(part).need(14, NEAR_MM, "on transparency")


CASES = {
    "01": ros_roi, "03": rotated_video, "04": rgb_video, "07": sensor_crop, "08": fisheye_calibration, "10": photo_corners,
    "12": stamps_unit, "14": size_change, "15": osc_listen, "16": utf16_calibration, "17": folder_and_single_picture,
    "18": transparent_artwork,
}  # fmt: skip


# ---- running


def printed(folder, binary, fixture):
    """Returns what a case prints, and its duration in seconds."""
    environment = os.environ | {"STAGEPOSE": str(binary), "FIXTURE": str(fixture), "CACHE_DIRECTORY": "/dev/null"}
    began = time.monotonic()
    done = subprocess.run(["bash", str(folder / "run.sh")], cwd=PROJECT, env=environment, timeout=SECONDS,
                          stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")  # fmt: skip
    return done.stdout, time.monotonic() - began


def judged(folder, chosen):
    number = folder.name[:2]
    text, seconds = "", SECONDS
    try:
        text, seconds = printed(folder, chosen.binary.resolve(), PROJECT / "fixtures/dolly")
        need(number in CASES, "it has no assertion in benches/cases.py")
        CASES[number](text)
        fault = None
    except Missed as missed:
        fault = str(missed)
    except subprocess.TimeoutExpired:
        fault = f"it takes longer than {SECONDS} s"
    except Exception as error:  # its output has another format
        fault = f"its output cannot be read ({error!r})"
    print(f"{folder.name:34} {seconds:5.1f} s  {'right' if fault is None else 'MISSED: ' + fault}", flush=True)
    if chosen.show:
        print(text, flush=True)
    return fault is None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("numbers", nargs="*", metavar="NN", help="[default: all]")
    parser.add_argument("--except", nargs="+", default=[], metavar="NN", dest="left_out", help="these are not run")
    parser.add_argument("--binary", type=pathlib.Path, default=PROJECT / "target/release/stagepose")
    parser.add_argument("--cases", type=pathlib.Path, default=PROJECT.parent / "shared/cases")
    parser.add_argument("--show", action="store_true", help="print what each prints")
    chosen = parser.parse_args()
    if not chosen.cases.is_dir():
        print(f"NOT RUN: the cases; {chosen.cases} is not there", file=sys.stderr)
        return 0
    folders = [f for f in sorted(chosen.cases.iterdir()) if (f / "run.sh").is_file()]
    folders = [f for f in folders if not chosen.numbers or f.name[:2] in chosen.numbers]
    left_out = [f for f in folders if f.name[:2] in chosen.left_out]
    for folder in left_out:
        print(f"{folder.name:34}  NOT RUN: known to be missed", flush=True)
    return 0 if all([judged(folder, chosen) for folder in folders if folder not in left_out]) else 1


if __name__ == "__main__":
    sys.exit(main())
