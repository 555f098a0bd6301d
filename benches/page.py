"""What viewers of the page cost: `run` on a played MJPG clip of 1280 x 720, with WebSocket readers
in place of browsers.

    python benches/page.py STAGEPOSE [--seconds 10] [--rounds 4] [--clip FOLDER] [--check]

A short take is rendered (or taken from FOLDER) and played to and fro. Rounds without and with one
viewer take turns, so that other load on the machine affects both; then come eight viewers, one of
which never reads. Each frame's compute time comes from a JSON output, the processor time of the
threads that serve viewers from /proc, and a picture's age from its record's timestamp, which uses
the same clock. `--check` fails if tracking's p99 is over 1.05 times that without a viewer, a viewer
of the camera's own JPEGs takes more than 3 % of a core, a frame is copied without a viewer, memory
grows by more than 8 MB with a stalled viewer, or another viewer gets fewer than 95 % of the frames.
"""

import argparse
import base64
import json
import os
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

# `n`, masked with zeros, requests the next frame.
NEXT = bytes([0x81, 0x81, 0, 0, 0, 0]) + b"n"
SERVE = ("http", "view", "encode")


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as port:
        port.bind(("127.0.0.1", 0))
        return port.getsockname()[1]


class Viewer(threading.Thread):
    """A viewer that requests frames and reads them, or only requests them."""

    def __init__(self, port, reads=True):
        super().__init__(daemon=True)
        self.socket = socket.create_connection(("127.0.0.1", port))
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET /ws/view HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Key: {key}\r\n\r\n".encode()
        )
        self.content = bytearray(1 << 20)
        answer = b""
        while not answer.endswith(b"\r\n\r\n"):
            answer += self.socket.recv(1)
        assert b" 101 " in answer.split(b"\r\n")[0], "the server takes no viewer"
        self.reads, self.ages_ms, self.bytes, self.ended = reads, [], 0, False
        self.start()

    def run(self):
        try:
            self.socket.sendall(NEXT + NEXT)
            while self.reads and not self.ended:
                self.take()
        except (OSError, struct.error):
            pass

    def read(self, length):
        """Reads `length` bytes into one reused buffer, so that eight readers in one process cost
        little and do not distort the measurement."""
        if length > len(self.content):
            self.content = bytearray(length)
        view, done = memoryview(self.content), 0
        while done < length:
            came = self.socket.recv_into(view[done:length])
            if came == 0:
                raise OSError("the server has gone")
            done += came
        return view[:length]

    def take(self):
        first, length = struct.unpack("!BB", self.read(2))
        if length == 126:
            (length,) = struct.unpack("!H", self.read(2))
        elif length == 127:
            (length,) = struct.unpack("!Q", self.read(8))
        content = self.read(length)
        if first != 0x82:
            return
        now = time.monotonic_ns()
        self.socket.sendall(NEXT)
        (head,) = struct.unpack("<I", content[:4])
        stamp = bytes(content[4 : 4 + head]).rsplit(b'"timestamp_ns":', 1)[1].split(b",", 1)[0]
        self.ages_ms.append((now - int(stamp)) / 1e6)
        self.bytes += length

    def end(self):
        self.ended = True
        self.socket.shutdown(socket.SHUT_RDWR)


