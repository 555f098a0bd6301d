"""Replays a clip with every output on and decodes what arrives with third-party libraries.

Each decoded pose must equal the JSON pose of the same frame within the protocol's quantisation.
Traffic goes to 127.0.0.1 only.

    python receive.py STAGEPOSE FIXTURE OUT [--schema schema.json] [--node NODE_MODULES_PARENT]
"""

import argparse
import asyncio
import json
import math
import re
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import cbor2
import jsonschema
import pypsn
import websockets
from pythonosc.osc_bundle import OscBundle

HALF_DEGREE_UNIT, HALF_MM_UNIT = 1 / 65536 + 1e-9, 1 / 128 + 1e-9


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Udp:
    """A port that collects everything that arrives on it."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.2)
        self.port, self.packets, self.running = self.socket.getsockname()[1], [], True
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        while self.running:
            try:
                self.packets.append(self.socket.recv(65536))
            except TimeoutError:
                pass

    def close(self):
        time.sleep(0.3)
        self.running = False
        self.thread.join()
        return self.packets


def matrix(q):
    x, y, z, w = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def body(pose):
    """Returns the camera body's rotation matrix (x right, y forward, z up) from a record's optical
    pose."""
    return times(matrix(pose["orientation_xyzw"]), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def angles(pose):
    """Returns pan (+ left), tilt and roll in degrees."""
    r = body(pose)
    return [math.degrees(v) for v in (math.atan2(-r[0][1], r[1][1]), math.asin(r[2][1]), math.atan2(-r[2][0], r[2][2]))]


def rotation_vector(r):
    angle = math.acos(max(-1, min(1, (r[0][0] + r[1][1] + r[2][2] - 1) / 2)))
    axis = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    scale = angle / (2 * math.sin(angle)) if angle > 1e-9 else 0.5
    return [scale * v for v in axis]


def near(found, wanted, within, what):
    worst = max(abs(f - w) for f, w in zip(found, wanted, strict=True))
    assert worst <= within, f"{what}: {found} is not {wanted} (off by {worst}, at most {within})"
    return worst


def single(values):
    """Returns how much a number may change when it becomes a 32-bit float."""
    return max(abs(v) for v in values) * 2**-23 + 1e-7


class Report:
    def __init__(self):
        self.failed = False

    def check(self, name, run):
        try:
            print(f"{name:34} {run()}", flush=True)
        except Exception as error:  # noqa: BLE001 - every decoder has its own
            self.failed = True
            print(f"{name:34} FAILED: {type(error).__name__}: {error}", flush=True)


def freed(packets, rows):
    worst = [0.0, 0.0]
    assert len(packets) == len(rows), f"{len(packets)} packets for {len(rows)} poses"
    for packet in packets:
        assert len(packet) == 29 and packet[0] == 0xD1 and (0x40 - sum(packet[:28])) % 256 == packet[28]
        i24 = [int.from_bytes(packet[i : i + 3], "big", signed=True) for i in range(2, 20, 3)]
        row = rows[struct.unpack(">H", packet[26:28])[0]]
        pan, tilt, roll = angles(row["pose"])
        worst[0] = max(worst[0], near([v / 32768 for v in i24[:3]], [-pan, tilt, roll], HALF_DEGREE_UNIT, "angles"))
        position = [1000 * v for v in row["pose"]["position_m"]]
        worst[1] = max(worst[1], near([v / 64 for v in i24[3:]], position, HALF_MM_UNIT, "position"))
    return f"{len(packets)} packets, worst {worst[0]:.2e} deg, {worst[1]:.2e} mm"


def opentrackio(packets, rows, schema):
    poses, fixed, size = 0, 0, 0
    for number, packet in enumerate(packets):
        # Numbers do not start at 0, which the reference receiver drops.
        assert packet[:4] == b"OTrk" and int.from_bytes(packet[6:8], "big") == number + 1
        encoding, length = packet[5], int.from_bytes(packet[12:14], "big")
        assert length & 0x8000 and length & 0x7FFF == len(packet) - 16
        one = two = 0
        for b in packet[:14] + packet[16:]:
            one = (one + b) % 256
            two = (two + one) % 256
        assert bytes([two, one]) == packet[14:16], "checksum"
        sample = json.loads(packet[16:]) if encoding == 1 else cbor2.loads(packet[16:])
        if schema:
            jsonschema.validate(sample, schema)
        size, fixed = max(size, len(packet)), fixed + ("static" in sample)
        if "transforms" not in sample:
            continue
        poses += 1
        row, transform = rows[sample["timing"]["sequenceNumber"]], sample["transforms"][-1]
        near([transform["translation"][k] for k in "xyz"], row["pose"]["position_m"], 1e-12, "translation")
        near([transform["rotation"][k] for k in ("pan", "tilt", "roll")], angles(row["pose"]), 1e-9, "rotation")
        assert sample["tracker"]["status"] in ("Optical Good", "Optical Unreliable") and "Camera" in transform["id"]
        recorded = sample["timing"]["recordedTimestamp"]
        assert recorded["seconds"] * 10**9 + recorded["nanoseconds"] == row["timestamp_ns"]
    assert poses == len(rows) and fixed >= 1, f"{poses} poses for {len(rows)}, {fixed} static"
    return f"{poses} poses, {len(packets) - poses} without, at most {size} bytes, {'schema holds' if schema else 'no schema'}"


def psn_pose(pose):
    (x, y, z), (a, b, c) = pose["position_m"], rotation_vector(body(pose))
    return [x, z, y], [-a, -c, -b]


def psn(packets, rows):
    rows, found, names = list(rows.values()), 0, set()
    for packet in packets:
        parsed = pypsn.parse_psn_packet(packet)
        if isinstance(parsed, pypsn.psn_info_packet):
            name = parsed.name.decode() if isinstance(parsed.name, bytes) else parsed.name
            names |= {(name, t.tracker_id) for t in parsed.trackers}
            continue
        for tracker in parsed.trackers:
            if tracker.status == 0:
                continue
            position, turn = psn_pose(rows[found]["pose"])
            near([tracker.pos.x, tracker.pos.y, tracker.pos.z], position, single(position), "position")
            near([tracker.ori.x, tracker.ori.y, tracker.ori.z], turn, 1e-6, "orientation")
            found += 1
    assert found == len(rows), f"{found} poses for {len(rows)}"
    assert names == {("stagepose", 1)}, names
    return f"{found} poses, names {sorted(names)}"


def osc_messages(frame_of, messages, rows):
    """Checks one bundle of (address, arguments) pairs; returns 1 if it has a pose, otherwise 0."""
    by_address = dict(messages)
    state, confidence, frame = by_address["/stagepose/camera/status"]
    if "/stagepose/camera/pose" not in by_address:
        assert confidence == 0, (state, confidence)
        return 0
    row = rows[frame]
    wanted = [*row["pose"]["position_m"], *angles(row["pose"])]
    near(by_address["/stagepose/camera/pose"], wanted, single(wanted), "pose")
    near(by_address["/axis/camera/x"], [1000 * wanted[0]], single([1000 * wanted[0]]), "value")
    return 1


def osc(packets, rows):
    poses = 0
    for packet in packets:
        bundle = OscBundle(packet)
        assert bundle.timestamp > 1.6e9, "time tag"
        poses += osc_messages(None, [(m.address, list(m.params)) for m in bundle], rows)
    assert poses == len(rows), f"{poses} poses for {len(rows)}"
    return f"{poses} poses in {len(packets)} bundles"


def node(lines, rows):
    errors = [line["error"] for line in lines if "error" in line]
    assert not errors, errors[0]
    bundles = [line["osc"] for line in lines if "osc" in line]
    poses = sum(osc_messages(None, [(e[0], e[1:]) for e in bundle], rows) for bundle in bundles)
    assert poses == len(rows), f"OSC: {poses} poses for {len(rows)}"
    ordered, found = list(rows.values()), 0
    for line in lines:
        for tracker in line.get("psn", []):
            if tracker.get("pos") is None:
                continue
            position, turn = psn_pose(ordered[found]["pose"])
            vector = lambda v: [v["x"], v["y"], v["z"]] if isinstance(v, dict) else list(v)
            near(vector(tracker["pos"]), position, single(position), "PSN position")
            near(vector(tracker["ori"]), turn, 1e-6, "PSN orientation")
            found += 1
    assert found == len(rows), f"PSN: {found} poses for {len(rows)}"
    return f"{poses} OSC poses, {found} PSN poses"


def otp_layers(data, what):
    """Yields the layers that fill `data`: vector and content."""
    while data:
        vector, length = struct.unpack(">HH", data[:4])
        assert 4 + length <= len(data), f"{what} exceeds what wraps it"
        yield vector, data[4 : 4 + length]
        data = data[4 + length :]


def otp_points(packet):
    """Decodes a transform packet by the layout of ANSI E1.59-2021; returns the modules of each point
    by their number. Written from the standard's tables alone, like no other decoder here."""
    assert len(packet) <= 1472 and packet[:12] == b"OTP-E1.59\0\0\0", packet[:12]
    ((vector, content),) = otp_layers(packet[12:], "the OTP layer")
    # Footer 2, CID 16, folio 4, page 2, last page 2, options 1, reserved 4, name 32.
    page, last_page = struct.unpack(">HH", content[22:26])
    assert vector == 1 and page <= last_page and content[31:63].rstrip(b"\0").decode().startswith("stagepose")
    ((vector, content),) = otp_layers(content[63:], "the transform layer")
    # System 1, timestamp 8, options 1, reserved 4.
    assert vector == 1 and content[0] == 1 and content[9] == 0x80, "system 1, a full point set"
    points = []
    for vector, content in otp_layers(content[14:], "a point layer"):
        priority, group, number, timestamp_us = struct.unpack(">BHIQ", content[:15])
        modules = {"address": (group, number), "priority": priority, "us": timestamp_us}
        for manufacturer, module in otp_layers(content[20:], "a module layer"):
            assert vector == 1 and manufacturer == 0
            modules[struct.unpack(">H", module[:2])[0]] = module[2:]
        points.append(modules)
    return points


