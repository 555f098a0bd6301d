// The set as three.js draws it: its things, the stage's surfaces, which occlude and receive
// shadows, and light. Everything is in the stage's frame, metres, z up.
import {
  AmbientLight, BoxGeometry, ConeGeometry, DirectionalLight, DoubleSide, GridHelper, Group, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial,
  PerspectiveCamera, PlaneGeometry, Quaternion, Scene, ShadowMaterial, Vector3,
} from "../vendor/three.js";
import { meshOf } from "./surfaces.js";

/** @import { Object3D } from "../vendor/three.js"
 * @import { Thing } from "../things.js"
 * @import { Pose, PoseRecord, Scene as Known } from "../types.js" */

/** How dark a shadow is, and metres that the floor and the light's shadows reach. */
const SHADOW = 0.45;
const REACH = 12;
/** Pixels along the shadow's picture. */
const SHADOW_PIXELS = 1024;
/** Colours of what has no surface of its own. */
const GRID = 0xff9d2e;

/** Camera axes (x right, y down, z forward) to those of three.js (y up, z back). */
const FLIP = new Matrix4().makeScale(1, -1, -1);

/** A pose as a matrix. @param {Pose} pose */
export function matrix({ position_m, orientation_xyzw }) {
  const [x, y, z, w] = orientation_xyzw;
  return new Matrix4().compose(new Vector3().fromArray(position_m), new Quaternion(x, y, z, w), new Vector3(1, 1, 1));
}

/** The thing that an object is the body of; null where it is of none. @param {Object3D} object */
export function thingOf({ userData: { thing } }) {
  return typeof thing === "string" ? thing : null;
}

/** What stands still on the stage, and what the set adds to it. */
export class VirtualSet {
  constructor() {
    this.scene = new Scene();
    // Its projection is the pinhole's, not one of angles.
    this.camera = new PerspectiveCamera();
    this.camera.matrixAutoUpdate = false;
    /** Stage, floor and objects: they hide, and take shadows. */
    this.stage = new Group();
    /** @type {Group[]} */
    this.objects = [];
    this.things = new Group();
    this.scene.add(this.stage, this.things, new AmbientLight(0xffffff, 1.1), ...this.light());
    /**
     * The objects made so far, by what they were made of.
     * @type {Map<string, {kind: string, colour: string, model: Object3D | undefined, holder:
     *   Object3D}>}
     */
    this.held = new Map();
    /** @type {Known | null} */
    this.known = null;
    this.floor = 0;
  }

  /** A lamp in the house, high and from the left. */
  light() {
    const lamp = new DirectionalLight(0xffffff, 2.4);
    lamp.position.set(-3, -5, 7);
    lamp.castShadow = true;
    lamp.shadow.mapSize.set(SHADOW_PIXELS, SHADOW_PIXELS);
    Object.assign(lamp.shadow.camera, { left: -REACH / 2, right: REACH / 2, top: REACH / 2, bottom: -REACH / 2, near: 0.5, far: 30 });
    lamp.shadow.bias = -0.002;
    lamp.shadow.normalBias = 0.01;
    return [lamp, lamp.target];
  }

  /**
   * The stage as the daemon describes it, and the height of its floor.
   * @param {Known} known
   * @param {number} floor metres
   */
  setStage(known, floor) {
    this.known = known;
    this.floor = floor;
    this.stage.clear();
    for (const surface of known.stage.surfaces) this.stage.add(...hider(meshOf(surface)));
    const ground = new PlaneGeometry(2 * REACH, 2 * REACH);
    ground.translate(0, 0, floor);
    this.stage.add(catcher(ground));
    for (const group of this.objects) this.scene.remove(group);
    this.objects = known.objects.map((object) => {
      const group = new Group();
      group.matrixAutoUpdate = false;
      for (const surface of object.surfaces) group.add(...hider(meshOf(surface)));
      this.scene.add(group);
      return group;
    });
  }

