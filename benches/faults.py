#!/usr/bin/env python3
"""A day of a daemon's work and mishaps in quick succession. Descriptors, threads and memory must
not grow.

    python3 benches/faults.py target/release/stagepose [--rounds 200] [--check]

The daemon tracks a played clip. Each round saves the ring, starts and stops a recording, sets a
mark, puts bad configs, uploads and deletes a model, and lets strangers break off in every way.
Every tenth round puts a good config, re-reads it by SIGHUP, and lends the camera and takes it back.
The counts are taken after half of the rounds and after the last one: the first configs that are
re-read fragment the heap, and later ones reuse the pieces. `--check` fails if descriptors or
threads grew by more than 2, or memory by more than a tenth plus 16 MB. Nothing leaves the machine.
"""

import argparse
import os
import shutil
import signal
import socket
import struct
import sys
import time

import played


def break_off(port, sent, reset):
    with socket.create_connection(("127.0.0.1", port), timeout=60) as s:
        s.sendall(sent)
        if reset:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def glb():
    text = b'{"asset":{"version":"2.0"}}' + b" "
    return struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A) + text


def counts(daemon):
    process = daemon.process.pid
    return len(os.listdir(f"/proc/{process}/fd")), len(os.listdir(f"/proc/{process}/task")), daemon.memory_mb("VmRSS")


def settled(daemon, rounds):
    """Returns the counts once the daemon is settled: it tracks, the ring is full, and idle threads
    (10 s) have ended."""
    daemon.wait_until_it_tracks()
    time.sleep(12)
    least = [min(of_one) for of_one in zip(*(counts(daemon) for _ in range(10) if not time.sleep(0.2)))]
    print(f"after {rounds} rounds: {least[0]} descriptors, {least[1]} threads, {least[2]} MB", flush=True)
    return least


def one_round(daemon, k):
    post = lambda path, content=b"": daemon.answer("POST", f"/api/v1/{path}", content)
    put = lambda text: daemon.answer("PUT", "/api/v1/config", text.encode(), "If-Match: *\r\n")
    post("ring/save")
    post("recordings/start")
    post("recordings/mark", b'{"text":"cue"}')
    put(daemon.config + '[[output]]\nkind = "json"\nfile = "none/a"\n')
    put("[camera")
    daemon.answer("PUT", "/api/v1/sets/door.glb", glb())
    daemon.answer("DELETE", "/api/v1/sets/door.glb")
    for reset in [False, True]:
        for sent in [b"", b"GET /api/v1/sess", b"POST /api/v1/pair HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n{"]:
            break_off(daemon.port, sent, reset)
        for path in ["recordings", "session", "recordings/none/timeline", "backup"]:
            break_off(daemon.port, f"GET /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(), reset)
    time.sleep(0.2)
    post("recordings/stop")
    if k % 10 == 5:
        put(daemon.config + f"# {k}\n")
        time.sleep(0.3)
        os.kill(daemon.process.pid, signal.SIGHUP)
        time.sleep(0.3)
    if k % 10 == 0:
        post("mode", b'{"mode":"setup"}')
        time.sleep(0.3)
        post("mode", b'{"mode":"track"}')
        time.sleep(0.3)


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("program")
    arguments.add_argument("--rounds", type=int, default=200)
    arguments.add_argument("--check", action="store_true")
    arguments = arguments.parse_args()
    with played.daemon(arguments.program, recorder="ring_s = 2\n") as daemon:
        for k in range(arguments.rounds):
            if k == arguments.rounds // 2:
                start = settled(daemon, k)
            try:
                one_round(daemon, k)
            except OSError as error:
                sys.exit(f"round {k}: {error}\n{daemon.last_words()}")
            daemon.need_alive()
            # Otherwise, recordings would fill the disk.
            for clip in sorted((daemon.folder / "recordings").glob("clip-*"))[:-2]:
                shutil.rmtree(clip, ignore_errors=True)
        end = settled(daemon, arguments.rounds)
    grown = end[0] > start[0] + 2 or end[1] > start[1] + 2 or end[2] > start[2] * 1.1 + 16
    if arguments.check and grown:
        sys.exit("something stays")


if __name__ == "__main__":
    main()
