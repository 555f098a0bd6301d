"""Whether exported takes show the stage where the records have it, as other programs read them.

    python benches/exports.py STAGEPOSE FIXTURE OUT [--node FOLDER] [--check]

Tracks the fixture's clip, exports its poses in every format, reads the files with the software of
those who own the formats, and projects the corners of the stage's surfaces in every frame with a
pose. The lens has unequal fx and fy and a principal point beside the centre; formats that cannot
hold these get a lens without. Some records lose their pose first, so that there are gaps. Prints
the largest distance from the records' own projection, pixels.

USD is read by Pixar's usd-core, which also validates it, and MCAP by Foxglove's mcap. glTF is
judged by Khronos' validator if `--node` names a folder with it in `node_modules`. The Blender script
runs in PyPI's bpy if that is installed. The other files, and glTF's numbers, are read here by the
rules of their programs. OUT keeps the files. `--check` fails if a distance exceeds 0.01 px.
"""

import argparse
import base64
import json
import math
import re
import shutil
import struct
import subprocess
import sys
import tomllib
from pathlib import Path

# Largest distance, pixels.
BAR = 0.01
# Rows whose pose is taken out: the first, a run, and the last.
GAPS = (0, 11, 12, 13, -1)


def mul(a, b):
    return [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)] for row in a]


def times(m, v):
    return [sum(x * y for x, y in zip(row, v)) for row in m]


def transposed(m):
    return [list(column) for column in zip(*m)]


def from_quaternion(x, y, z, w):
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]