def otp_angles(pose):
    """Returns the angles about x, y and z, degrees, of R = Rz Ry Rx."""
    r = body(pose)
    return [math.degrees(v) for v in (math.atan2(r[2][1], r[2][2]), -math.asin(r[2][0]), math.atan2(r[1][0], r[0][0]))]


def otp(packets, lines):
    """Compares positions (module 1) and rotations (module 3) with the JSON lines of the same test;
    a packet's line is the one with the nearest position."""
    poses = [line["pose"] for line in map(json.loads, lines) if line.get("pose")]
    worst, last_us = [0.0, 0.0], 0
    for packet in packets:
        (point,) = otp_points(packet)
        assert point["address"] == (1, 1) and point["priority"] == 100 and point["us"] > last_us, point
        last_us = point["us"]
        assert set(point) >= {1, 2, 3, 4} and point[1][0] == 0, "all that was asked for, in micrometres"
        um, udeg = struct.unpack(">iii", point[1][1:]), struct.unpack(">III", point[3])
        off = lambda pose: max(abs(1e6 * p - v) for p, v in zip(pose["position_m"], um))
        pose = min(poses, key=off)
        assert all(v < 360_000_000 for v in udeg), udeg
        turned = max(abs((1e6 * a - v + 180e6) % 360e6 - 180e6) for a, v in zip(otp_angles(pose), udeg))
        worst = [max(worst[0], off(pose)), max(worst[1], turned)]
    assert len(packets) >= 30 and worst[0] <= 0.501 and worst[1] <= 1.6, f"{len(packets)} packets, {worst[0]} um, {worst[1]} udeg"
    return f"{len(packets)} packets, worst {worst[0]:.2f} um, {worst[1]:.2f} udeg"


