#!/usr/bin/env python3
"""Reconstructs a walk with COLMAP and locates the frames of a show in it, for benches/mapping.py.

    python3 -m venv target/colmap && target/colmap/bin/pip install pycolmap numpy scipy
    target/colmap/bin/python benches/colmap_walk.py WALK SHOW OUT

Writes OUT/WALK.txt and OUT/SHOW.txt (seconds, x y z, quaternion), and prints the times as JSON. The
lens is the clip's camera.json and stays as it is. COLMAP has the middle of the first pixel at 0.5.
"""
import argparse
import json
import pathlib
import time

import numpy as np
import pycolmap

FIRST_PIXEL = 0.5


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walk", type=pathlib.Path)
    parser.add_argument("show", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--walk-every", type=int, default=3, help="one frame of the walk in so many [default: 3]")
    parser.add_argument("--every", type=int, default=9, help="one frame of the show in so many [default: 9]")
    return parser.parse_args()


def shown(clip, every, prefix, images):
    """Links frames of a clip into a folder; returns their names and stamps, seconds."""
    rows = [line.split(",") for line in (clip / "timestamps.csv").read_text().splitlines()[1:]][::every]
    names = {}
    for stamp, file in rows:
        name = f"{prefix}-{file.strip()}"
        (images / name).symlink_to((clip / "frames" / file.strip()).resolve())
        names[name] = 1e-9 * int(stamp)
    return names


def reader(camera):
    """Returns the options that state the lens."""
    if camera.get("skew") or camera["dist"][4]:
        raise SystemExit("colmap_walk.py: the lens has a skew or a k3, which COLMAP's OPENCV model lacks")
    numbers = [camera["fx"], camera["fy"], camera["cx"] + FIRST_PIXEL, camera["cy"] + FIRST_PIXEL, *camera["dist"][:4]]
    options = pycolmap.ImageReaderOptions()
    options.camera_model, options.camera_params = "OPENCV", ",".join(map(str, numbers))
    return options


def match(database, pairs, file):
    file.write_text("\n".join(" ".join(pair) for pair in pairs) + "\n")
    options = pycolmap.ImportedPairingOptions()
    options.match_list_path = str(file)
    pycolmap.match_image_pairs(database, pairing_options=options)


def reconstructed(database, images, out, names):
    options = pycolmap.IncrementalPipelineOptions()
    options.image_names = list(names)
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = False
    models = pycolmap.incremental_mapping(database, images, out, options)
    return max(models.values(), key=lambda model: model.num_reg_images())


def pose_line(stamp, cam_from_world):
    world_from_cam = cam_from_world.inverse()
    return " ".join(f"{v:.9f}" for v in [stamp, *world_from_cam.translation, *world_from_cam.rotation.quat])


def located(model, database, name):
    """Returns the pose of a frame by the points that its matches with the walk's frames have."""
    image = database.read_image_with_name(name)
    keypoints, points = database.read_keypoints(image.image_id), {}
    for other in model.images.values():
        if not other.has_pose:
            continue
        geometry = database.read_two_view_geometry(image.image_id, other.image_id)
        for own, its in np.asarray(geometry.inlier_matches):
            point = other.points2D[int(its)]
            if point.has_point3D():
                points[int(own)] = model.points3D[point.point3D_id].xyz
    if len(points) < 12:
        return None
    pixels = np.array([keypoints[k][:2] if not hasattr(keypoints[k], "x") else (keypoints[k].x, keypoints[k].y) for k in points])
    camera = model.cameras[image.camera_id]
    found = pycolmap.estimate_and_refine_absolute_pose(pixels, np.array(list(points.values())), camera)
    return found and found["cam_from_world"]


def main():
    chosen = arguments()
    images = chosen.out / "images"
    images.mkdir(parents=True)
    walk, show = (shown(clip, every, clip.name, images) for clip, every in ((chosen.walk, chosen.walk_every), (chosen.show, chosen.every)))
    file, began = chosen.out / "database.db", time.monotonic()
    options, single = reader(json.loads((chosen.walk / "camera.json").read_text())), pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(file, images, list(walk), single, options)
    names = list(walk)
    match(file, [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]], chosen.out / "pairs.txt")
    model = reconstructed(file, images, chosen.out / "model", walk)
    seconds = time.monotonic() - began
    posed = {image.name: image.cam_from_world() for image in model.images.values() if image.has_pose}
    (chosen.out / f"{chosen.walk.name}.txt").write_text("".join(pose_line(walk[name], pose) + "\n" for name, pose in posed.items()))

    began = time.monotonic()
    pycolmap.extract_features(file, images, list(show), single, options)
    match(file, [(a, b) for a in show for b in names], chosen.out / "show-pairs.txt")
    database, lines = pycolmap.Database.open(file), []
    for name, stamp in show.items():
        pose = located(model, database, name)
        lines += [pose_line(stamp, pose) + "\n"] if pose else []
    (chosen.out / f"{chosen.show.name}.txt").write_text("".join(lines))
    a_frame = (time.monotonic() - began) / len(show)
    print(json.dumps({"walk s": seconds, "show s a frame": a_frame, "points": model.num_points3D(), "given %": 100 * len(lines) / len(show)}))


if __name__ == "__main__":
    main()
