#!/usr/bin/env python3
"""What strangers can do to a tracking daemon: slow clients of each kind, and the response times.

    python3 benches/siege.py target/release/stagepose [--strangers 64] [--seconds 20] [--check]

The daemon tracks a played clip. Turns without strangers and with strangers of one kind alternate.
Each turn prints the median, the 99th percentile and the maximum time of `/healthz`,
`/api/v1/health` and `/api/v1/session`, and the tracked frames per second. The strangers come from
eight addresses of this machine (127.0.0.2 to 127.0.0.9) as if through a proxy, so that none of them
is paired; nothing leaves the machine. `--check` fails if a 99th percentile is above 100 ms (health)
or 300 ms (session) in three consecutive turns, unless the last turn without strangers is too slow
as well.
"""

import argparse
import asyncio
import math
import sys
import threading
import time

import played

PROBES = {"/healthz": 100, "/api/v1/health": 100, "/api/v1/session": 300}
HEAD = "Host: localhost\r\nX-Forwarded-For: 192.0.2.7\r\n"
# Timeout of an answer, seconds.
WAITS = 20
# Maximum turns of a kind that is too slow, because other load scatters single turns.
TRIES = 3
UPGRADE = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"


def long_recording(folder):
    """Writes a recording of two hours, for timelines."""
    clip = folder / "recordings/clip-1"
    (clip / "frames").mkdir(parents=True)
    covariance = ",".join(["1.234567890123e-7"] * 36)
    line = '{"sequence":%d,"timestamp_ns":%d,"state":"tracking","pose":null,"covariance":[' + covariance + '],"rms_px":0.5,"objects":[]}\n'
    with open(clip / "poses.jsonl", "w") as poses, open(clip / "timestamps.csv", "w") as stamps:
        stamps.write("#timestamp [ns],filename\n")
        for k in range(200_000):
            poses.write(line % (k, k * 33_333_333))
            stamps.write(f"{k * 33_333_333},{k}.jpg\n")


async def drip(peer, port, head, byte, pause):
    """Sends a head, then a byte now and then; reconnects when dropped."""
    while True:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(peer, 0))
            writer.write(head.encode())
            while not reader.at_eof():
                await asyncio.sleep(pause)
                writer.write(byte)
                await writer.drain()
            writer.close()
        except OSError:
            await asyncio.sleep(0.2)


async def ask(peer, port, head, reads):
    """Sends requests endlessly; without `reads`, it leaves the answer unread."""
    while True:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(peer, 0))
            writer.write(head.encode())
            if reads:
                await reader.read(-1)
            else:
                await asyncio.sleep(10)
            writer.close()
        except OSError:
            await asyncio.sleep(0.2)


def stranger(kind, peer, port):
    content = HEAD + "Content-Length: 4000\r\nX-Stagepose: 1\r\n\r\n"
    kinds = {
        "pairing, a byte each 3 s": lambda: drip(peer, port, "POST /api/v1/pair HTTP/1.1\r\n" + content, b" ", 3),
        "head, a byte a second": lambda: drip(peer, port, "GET /api/v1/session HTTP/1.1\r\nHost: local", b"h", 1),
        "timelines": lambda: ask(peer, port, "GET /api/v1/recordings/clip-1/timeline HTTP/1.0\r\n" + HEAD + "\r\n", True),
        "records that nobody reads": lambda: ask(peer, port, f"GET /api/v1/recordings/clip-1/poses?count=5000 HTTP/1.1\r\n{HEAD}\r\n", False),
        "WebSockets that nobody reads": lambda: ask(peer, port, f"GET /ws HTTP/1.1\r\n{HEAD}{UPGRADE}\r\n", False),
        "sessions, on and on": lambda: ask(peer, port, "GET /api/v1/session HTTP/1.0\r\n" + HEAD + "\r\n", True),
    }
    return kinds if kind is None else kinds[kind]()


class Siege:
    """Strangers of one kind, on their own thread."""

    def __init__(self, kind, count, port):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        start = lambda k: asyncio.run_coroutine_threadsafe(stranger(kind, f"127.0.0.{2 + k % 8}", port), self.loop)
        self.running = [start(k) for k in range(count)]

    def end(self):
        for one in self.running:
            one.cancel()
        time.sleep(0.5)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()


def measure(daemon, seconds):
    """Returns the times of each probe in ms, and the frames per second."""
    times = {path: [] for path in PROBES}
    begun, before = time.monotonic(), daemon.frames()
    while time.monotonic() - begun < seconds:
        for path, of_path in times.items():
            asked, answer = time.monotonic(), b""
            try:
                answer = daemon.answer("GET", path, wait_s=WAITS)
            except OSError:
                answer = b""
            # 503 is the health's answer once the clip is over.
            is_answered = answer.startswith((b"HTTP/1.0 200", b"HTTP/1.0 503"))
            of_path.append((time.monotonic() - asked) * 1e3 if is_answered else WAITS * 1e3)
        time.sleep(0.02)
    return times, (daemon.frames() - before) / (time.monotonic() - begun)


def percentile(values, share):
    return sorted(values)[max(0, math.ceil(share * len(values)) - 1)]


def turn(daemon, kind, arguments):
    """Runs one turn with strangers of a kind, or with none; prints the results and returns what is
    too slow."""
    strangers = Siege(kind, arguments.strangers, daemon.port) if kind else None
    time.sleep(1)
    times, rate = measure(daemon, arguments.seconds)
    if strangers:
        strangers.end()
    print(f"{kind or 'nobody':<30} {rate:5.1f} frames/s", end="")
    slow = []
    for path, values in times.items():
        p99 = percentile(values, 0.99)
        print(f"   {path} {percentile(values, 0.5):.1f} / {p99:.1f} / {max(values):.0f} ms", end="")
        if p99 > PROBES[path]:
            slow.append(f"{path} {p99:.0f} ms")
    print(flush=True)
    return ", ".join(slow)


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("program")
    arguments.add_argument("--strangers", type=int, default=64)
    arguments.add_argument("--seconds", type=float, default=20)
    arguments.add_argument("--check", action="store_true")
    arguments = arguments.parse_args()
    bad = []
    with played.daemon(arguments.program, prepare=long_recording) as daemon:
        for kind in stranger(None, "", 0):
            for _ in range(TRIES):
                alone, besieged = turn(daemon, None, arguments), turn(daemon, kind, arguments)
                if not besieged:
                    break
            if besieged and not alone:
                bad.append(f"{kind}: {besieged}")
            elif besieged:
                print(f"NOT JUDGED: {kind}; this machine is too busy with nobody there", flush=True)
        print(f"most memory: {daemon.memory_mb('VmHWM')} MB")
    if arguments.check and bad:
        sys.exit("too slow: " + "; ".join(bad))


if __name__ == "__main__":
    main()
