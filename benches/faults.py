#!/usr/bin/env python3
"""A day of a daemon's work and mishaps in quick time: descriptors, threads and memory must be at the end what they were at the start.

    python3 benches/faults.py target/release/stagepose [--rounds 200] [--check]

A played clip is tracked. In each round the ring is saved, a recording begins and ends, a mark is set, bad configs are put, a model is sent and
deleted, and strangers break off in every way; in each tenth a good config is put, SIGHUP reads it again, and the camera is lent and comes back.
The counts are taken after a tenth of the rounds and after the last one. `--check` fails where descriptors or threads grew by more than 2, or
memory by more than a tenth and 16 MB. Nothing leaves the machine.
"""

import argparse
import os
import pathlib
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from siege import FIXTURE, free_port  # noqa: E402


def ask(port, method, path, content=b"", headers=""):
    with socket.create_connection(("127.0.0.1", port), timeout=60) as s:
        head = f"{method} {path} HTTP/1.0\r\nHost: localhost\r\nContent-Length: {len(content)}\r\n{headers}\r\n"
        s.sendall(head.encode() + content)
        answer = b""
        while piece := s.recv(65536):
            answer += piece
    return int(answer.split(b" ")[1]) if answer else 0


def break_off(port, sent, reset):
    with socket.create_connection(("127.0.0.1", port), timeout=60) as s:
        s.sendall(sent)
        if reset:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def glb():
    text = b'{"asset":{"version":"2.0"}}' + b" "
    return struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A) + text


def counts(process):
    fds = len(os.listdir(f"/proc/{process}/fd"))
    status = dict(line.split(":", 1) for line in pathlib.Path(f"/proc/{process}/status").read_text().splitlines())
    return fds, int(status["Threads"]), int(status["VmRSS"].split()[0]) // 1024


def settled(process, port):
    """The counts once nothing is under way."""
    time.sleep(8)
    ask(port, "GET", "/healthz")
    return min(counts(process) for _ in range(10) if not time.sleep(0.3))


def one_round(process, port, config, k):
    post = lambda path, content=b"": ask(port, "POST", f"/api/v1/{path}", content)
    post("ring/save")
    post("recordings/start")
    post("recordings/mark", b'{"text":"cue"}')
    put = lambda text: ask(port, "PUT", "/api/v1/config", text.encode(), "If-Match: *\r\n")
    put(config + '[[output]]\nkind = "json"\nfile = "none/a"\n')
    put("[camera")
    ask(port, "PUT", "/api/v1/sets/door.glb", glb())
    ask(port, "DELETE", "/api/v1/sets/door.glb")
    for reset in [False, True]:
        for sent in [b"", b"GET /api/v1/sess", b"POST /api/v1/pair HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n{"]:
            break_off(port, sent, reset)
        for path in ["recordings", "session", "recordings/none/timeline", "backup"]:
            break_off(port, f"GET /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(), reset)
    time.sleep(0.2)
    post("recordings/stop")
    if k % 10 == 5:
        put(config + f"# {k}\n")
        time.sleep(0.3)
        os.kill(process, signal.SIGHUP)
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
    with tempfile.TemporaryDirectory() as name:
        folder, port = pathlib.Path(name), free_port()
        for file in ["backdrop.png", "flat.png", "camera.toml"]:
            shutil.copy(FIXTURE / file, folder / file)
        config = (FIXTURE / "stage.toml").read_text()
        config += f'\n[http]\nlisten = "127.0.0.1:{port}"\n[recorder]\nfolder = "recordings"\nring_s = 2\n'
        (folder / "stage.toml").write_text(config)
        frames = sorted((FIXTURE / "frames").iterdir())
        (folder / "long.mjpeg").write_bytes(b"".join(f.read_bytes() for f in frames + frames[-2:0:-1]) * 400)
        command = [pathlib.Path(arguments.program).resolve(), "run", "--config", "stage.toml", "--play", "long.mjpeg"]
        environment = {"STATE_DIRECTORY": name, "CACHE_DIRECTORY": "/dev/null", "PATH": "/usr/bin:/bin"}
        log = open(folder / "log", "wb")
        daemon = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=log)
        try:
            begun = time.monotonic()
            while time.monotonic() - begun < 60:
                try:
                    if ask(port, "GET", "/healthz") == 200:
                        break
                except OSError:
                    pass
                time.sleep(0.2)
            early = max(1, arguments.rounds // 10)
            start = None
            for k in range(arguments.rounds):
                if k == early:
                    start = settled(daemon.pid, port)
                    print(f"after {k} rounds: {start[0]} descriptors, {start[1]} threads, {start[2]} MB", flush=True)
                try:
                    one_round(daemon.pid, port, config, k)
                except OSError as error:
                    sys.exit(f"round {k}: {error}\n{(folder / 'log').read_text()[-2000:]}")
                # Recordings would fill the disk.
                for clip in sorted((folder / "recordings").glob("clip-*"))[:-2]:
                    shutil.rmtree(clip, ignore_errors=True)
                if daemon.poll() is not None:
                    sys.exit(f"the daemon ended in round {k}: {(folder / 'log').read_text()[-2000:]}")
            end = settled(daemon.pid, port)
            print(f"after {arguments.rounds} rounds: {end[0]} descriptors, {end[1]} threads, {end[2]} MB")
        finally:
            daemon.terminate()
            daemon.wait(30)
    grown = end[0] > start[0] + 2 or end[1] > start[1] + 2 or end[2] > start[2] * 1.1 + 16
    if arguments.check and grown:
        sys.exit("something stays")


if __name__ == "__main__":
    main()
