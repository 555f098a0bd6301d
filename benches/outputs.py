"""Whether outputs slow tracking down: replays one clip with and without `--outputs`, in turns.

    python benches/outputs.py STAGEPOSE CLIP CONFIG [--pairs 7] [--rate 240] [--check]

Both replays of a pair run at the clip's own pace, right after one another, in alternating order, so
that other load on the machine affects both. With outputs, eight of them send at the clip's rate to
ports of this machine. Prints the medians of the tracker's compute time per frame, and the median
and spread of the pairs' ratios. `--check` fails if the median ratio is over 1.10.
"""

import argparse
import json
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

KINDS = [
    'kind = "freed"', 'kind = "opentrackio"', 'kind = "opentrackio"\nencoding = "cbor"', 'kind = "psn"', 'kind = "osc"',
    'kind = "osc"\nmessages = ["pose"]', 'kind = "json"', 'kind = "freed"\nspare = "frame"',
]


def drain(port):
    """Reads what arrives, as a receiver would."""
    port.settimeout(0.5)
    while True:
        try:
            port.recv(65536)
        except TimeoutError:
            continue
        except OSError:
            return


def with_outputs(config, folder):
    """Writes the config without and with eight outputs to ports of this machine; returns both files
    and the ports."""
    text, ports = config.read_text(), []
    text = re.sub(r'^((?:calibration|image|photo|photo_calibration|mask) = ")(?!/)', rf"\1{config.parent.resolve()}/", text, flags=re.M)
    plain = folder / "plain.toml"
    plain.write_text(text)
    for kind in KINDS:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port.bind(("127.0.0.1", 0))
        ports.append(port)
        text += f'\n[[output]]\n{kind}\nto = ["127.0.0.1:{port.getsockname()[1]}"]\n'
    loaded = folder / "outputs.toml"
    loaded.write_text(text)
    return plain, loaded, ports


def faster(clip, folder, rate):
    """Returns the clip with timestamps at another rate; pictures are linked."""
    if rate is None:
        return clip
    made = folder / "clip"
    made.mkdir()
    (made / "frames").symlink_to((clip / "frames").resolve())
    head, *rows = (clip / "timestamps.csv").read_text().splitlines()
    stamps = [f"{round(k * 1e9 / rate)},{row.split(',', 1)[1]}" for k, row in enumerate(rows)]
    (made / "timestamps.csv").write_text("\n".join([head, *stamps]) + "\n")
    return made


def replay(program, clip, config, folder, more):
    """Returns the median compute time of the tracker per frame, milliseconds."""
    summary = folder / "summary.json"
    command = [program, "replay", clip, "--config", config, "--realtime", "--summary", summary, *more]
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
    return json.loads(summary.read_text())["stage_ms"]["total"]["p50"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=Path)
    parser.add_argument("clip", type=Path)
    parser.add_argument("config", type=Path)
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--rate", type=float, help="play the clip at so many frames a second")
    parser.add_argument("--check", action="store_true")
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        plain, loaded, ports = with_outputs(a.config, folder)
        clip = faster(a.clip, folder, a.rate)
        for port in ports:
            threading.Thread(target=drain, args=(port,), daemon=True).start()
        runs = {"without": lambda: replay(a.program, clip, plain, folder, []), "with": lambda: replay(a.program, clip, loaded, folder, ["--outputs"])}
        times = {"without": [], "with": []}
        for pair in range(a.pairs):
            for name in ("without", "with") if pair % 2 == 0 else ("with", "without"):
                times[name].append(runs[name]())
    ratios = sorted(w / o for w, o in zip(times["with"], times["without"], strict=True))
    ratio = statistics.median(ratios)
    print(f"tracking a frame, median of {a.pairs} replays: {statistics.median(times['without']):.2f} ms without outputs, "
          f"{statistics.median(times['with']):.2f} ms with eight")
    print(f"ratio within pairs: median {ratio:.3f}, from {ratios[0]:.3f} to {ratios[-1]:.3f}")
    if a.check and ratio > 1.10:
        sys.exit("outputs slow tracking down by more than 10 %")


if __name__ == "__main__":
    main()
