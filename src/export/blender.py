

def curves(action):
    """Returns the curves of an action; Blender 4.4 put them into layers, 5.0 left the old list out."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [c for layer in action.layers for strip in layer.strips for bag in strip.channelbags for c in bag.fcurves]


def animate(item, keys, ends):
    """Gives an object its poses: keys are frame, position and quaternion w, x, y, z. After a frame
    of `ends` it stands still until the next key."""
    item.rotation_mode = "QUATERNION"
    for key in keys:
        item.location = key[1:4]
        item.rotation_quaternion = key[4:8]
        item.keyframe_insert("location", frame=key[0])
        item.keyframe_insert("rotation_quaternion", frame=key[0])
    for curve in curves(item.animation_data.action):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT" if round(point.co[0]) in ends else "LINEAR"


def material(sheet, folder):
    """Shows the artwork as it is, whatever the light."""
    made = bpy.data.materials.new(sheet["name"])
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output, emission = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeEmission")
    links.new(emission.outputs[0], output.inputs[0])
    file = os.path.join(folder, sheet["picture"])
    if os.path.exists(file):
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(file, check_existing=True)
        picture.image.colorspace_settings.name = "Non-Color" if sheet["is_linear"] else "sRGB"
        links.new(picture.outputs[0], emission.inputs[0])
    else:
        print("stagepose: not found:", file)
    return made


def mesh(sheet, folder):
    """Returns an object that has the shape of a surface."""
    made = bpy.data.meshes.new(sheet["name"])
    made.from_pydata(sheet["points"], [], sheet["faces"])
    layer = made.uv_layers.new(name="artwork")
    for loop in made.loops:
        layer.data[loop.index].uv = sheet["uvs"][loop.vertex_index]
    made.materials.append(material(sheet, folder))
    return bpy.data.objects.new(sheet["name"], made)


def camera(lens):
    """Returns the camera: a pinhole that gives fx, fy, cx and cy."""
    data = bpy.data.cameras.new("stagepose")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = lens["sensor_width"]
    data.lens_unit = "MILLIMETERS"
    data.lens = lens["lens"]
    data.shift_x = lens["shift_x"]
    data.shift_y = lens["shift_y"]
    data.clip_start, data.clip_end = 0.01, 1000.0
    return bpy.data.objects.new("stagepose", data)


def show_clip(data, file):
    """Shows the clip behind the camera's view. Its picture has the lens' distortion, the view does
    not."""
    movie = bpy.data.movieclips.load(file)
    movie.frame_start = 1
    data.show_background_images = True
    background = data.background_images.new()
    background.source = "MOVIE_CLIP"
    background.clip = movie
    background.display_depth = "BACK"
    background.frame_method = "STRETCH"
    background.alpha = 1.0


def set_up(scene):
    """Sets size, rate and length, so that frame n is row n of the clip, counted from 1."""
    render, lens = scene.render, TAKE["lens"]
    render.resolution_x, render.resolution_y = lens["width"], lens["height"]
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = lens["pixel_aspect"]
    render.fps, render.fps_base = TAKE["fps"], TAKE["fps_base"]
    scene.frame_start, scene.frame_end = 1, TAKE["rows"]
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 1.0
    for frame in TAKE["gaps"]:
        scene.timeline_markers.new("no pose", frame=frame)
    if "timecode" in TAKE:
        first = TAKE["timecode"]
        scene.timeline_markers.new(first["code"], frame=first["frame"])
        scene["timecode"], scene["timecode_frame"], scene["timecode_rate"] = first["code"], first["frame"], first["rate"]


def main():
    scene = bpy.context.scene
    folder = os.path.dirname(os.path.abspath(__file__))
    collection = bpy.data.collections.new("stagepose")
    scene.collection.children.link(collection)
    set_up(scene)
    view = camera(TAKE["lens"])
    collection.objects.link(view)
    animate(view, TAKE["camera"]["keys"], set(TAKE["camera"]["ends"]))
    scene.camera = view
    for sheet in TAKE["stage"]:
        collection.objects.link(mesh(sheet, folder))
    for thing in TAKE["objects"]:
        item = bpy.data.objects.new(thing["name"], None)
        collection.objects.link(item)
        animate(item, thing["keys"], set(thing["ends"]))
        for sheet in thing["sheets"]:
            part = mesh(sheet, folder)
            part.parent = item
            collection.objects.link(part)
    clips = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    if clips:
        show_clip(view.data, os.path.abspath(clips[0]))


main()
