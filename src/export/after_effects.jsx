
(function () {
    // Gives a layer its poses: keys are row, position in pixels, orientation in degrees. After a
    // key of `ends` the layer stands still until the next one.
    function animate(layer, motion) {
        var times = [], positions = [], turns = [], k;
        for (k = 0; k < motion.keys.length; k++) {
            var key = motion.keys[k];
            times.push(key[0] / TAKE.rate);
            positions.push([key[1], key[2], key[3]]);
            turns.push([key[4], key[5], key[6]]);
        }
        var transform = layer.property("ADBE Transform Group");
        var animated = [transform.property("ADBE Position"), transform.property("ADBE Orientation")];
        animated[0].setValuesAtTimes(times, positions);
        animated[1].setValuesAtTimes(times, turns);
        for (k = 0; k < motion.ends.length; k++) {
            for (var a = 0; a < animated.length; a++) {
                animated[a].setInterpolationTypeAtKey(motion.ends[k] + 1, KeyframeInterpolationType.LINEAR, KeyframeInterpolationType.HOLD);
            }
        }
    }

    app.beginUndoGroup("stagepose");
    var duration = TAKE.rows / TAKE.rate;
    // The room's centre is the principal point. The picture's composition shows the part of it that
    // the camera saw.
    var picture = app.project.items.addComp("stagepose", TAKE.size[0], TAKE.size[1], 1, duration, TAKE.rate);
    var room = app.project.items.addComp("stagepose room", TAKE.room[0], TAKE.room[1], 1, duration, TAKE.rate);
    // The timecode of the first row.
    if (TAKE.start) {
        var comps = [picture, room];
        for (var c = 0; c < comps.length; c++) {
            comps[c].dropFrame = TAKE.start.is_drop;
            comps[c].displayStartTime = TAKE.start.seconds;
        }
    }
    var centre = [TAKE.room[0] / 2, TAKE.room[1] / 2];
    var camera = room.layers.addCamera("stagepose", centre);
    camera.autoOrient = AutoOrientType.NO_AUTO_ORIENT;
    camera.property("ADBE Camera Options Group").property("ADBE Camera Zoom").setValue(TAKE.zoom);
    animate(camera, TAKE.camera);
    for (var g = 0; g < TAKE.gaps.length; g++) {
        camera.property("ADBE Marker").setValueAtTime(TAKE.gaps[g] / TAKE.rate, new MarkerValue("no pose"));
    }
    for (var n = 0; n < TAKE.corners.length; n++) {
        var corner = room.layers.addNull(duration);
        corner.name = TAKE.corners[n].name;
        corner.threeDLayer = true;
        corner.property("ADBE Transform Group").property("ADBE Position").setValue(TAKE.corners[n].position);
    }
    for (var o = 0; o < TAKE.objects.length; o++) {
        var thing = room.layers.addNull(duration);
        thing.name = TAKE.objects[o].name;
        thing.threeDLayer = true;
        animate(thing, TAKE.objects[o]);
    }
    var layer = picture.layers.add(room).property("ADBE Transform Group");
    layer.property("ADBE Anchor Point").setValue(centre);
    layer.property("ADBE Position").setValue(TAKE.principal);
    layer.property("ADBE Scale").setValue([100, TAKE.height_percent]);
    picture.openInViewer();
    app.endUndoGroup();
})();