def about(axis, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    m = [[float(i == j) for j in range(3)] for i in range(3)]
    m[a][a], m[a][b], m[b][a], m[b][b] = c, -s, s, c
    return m


class Lens:
    def __init__(self, numbers):
        self.width, self.height = numbers["width"], numbers["height"]
        self.fx, self.fy, self.cx, self.cy = (numbers[key] for key in ("fx", "fy", "cx", "cy"))

    def centred(self):
        """The lens of a format with one focal length and no principal point."""
        numbers = {"width": self.width, "height": self.height, "fx": self.fx, "fy": self.fx}
        return Lens(numbers | {"cx": (self.width - 1) / 2, "cy": (self.height - 1) / 2})

    def project(self, rotation, position, point):
        """Projects a point of the stage; the rotation is the camera's, x right, y down, z ahead."""
        x, y, z = times(transposed(rotation), [p - q for p, q in zip(point, position)])
        return self.fx * x / z + self.cx, self.fy * y / z + self.cy


def written(folder, fixture):
    """Writes the config with a lens that tells the axes apart; returns the config and the lens."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("stage.toml", "backdrop.png", "flat.png"):
        shutil.copy(fixture / name, folder / name)
    text = (fixture / "camera.toml").read_text()
    lens = tomllib.loads(text) | {"fy": 570.25, "cx": 331.75, "cy": 170.5}
    (folder / "camera.toml").write_text("".join(f"{key} = {value}\n" for key, value in lens.items()))
    return folder / "stage.toml", Lens(lens)


def corners(config):
    """Returns the corners of the stage's surfaces: top left, top right, bottom right, bottom left."""
    found = []
    for surface in tomllib.loads(config.read_text())["stage"]["surface"]:
        rotation = from_quaternion(*surface["orientation_xyzw"])
        w, h = (side / 2 for side in surface["size_m"])
        for x, y in ((-w, h), (w, h), (w, -h), (-w, -h)):
            found.append([a + b for a, b in zip(times(rotation, [x, y, 0]), surface["position_m"])])
    return found


class Take:
    """The records, and what the files are compared with."""

    def __init__(self, program, fixture, config, lens, out):
        poses = out / "poses.jsonl"
        subprocess.run([program, "replay", fixture, "--config", fixture / "stage.toml", "--poses", poses], check=True, stdout=subprocess.DEVNULL)
        self.records = [json.loads(line) for line in poses.read_text().splitlines()]
        for row in GAPS:
            self.records[row] |= {"state": "lost", "pose": None, "measured": None}
        poses.write_text("".join(json.dumps(record) + "\n" for record in self.records))
        self.lens, self.corners, self.poses, self.config = lens, corners(config), poses, config
        self.keyed = {row: record["pose"] for row, record in enumerate(self.records) if record["pose"]}

    def seconds(self, row):
        return (self.records[row]["timestamp_ns"] - self.records[0]["timestamp_ns"]) * 1e-9

    def seen(self, row, lens=None):
        pose = self.keyed[row]
        rotation = from_quaternion(*pose["orientation_xyzw"])
        return [(lens or self.lens).project(rotation, pose["position_m"], corner) for corner in self.corners]

    def farthest(self, projected, lens=None):
        """The largest distance; `projected` has the corners' pixels by row."""
        if sorted(projected) != sorted(self.keyed):
            sys.exit(f"poses in rows {sorted(projected)}, not {sorted(self.keyed)}")
        return max(math.dist(a, b) for row, pixels in projected.items() for a, b in zip(pixels, self.seen(row, lens), strict=True))


def valid_usd(take, file):
    """Opens a USD file, and ends the program if it is not valid or its stage hangs elsewhere."""
    from pxr import Usd, UsdGeom, UsdValidation

    stage = Usd.Stage.Open(str(file))
    faults = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(stage)
    faults = [fault.GetMessage() for fault in faults]
    if faults:
        sys.exit(f"{file}: {faults}")
    if UsdGeom.GetStageUpAxis(stage) != "Z" or UsdGeom.GetStageMetersPerUnit(stage) != 1:
        sys.exit(f"{file}: other axes or units")
    # A mesh's outermost points lie row by row from below.
    meshes = [UsdGeom.Mesh(prim).GetPointsAttr().Get() for prim in stage.GetPrimAtPath("/Stagepose/Stage").GetChildren()]
    same_corners(take, file, [mesh[k] for mesh in meshes for k in (2, 3, 1, 0)])
    return stage


def same_corners(take, file, points):
    off = max(math.dist(a, b) for a, b in zip(points, take.corners, strict=True))
    if off > 1e-6:
        sys.exit(f"{file}: the stage is {off} m off")


def of_usd(take, file):
    from pxr import Gf, UsdGeom

    stage = valid_usd(take, file)
    camera = UsdGeom.Camera.Get(stage, "/Stagepose/Camera")
    codes = UsdGeom.Xformable(camera).GetTimeSamples()
    rate = stage.GetTimeCodesPerSecond()
    rows = {row: min(codes, key=lambda code: abs(code / rate - take.seconds(row))) for row in take.keyed}
    if max(abs(code / rate - take.seconds(row)) for row, code in rows.items()) > 1e-6 or len(codes) != len(rows):
        sys.exit(f"{file}: samples that are not at the stamps")
    hidden = [row for row in range(len(take.records)) if camera.ComputeVisibility(take.seconds(row) * rate + 1e-4) == "invisible"]
    if hidden != [row for row in range(len(take.records)) if row not in take.keyed]:
        sys.exit(f"{file}: invisible in rows {hidden}")

    def project(code):
        frustum = camera.GetCamera(code).frustum
        matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        ndc = [matrix.Transform(Gf.Vec3d(*corner)) for corner in take.corners]
        return [((1 + p[0]) / 2 * take.lens.width - 0.5, (1 - p[1]) / 2 * take.lens.height - 0.5) for p in ndc]

    return take.farthest({row: project(code) for row, code in rows.items()})


def of_mcap(take, file):
    from mcap.reader import make_reader

    with open(file, "rb") as stream:
        messages = [(channel.topic, message.log_time, json.loads(message.data)) for _, channel, message in make_reader(stream).iter_messages()]
    records = [body for topic, _, body in messages if topic == "/stagepose/record"]
    if records != take.records:
        sys.exit(f"{file}: other records")
    stamps = {record["timestamp_ns"]: row for row, record in enumerate(take.records)}
    k = next(body["K"] for topic, _, body in messages if topic == "/stagepose/camera")
    lens = Lens({"width": take.lens.width, "height": take.lens.height, "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5]})
    projected = {}
    for _, stamp, body in (message for message in messages if message[0] == "/tf" and message[2]["child_frame_id"] == "camera"):
        rotation = from_quaternion(*(body["rotation"][axis] for axis in "xyzw"))
        position = [body["translation"][axis] for axis in "xyz"]
        projected[stamps[stamp]] = [lens.project(rotation, position, corner) for corner in take.corners]
    return take.farthest(projected)


def judge_gltf(file, node):
    """Ends the program if Khronos' validator finds fault with a file."""
    judge = ("const v=require('gltf-validator');v.validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
             ".then(r=>console.log(JSON.stringify(r.issues)))")
    run = subprocess.run(["node", "-e", judge, file.resolve()], cwd=node, check=True, capture_output=True, text=True)
    issues = json.loads(run.stdout)
    if issues["numErrors"] + issues["numWarnings"]:
        sys.exit(f"{file}: {issues['messages']}")


def of_gltf(take, file, node):
    whole = json.loads(file.read_text())
    if node:
        judge_gltf(file, node)
    data = base64.b64decode(whole["buffers"][0]["uri"].split(",")[1])

    def rows(accessor, width):
        accessor = whole["accessors"][accessor]
        begin = whole["bufferViews"][accessor["bufferView"]]["byteOffset"]
        return [struct.unpack_from(f"<{width}f", data, begin + 4 * width * k) for k in range(accessor["count"])]

    camera = next(k for k, node in enumerate(whole["nodes"]) if node.get("camera") == 0)
    path = {channel["target"]["path"]: whole["animations"][0]["samplers"][channel["sampler"]]
            for channel in whole["animations"][0]["channels"] if channel["target"]["node"] == camera}
    stamps = [row[0] for row in rows(path["translation"]["input"], 1)]
    positions, turns = rows(path["translation"]["output"], 3), rows(path["rotation"]["output"], 4)
    view = whole["cameras"][0]["perspective"]
    scale = 1 / math.tan(view["yfov"] / 2)
    projected = {}
    for row in take.keyed:
        k = min(range(len(stamps)), key=lambda k: abs(stamps[k] - take.seconds(row)))
        rotation, pixels = from_quaternion(*turns[k]), []
        for corner in take.corners:
            x, y, z = times(transposed(rotation), [p - q for p, q in zip(corner, positions[k])])
            ndc = scale / view["aspectRatio"] * x / -z, scale * y / -z
            pixels.append(((1 + ndc[0]) / 2 * take.lens.width - 0.5, (1 - ndc[1]) / 2 * take.lens.height - 0.5))
        projected[row] = pixels
    centred = take.lens.centred()
    centred.fy = take.lens.fy
    return take.farthest(projected, centred)


def of_chan(take, file):
    """Nuke: the rotation order is ZXY, z first; the field of view is the vertical one."""
    lens, projected = take.lens.centred(), {}
    lens.fx = lens.fy = take.lens.fy
    for line in file.read_text().splitlines():
        frame, *position, rx, ry, rz, fov = map(float, line.split())
        rotation = mul(about(1, ry), mul(about(0, rx), about(2, rz)))
        focal, pixels = take.lens.height / 2 / math.tan(math.radians(fov) / 2), []
        for x, y, z in take.corners:
            p = times(transposed(rotation), [a - b for a, b in zip((x, z, -y), position)])
            pixels.append((take.lens.width / 2 - focal * p[0] / p[2] - 0.5, take.lens.height / 2 + focal * p[1] / p[2] - 0.5))
        projected[int(frame) - 1] = pixels
    return take.farthest(projected, lens)


def of_after_effects(take, file):
    """After Effects: orientation turns about z, then y, then x; the room's centre is the camera's."""
    told = json.loads(re.search(r"^var TAKE = (.*);$", file.read_text(), re.M)[1])
    nulls, projected = [corner["position"] for corner in told["corners"]], {}
    for row, *numbers in told["camera"]["keys"]:
        position, (rx, ry, rz) = numbers[:3], numbers[3:]
        rotation = mul(about(0, rx), mul(about(1, ry), about(2, rz)))
        pixels = []
        for null in nulls:
            x, y, z = times(transposed(rotation), [a - b for a, b in zip(null, position)])
            across, down = told["zoom"] * x / z, told["zoom"] * y / z * told["height_percent"] / 100
            pixels.append((told["principal"][0] + across - 0.5, told["principal"][1] + down - 0.5))
        projected[row] = pixels
    return take.farthest(projected)


def of_blender(take, file):
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    exec(compile(file.read_text(), str(file), "exec"), {"__file__": str(file), "__name__": "take"})
    scene, projected = bpy.context.scene, {}
    rate, wanted = scene.render.fps / scene.render.fps_base, 1 / ((take.seconds(len(take.records) - 1)) / (len(take.records) - 1))
    if abs(rate / wanted - 1) > 1e-4 or scene.frame_end != len(take.records):
        sys.exit(f"{file}: {rate} frames per second and {scene.frame_end} frames")
    meshes = [item for item in scene.objects if item.type == "MESH"]
    same_corners(take, file, [item.data.vertices[k].co for item in meshes for k in (2, 3, 1, 0)])
    if any(not item.data.materials[0].node_tree.nodes.get("Image Texture") for item in meshes):
        sys.exit(f"{file}: the stage has no artwork")
    for row in take.keyed:
        scene.frame_set(row + 1)
        seen = [world_to_camera_view(scene, scene.camera, Vector(corner)) for corner in take.corners]
        projected[row] = [(p.x * take.lens.width - 0.5, (1 - p.y) * take.lens.height - 0.5) for p in seen]
    return take.farthest(projected)


def judge_stage(take, program, config, out, node):
    """Exports the stage itself in each of its formats, and ends the program if it hangs elsewhere."""
    for to, ending in (("obj", "obj"), ("gltf", "gltf"), ("usd", "usda")):
        file = out / f"stage.{ending}"
        subprocess.run([program, "export", "--config", config, "--to", to, "--output", file], check=True, stdout=subprocess.DEVNULL)
        if to == "usd":
            valid_usd(take, file)
        elif to == "gltf" and node:
            judge_gltf(file, node)
        elif to == "obj":
            points = [[float(v) for v in line.split()[1:]] for line in file.read_text().splitlines() if line.startswith("v ")]
            upright = [(x, -z, y) for x, y, z in points]
            same_corners(take, file, [upright[4 * k + j] for k in range(len(points) // 4) for j in (2, 3, 1, 0)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=Path)
    parser.add_argument("fixture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--node", type=Path)
    parser.add_argument("--check", action="store_true")
    a = parser.parse_args()
    config, lens = written(a.out, a.fixture)
    take = Take(a.program, a.fixture, config, lens, a.out)
    readers = {
        "usd": ("usda", of_usd), "mcap": ("mcap", of_mcap), "gltf": ("gltf", lambda take, file: of_gltf(take, file, a.node)),
        "chan": ("chan", of_chan), "ae": ("jsx", of_after_effects), "blender": ("py", of_blender),
    }
    worst = 0.0
    for to, (ending, read) in readers.items():
        file = a.out / f"take.{ending}"
        subprocess.run([a.program, "export", take.poses, "--to", to, "--config", config, "--output", file], check=True, stdout=subprocess.DEVNULL)
        try:
            distance = read(take, file)
        except ModuleNotFoundError as missing:
            if to != "blender":
                raise
            print(f"{to:8} NOT RUN: {missing}", file=sys.stderr)
            continue
        print(f"{to:8} {len(take.keyed)} frames, {len(take.corners)} corners: at most {distance:.6f} px from the records")
        worst = max(worst, distance)
    judge_stage(take, a.program, config, a.out, a.node)
    if a.check and worst > BAR:
        sys.exit(f"a corner lies more than {BAR} px away from where the records have it")


if __name__ == "__main__":
    main()