def test_of_otp(a):
    """Asks for all modules, as a consumer must, while `send-test` moves a camera; returns the
    packets and the JSON lines. A producer says nothing in its first 12 s, which are for asking."""
    shown, asked, lines = Udp(), free_port(), a.out / "otp.jsonl"
    config = a.out / "otp.toml"
    keys = {"listen": f"127.0.0.1:{asked}", "interface": "127.0.0.1"}
    config.write_text(output("otp", shown.port, **keys) + f'[[output]]\nkind = "json"\nfile = "{lines.resolve()}"\n')
    program = subprocess.Popen([str(a.stagepose), "send-test", "--seconds", "15", "--config", str(config)], stderr=subprocess.DEVNULL)
    # Vector 1 of an advertisement: manufacturer and number of each module.
    modules = b"".join(struct.pack(">HH", 0, number) for number in range(1, 7))
    layer = lambda vector, content: struct.pack(">HH", vector, len(content)) + content
    asking = layer(1, bytes(4) + layer(1, bytes(4) + modules))
    head = bytes(2) + bytes(range(16)) + bytes(4) + bytes(4) + bytes(5) + b"receive.py".ljust(32, b"\0")
    packet = b"OTP-E1.59\0\0\0" + layer(2, head + asking)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as consumer:
        while program.poll() is None:
            consumer.sendto(packet, ("127.0.0.1", asked))
            time.sleep(1)
    assert program.returncode == 0, "send-test"
    return shown.close(), lines.read_text().splitlines()