  /**
   * The camera and the objects as a record has them.
   * @param {Pose} pose
   * @param {PoseRecord["objects"]} objects
   */
  setPoses(pose, objects) {
    this.camera.matrix.copy(matrix(pose)).multiply(FLIP);
    this.camera.matrixWorldNeedsUpdate = true;
    this.objects.forEach((group, k) => {
      const found = objects[k]?.pose;
      group.visible = Boolean(found);
      if (found) group.matrix.copy(matrix(found));
      group.matrixWorldNeedsUpdate = true;
    });
  }

  /**
   * Sets what is on the set; a thing of the same kind and colour is moved, not made again.
   * @param {Thing[]} things
   * @param {Map<string, Object3D>} models
   */
  setThings(things, models) {
    const wanted = new Set(things.map(({ id }) => id));
    for (const [id, { holder }] of this.held) {
      if (!wanted.has(id)) {
        this.things.remove(holder);
        this.held.delete(id);
      }
    }
    for (const thing of things) {
      const { kind, colour } = thing;
      const model = kind === "model" ? models.get(thing.file ?? "") : undefined;
      let held = this.held.get(thing.id);
      if (held?.kind !== kind || held.colour !== colour || held.model !== model) {
        if (held) this.things.remove(held.holder);
        held = { kind, colour, model, holder: holderOf(thing, model) };
        this.held.set(thing.id, held);
        this.things.add(held.holder);
      }
      const { holder } = held;
      holder.matrix.copy(this.ground(thing.on));
      holder.matrixWorldNeedsUpdate = true;
      const body = holder.children[0];
      body.position.fromArray(thing.position_m);
      const [x, y, z] = thing.rotation_deg.map((degrees) => (degrees * Math.PI) / 180);
      body.rotation.set(x, y, z, "ZYX");
      body.scale.fromArray(thing.size_m);
      holder.visible = thing.shown;
    }
  }

  /**
   * The frame that a thing stands in: the floor's, or a surface's, z out of its face.
   * @param {string} on
   */
  ground(on) {
    const surface = this.known?.stage.surfaces[Number(on)];
    return on !== "floor" && surface ? matrix(surface.pose) : new Matrix4().makeTranslation(0, 0, this.floor);
  }
}

/**
 * Two meshes of one shape: one only occludes, one only shows shadows.
 * @param {import("../vendor/three.js").BufferGeometry} shape
 */
function hider(shape) {
  const hides = new Mesh(shape, new MeshBasicMaterial({ colorWrite: false, side: DoubleSide }));
  hides.renderOrder = -2;
  return [hides, catcher(shape)];
}

/** @param {import("../vendor/three.js").BufferGeometry} shape */
function catcher(shape) {
  const material = new ShadowMaterial({ opacity: SHADOW, side: DoubleSide, depthWrite: false, polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -2 });
  const catches = new Mesh(shape, material);
  catches.receiveShadow = true;
  catches.renderOrder = -1;
  return catches;
}

/**
 * The frame of a thing with the thing in it, one metre large, standing on its origin.
 * @param {Thing} thing
 * @param {Object3D | undefined} model
 */
function holderOf(thing, model) {
  const holder = new Group();
  holder.matrixAutoUpdate = false;
  const body = new Group();
  body.rotation.order = "ZYX";
  body.userData.thing = thing.id;
  body.add(shapeOf(thing, model));
  holder.add(body);
  holder.traverse((one) => {
    if (one instanceof Mesh) one.castShadow = one.receiveShadow = true;
  });
  return holder;
}

/** @param {Thing} thing @param {Object3D | undefined} model */
function shapeOf({ kind, colour }, model) {
  if (kind === "grid") {
    // three.js has grids in x and z.
    const grid = new GridHelper(1, 10, GRID, GRID);
    grid.rotation.x = Math.PI / 2;
    return grid;
  }
  if (kind === "model") return model?.clone() ?? new Group();
  const shape = kind === "cone" ? new ConeGeometry(0.5, 1, 48).rotateX(Math.PI / 2) : new BoxGeometry(1, 1, 1);
  return new Mesh(shape.translate(0, 0, 0.5), new MeshStandardMaterial({ color: colour, roughness: 0.7 }));
}