class Daemon:
    """The running program, and the times it reports for each frame."""

    def __init__(self, program, take, folder, seconds):
        self.http, udp = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
        pictures = sorted(Path(take, "frames").glob("*.jpg"))
        assert pictures, f"{take} has no JPEGs"
        clip = folder / "clip.mjpeg"
        once = [picture.read_bytes() for picture in pictures]
        with clip.open("wb") as file:
            # To and fro, at the default 30 frames a second of a clip without timestamps.
            for _ in range(1 + int(30 * seconds) // (2 * len(once) - 2)):
                file.write(b"".join(once + once[-2:0:-1]))
        text = Path(take, "stage.toml").read_text()
        config = Path(take, "page-bench.toml")
        config.write_text(f'{text}\n[http]\nlisten = "127.0.0.1:{self.http}"\n[[output]]\nkind = "json"\nto = ["127.0.0.1:{udp}"]\n')
        self.lines, self.receiver = [], socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.receiver.bind(("127.0.0.1", udp))
        self.process = subprocess.Popen([program, "run", "--config", config, "--play", clip], stderr=subprocess.DEVNULL)
        threading.Thread(target=self.listen, daemon=True).start()
        while len(self.lines) < 60:
            assert self.process.poll() is None, "it ended"
            time.sleep(0.1)

    def listen(self):
        while True:
            line = json.loads(self.receiver.recv(65536))
            if "times_ms" in line:
                self.lines.append(sum(ms for stage, ms in line["times_ms"].items() if stage in ("acquire", "align", "pose")))

    def served_s(self):
        """Returns the processor time so far of the threads that serve viewers, seconds."""
        ticks = 0
        for task in Path(f"/proc/{self.process.pid}/task").iterdir():
            if (task / "comm").read_text().strip() in SERVE:
                fields = (task / "stat").read_text().rsplit(")", 1)[1].split()
                ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def memory_mb(self):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024

    def copies(self):
        text = urllib.request.urlopen(f"http://127.0.0.1:{self.http}/metrics").read().decode()
        found = [line.split()[1] for line in text.splitlines() if line.startswith("stagepose_frames_viewed_total ")]
        return int(found[0]) if found else None

    def during(self, seconds):
        """Returns the compute times of the frames in this period, and the serving threads'
        processor time as a fraction of a core."""
        begun, first, served = time.monotonic(), len(self.lines), self.served_s()
        time.sleep(seconds)
        return self.lines[first:], (self.served_s() - served) / (time.monotonic() - begun)


def p99(values):
    return sorted(values)[int(0.99 * (len(values) - 1))]


def in_turns(daemon, seconds, rounds, failures):
    """Measures without and with one viewer, in turns."""
    (alone, alone_share), (watched, watched_share), ages, copied = ([], []), ([], []), [], 0
    for _ in range(rounds):
        before = daemon.copies()
        times, share = daemon.during(seconds)
        alone += times
        alone_share.append(share)
        copied += (daemon.copies() or 0) - (before or 0)
        viewer = Viewer(daemon.http)
        times, share = daemon.during(seconds)
        watched += times
        watched_share.append(share)
        ages += viewer.ages_ms
        frames, size = len(viewer.ages_ms), viewer.bytes / max(len(viewer.ages_ms), 1)
        viewer.end()
        time.sleep(0.5)
    ratio = p99(watched) / p99(alone)
    share = statistics.median(watched_share) - statistics.median(alone_share)
    print(f"load {os.getloadavg()[0]:.1f}; tracking, compute a frame: p50 {statistics.median(alone):.2f} ms, p99 {p99(alone):.2f} ms without a viewer ({len(alone)} frames); "
          f"p50 {statistics.median(watched):.2f} ms, p99 {p99(watched):.2f} ms with one ({len(watched)}): p99 x {ratio:.3f}")
    print(f"a viewer takes {100 * share:.2f} % of a core ({frames / seconds:.1f} frames/s of {size / 1e3:.0f} kB in the last round)")
    print(f"a picture's age when it has come: median {statistics.median(ages):.0f} ms, p99 {p99(ages):.0f} ms; copied without a viewer: {copied}")
    failures += [f"p99 x {ratio:.3f}"] * (ratio > 1.05) + [f"{100 * share:.1f} % of a core"] * (share > 0.03)
    failures += [f"{copied} frames were copied for nobody"] * (copied != 0)


def with_one_stalled(daemon, seconds, failures):
    """Measures eight viewers, one of which requests and never reads."""
    others = [Viewer(daemon.http) for _ in range(7)]
    daemon.during(2)
    before, first = daemon.memory_mb(), [len(viewer.ages_ms) for viewer in others]
    stalled = Viewer(daemon.http, reads=False)
    times, share = daemon.during(3 * seconds)
    got = [len(viewer.ages_ms) - n for viewer, n in zip(others, first)]
    grown = daemon.memory_mb() - before
    ages = [age for viewer, n in zip(others, first) for age in viewer.ages_ms[n:]]
    print(f"load {os.getloadavg()[0]:.1f}; eight viewers, one stalled, {3 * seconds} s: memory {before:.0f} MB and {grown:+.1f} MB; of {len(times)} frames the others got {min(got)} to {max(got)}; "
          f"age median {statistics.median(ages):.0f} ms, p99 {p99(ages):.0f} ms; {100 * share:.1f} % of a core")
    failures += [f"memory grew by {grown:.1f} MB"] * (grown > 8) + [f"a viewer got {min(got)} of {len(times)}"] * (min(got) < 0.95 * len(times))
    for viewer in [stalled, *others]:
        viewer.end()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--clip")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        take = options.clip or f"{folder}/take"
        if not Path(take).exists():
            size = ["--frames", "60", "--width", "1280", "--height", "720", "--jpeg", "85"]
            subprocess.run([options.program, "demo", *size, "--save", take], check=True, stdout=subprocess.DEVNULL)
        # The measured time, plus a margin for the start.
        daemon = Daemon(options.program, take, Path(folder), options.seconds * (2 * options.rounds + 3) + options.rounds + 60)
        try:
            in_turns(daemon, options.seconds, options.rounds, failures)
            with_one_stalled(daemon, options.seconds, failures)
        finally:
            daemon.process.terminate()
            daemon.process.wait()
    for failure in failures:
        print(f"FAILED: {failure}")
    sys.exit(1 if options.check and failures else 0)


main()