def json_lines(lines, rows, every_row):
    records = [r for r in map(json.loads, lines) if "event" not in r]
    poses = [r for r in records if r["pose"]]
    for record in poses:
        row = rows[record["sequence"]]
        assert all(record[key] == row[key] for key in row), f"frame {record['sequence']} is another record"
        assert record["age_ms"] >= 0 and record["unix_ns"] > 1.6e18
    assert len(poses) == len(rows), f"{len(poses)} poses for {len(rows)}"
    assert every_row is None or len(records) == every_row, f"{len(records)} lines for {every_row} frames"
    return f"{len(poses)} poses, {len(records) - len(poses)} without"


def web_socket(lines, all_rows):
    wanted = {json.loads(line)["sequence"]: line for line in all_rows}
    assert lines and all(wanted[json.loads(line)["sequence"]] == line for line in lines)
    return f"{len(lines)} records, byte for byte"


def tcp_client(port, lines, stop):
    """Reads lines as soon as the port is open."""
    while not stop.is_set():
        try:
            with socket.create_connection(("127.0.0.1", port), timeout=0.2) as s, s.makefile() as f:
                s.settimeout(20)
                lines.extend(f)
                return
        except OSError:
            time.sleep(0.01)


def ws_client(port, lines, stop):
    async def read():
        while not stop.is_set():
            try:
                async with websockets.connect(f"ws://127.0.0.1:{port}/ws") as ws:
                    async for line in ws:
                        lines.append(line)
                    return
            except websockets.ConnectionClosed:
                return
            except OSError:
                await asyncio.sleep(0.01)

    asyncio.run(read())


def output(kind, *ports, **keys):
    """Returns an [[output]] section that sends to these ports of this machine."""
    to = {"to": [f"127.0.0.1:{port}" for port in ports]}
    return "\n".join(["[[output]]", *(f"{key} = {json.dumps(value)}" for key, value in ({"kind": kind} | to | keys).items())]) + "\n"


def every_protocol(ports):
    """Returns at least one output of every protocol, an OSC value, and the HTTP server."""
    value = {"address": "/axis/{body}/x", "quantity": "x"}
    return "".join([
        output("freed", ports["freed"], spare="frame"),
        output("opentrackio", ports["otrk_json"]),
        output("opentrackio", ports["otrk_cbor"], encoding="cbor", principal_point="both"),
        output("psn", ports["psn"], ports["node_psn"]),
        output("osc", ports["osc"], ports["node_osc"]),
        "[[output.value]]\nfactor = 1000\n" + "".join(f"{key} = {json.dumps(text)}\n" for key, text in value.items()),
        output("json", ports["json"], on_loss="flag", tcp_listen=f"127.0.0.1:{ports['tcp']}", file="sent.jsonl"),
        f"[http]\nlisten = \"127.0.0.1:{ports['http']}\"\n",
    ])


