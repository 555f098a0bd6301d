"""A local daemon that tracks a played clip, for siege.py and faults.py. Standard library only."""

import contextlib
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time

FIXTURE = pathlib.Path(__file__).resolve().parent.parent / "fixtures/dolly"
START_S = 60  # a daemon that tracks nothing for this long has failed


class Daemon:
    """A running daemon: its `port`, its `folder` with stage.toml and recordings, its `config` and
    its `process`."""

    def __init__(self, program, folder, recorder):
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        for name in ["backdrop.png", "flat.png", "camera.toml"]:
            shutil.copy(FIXTURE / name, folder / name)
        self.config = (FIXTURE / "stage.toml").read_text()
        self.config += f'\n[http]\nlisten = "127.0.0.1:{self.port}"\n[recorder]\nfolder = "recordings"\n{recorder}'
        (folder / "stage.toml").write_text(self.config)
        frames = sorted((FIXTURE / "frames").iterdir())
        there_and_back = frames + frames[-2:0:-1]
        (folder / "long.mjpeg").write_bytes(b"".join(f.read_bytes() for f in there_and_back) * 400)
        command = [pathlib.Path(program).resolve(), "run", "--config", "stage.toml", "--play", "long.mjpeg"]
        environment = {"STATE_DIRECTORY": str(folder), "CACHE_DIRECTORY": "/dev/null", "PATH": "/usr/bin:/bin"}
        # As in packaging/stagepose.service.
        environment["MALLOC_ARENA_MAX"] = "2"
        with open(folder / "log", "wb") as log:
            self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=log)

    def wait_until_it_tracks(self):
        """Waits until 30 more frames, about a second's worth, have been tracked."""
        begun, first = time.monotonic(), None
        while True:
            self.need_alive()
            with contextlib.suppress(OSError):
                now = self.frames()
                first = now if first is None else first
                if now >= first + 30:
                    return
            if time.monotonic() - begun > START_S:
                sys.exit(f"nothing is tracked within {START_S} s:\n{self.last_words()}")
            time.sleep(0.2)

    def frames(self):
        """Returns the number of frames processed so far."""
        text = self.answer("GET", "/metrics").decode()
        return float(re.search(r"^stagepose_frames_total (\S+)$", text, re.M).group(1))

    def need_alive(self):
        if self.process.poll() is not None:
            sys.exit(f"the daemon ended with {self.process.returncode}:\n{self.last_words()}")

    def last_words(self):
        return (self.folder / "log").read_text(errors="replace")[-2000:]

    def answer(self, method, path, content=b"", headers="", wait_s=60):
        """Returns the whole answer to a request, including its head."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=wait_s) as s:
            head = f"{method} {path} HTTP/1.0\r\nHost: localhost\r\nContent-Length: {len(content)}\r\n{headers}\r\n"
            s.sendall(head.encode() + content)
            pieces = []
            while piece := s.recv(65536):
                pieces.append(piece)
        return b"".join(pieces)

    def memory_mb(self, which):
        """Returns memory in MB: VmRSS is the current size, VmHWM the peak."""
        lines = pathlib.Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return int(dict(line.split(":", 1) for line in lines)[which].split()[0]) // 1024


@contextlib.contextmanager
def daemon(program, recorder="", prepare=lambda folder: None):
    """Runs a daemon that tracks, and ends it afterwards. `recorder` adds lines to that section;
    `prepare` adds content to its folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        prepare(folder)
        running = Daemon(program, folder, recorder)
        try:
            running.wait_until_it_tracks()
            yield running
        finally:
            running.process.terminate()
            running.process.wait(30)