def all_flagging(ports):
    """Returns one output of every kind that can mark a loss, configured to do so."""
    kinds = {name: (name, {}) for name in ("freed", "psn", "osc", "json")}
    kinds |= {f"otrk_{encoding}": ("opentrackio", {"encoding": encoding}) for encoding in ("json", "cbor")}
    outputs = (output(kind, ports[name], on_loss="flag", **keys) for name, (kind, keys) in kinds.items())
    return "[safety]\nstale_after_s = 60\n" + "".join(outputs)


# Marks of a record's state: OpenTrackIO's status, FreeD's quality, the others' confidence.
MARKS = {
    "tracking": ("Optical Good", 1, 1.0),
    "coasting": ("Optical Unreliable", 2, 0.5),
    "lost": ("Optical Lost", 3, 0.0),
    "searching": ("Location Searching", 3, 0.0),
}


def darkened(fixture, out):
    """Writes the fixture as a clip whose light fails for a while: frames 15 to 27 are black."""
    clip = out / "darkened"
    (clip / "frames").mkdir(parents=True, exist_ok=True)
    camera = (fixture / "camera.toml").read_text()
    width, height = (int(re.search(rf"^{key} *= *(\d+)", camera, re.M)[1]) for key in ("width", "height"))
    rows = []
    for number, line in enumerate((fixture / "timestamps.csv").read_text().splitlines()[1:]):
        stamp, name = line.split(",")
        dark = 15 <= number < 28
        data = b"P5 %d %d 255\n" % (width, height) + bytes(width * height) if dark else (fixture / "frames" / name).read_bytes()
        name = f"{number:06}.pgm" if dark else name
        (clip / "frames" / name).write_bytes(data)
        rows.append(f"{stamp},{name}")
    (clip / "timestamps.csv").write_text("#timestamp [ns],filename\n" + "\n".join(rows) + "\n")
    return clip


def marks(packets, states):
    """Checks that with `flag` every row makes a packet, and that the k-th packet has the mark of
    the k-th state."""
    wanted = [MARKS[state] for state in states]
    status = [s["tracker"]["status"] for s in (json.loads(p[16:]) for p in packets["otrk_json"])]
    assert status == [w[0] for w in wanted], f"OpenTrackIO JSON: {status}"
    status = [s["tracker"]["status"] for s in (cbor2.loads(p[16:]) for p in packets["otrk_cbor"])]
    assert status == [w[0] for w in wanted], f"OpenTrackIO CBOR: {status}"
    # FreeD sends nothing before the first pose.
    first = next(n for n, state in enumerate(states) if state == "tracking")
    quality = [p[27] for p in packets["freed"]]
    assert quality == [w[1] for w in wanted[first:]], f"FreeD: {quality}"
    parsed = [pypsn.parse_psn_packet(p) for p in packets["psn"]]
    validity = [p.trackers[0].status for p in parsed if not isinstance(p, pypsn.psn_info_packet)]
    assert validity == [w[2] for w in wanted], f"PSN: {validity}"
    status = [next(list(m.params) for m in OscBundle(p) if m.address.endswith("/status")) for p in packets["osc"]]
    assert [(s[0], s[1]) for s in status] == [(state, MARKS[state][2]) for state in states], f"OSC: {status}"
    lines = [json.loads(p)["state"] for p in packets["json"]]
    assert lines == states, f"JSON: {lines}"
    counts = {state: states.count(state) for state in MARKS}
    assert counts["tracking"] and counts["coasting"] and counts["lost"], counts
    return ", ".join(f"{n} {state}" for state, n in counts.items())


def replay_darkened(a, stage):
    """Replays the darkened clip with every output flagging; returns the packets, and the records'
    states."""
    udp = {name: Udp() for name in ("freed", "otrk_json", "otrk_cbor", "psn", "osc", "json")}
    config = a.out / "marked.toml"
    config.write_text(stage + all_flagging({name: u.port for name, u in udp.items()}))
    poses = a.out / "marked.jsonl"
    command = [a.stagepose, "replay", darkened(a.fixture, a.out), "--config", config, "--outputs", "--poses", poses]
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
    packets = {name: u.close() for name, u in udp.items()}
    return packets, [json.loads(line)["state"] for line in poses.read_text().splitlines()]


def start_node(home, out, ports):
    script = Path(__file__).with_name("receive.mjs")
    process = subprocess.Popen(
        ["node", str(script), str(ports["node_osc"]), str(ports["node_psn"])],
        env={"PATH": __import__("os").environ["PATH"], "RECEIVERS_HOME": str(home)}, stdout=subprocess.PIPE, text=True,
    )
    first = json.loads(process.stdout.readline())
    assert first == {"ready": True}, first
    lines = []
    thread = threading.Thread(target=lambda: lines.extend(map(json.loads, process.stdout)), daemon=True)
    thread.start()
    return process, thread, lines


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("stagepose", "fixture", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--schema", type=Path)
    parser.add_argument("--node", type=Path, help="folder that holds package.json and node_modules")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    udp = {name: Udp() for name in ("freed", "otrk_json", "otrk_cbor", "psn", "osc", "json")}
    ports = {name: u.port for name, u in udp.items()}
    ports |= {name: free_port() for name in ("node_osc", "node_psn")} | {name: free_port(socket.SOCK_STREAM) for name in ("tcp", "http")}
    stage = (a.fixture / "stage.toml").read_text()
    stage = re.sub(r'(calibration|image) = "', rf'\1 = "{a.fixture.resolve()}/', stage)
    (a.out / "stage.toml").write_text(stage + every_protocol(ports))

    stop, tcp_lines, ws_lines = threading.Event(), [], []
    clients = [
        threading.Thread(target=tcp_client, args=(ports["tcp"], tcp_lines, stop), daemon=True),
        threading.Thread(target=ws_client, args=(ports["http"], ws_lines, stop), daemon=True),
    ]
    nodes = start_node(a.node, a.out, ports) if a.node else None
    for client in clients:
        client.start()
    command = [a.stagepose, "replay", a.fixture, "--config", a.out / "stage.toml", "--outputs", "--poses", a.out / "poses.jsonl", "--log", "info"]
    subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL)
    packets = {name: u.close() for name, u in udp.items()}
    stop.set()
    for client in clients:
        client.join(timeout=5)

    all_rows = (a.out / "poses.jsonl").read_text().splitlines()
    records = [json.loads(line) for line in all_rows]
    rows = {r["sequence"]: r for r in records if r["pose"]}
    assert rows, "nothing was tracked"
    schema = json.loads(a.schema.read_text()) if a.schema else None
    report = Report()
    # FreeD with a frame counter cannot mark a prediction, so it sends none.
    report.check("FreeD (own decoder)", lambda: freed(packets["freed"], {n: r for n, r in rows.items() if r["state"] == "tracking"}))
    report.check("OpenTrackIO JSON (jsonschema)", lambda: opentrackio(packets["otrk_json"], rows, schema))
    report.check("OpenTrackIO CBOR (cbor2, jsonschema)", lambda: opentrackio(packets["otrk_cbor"], rows, schema))
    report.check("PosiStageNet (pypsn)", lambda: psn(packets["psn"], rows))
    report.check("OSC (python-osc)", lambda: osc(packets["osc"], rows))
    report.check("JSON by UDP", lambda: json_lines(packets["json"], rows, len(records)))
    report.check("JSON in a file", lambda: json_lines((a.out / "sent.jsonl").read_text().splitlines(), rows, len(records)))
    # Clients that connect to a running program miss earlier records.
    late = {n: r for n, r in rows.items() if tcp_lines and n >= json.loads(tcp_lines[0])["sequence"]}
    report.check("JSON by TCP", lambda: json_lines(tcp_lines, late, None))
    report.check("WebSocket (websockets)", lambda: web_socket(ws_lines, all_rows))
    if nodes:
        process, thread, lines = nodes
        process.terminate()
        thread.join(timeout=5)
        report.check("node-osc, @jwetzell/posistagenet", lambda: node(lines, rows))
    report.check("OTP (own decoder)", lambda: otp(*test_of_otp(a)))
    packets, states = replay_darkened(a, stage)
    report.check("Marks (cbor2, pypsn, python-osc)", lambda: marks(packets, states))
    sys.exit(1 if report.failed else 0)


if __name__ == "__main__":
    main()
