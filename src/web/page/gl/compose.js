// Composes the set into a camera's picture: draws the set by a pinhole camera at the picture's
// pose, bends it by the lens, and puts it over that picture.
import {
  BufferAttribute, BufferGeometry, DoubleSide, GLSL3, HalfFloatType, LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Mesh, NearestFilter, NoBlending, NoColorSpace, PCFShadowMap,
  RawShaderMaterial, RGBAFormat, Scene, Texture, Vector2, Vector3, Vector4, WebGLRenderTarget, WebGLRenderer,
} from "../vendor/three.js";
import { turn, within } from "../lens.js";
import { bending, pinhole, projection } from "./lens.js";
import { VirtualSet } from "./set.js";
import { meshOf } from "./surfaces.js";

/** @import { Object3D } from "../vendor/three.js"
 * @import { Pair } from "./align.js"
 * @import { Motion, Pose, PoseRecord, Scene as Known } from "../types.js" */

/** How the set and the picture are shown. */
export const MODES = /** @type {const} */ (["image", "set", "mix", "wipe", "alone"]);
/** @typedef {(typeof MODES)[number]} Mode */
/** Samples a pixel on the set's edges. */
const SAMPLES = 4;
/** Samples of the artwork along the direction in which it is seen shortened. */
const ANISOTROPY = 8;
/** Metres from the plane of the first surface below which the camera sees it edge on. */
const EDGE_ON = 0.1;

// Maps a pixel of the lens to the pinhole's picture, which shows what the camera saw at the middle
// row. A rolling shutter reads the first row earlier and the last one later: meanwhile the camera
// rotated, and moved relative to the plane of the stage.
const VERTEX = `
uniform vec3 turned; uniform vec3 moved; uniform vec4 plane; uniform vec4 pinhole; uniform vec2 size;
in vec3 position; in vec2 raw; in vec2 towards;
out vec2 inPicture; out vec2 inSet;
void main() {
  float late = raw.y - 0.5;
  vec3 seen = vec3(towards, 1.0);
  vec3 angle = turned * late;
  vec3 first = cross(angle, seen);
  float nearness = max(0.0, dot(plane.xyz, seen) * plane.w);
  vec3 there = seen + first + 0.5 * cross(angle, first) + moved * late * nearness;
  vec2 at = (pinhole.xy * there.xy / there.z + pinhole.zw + 0.5) / size;
  inPicture = raw;
  inSet = vec2(at.x, 1.0 - at.y);
  gl_Position = vec4(position, 1.0);
}`;
// Where the lens shows no set: the picture alone.
const WHOLE = `
in vec3 position; in vec2 raw;
out vec2 inPicture; out vec2 inSet;
void main() { inPicture = raw; inSet = vec2(-1.0); gl_Position = vec4(position, 1.0); }`;

// The set is linear light times its coverage. The camera's picture is decoded, both are added, and
// the sum is encoded.
const COMPOSITE = `precision highp float;
uniform sampler2D picture; uniform sampler2D drawn; uniform float strength; uniform float edge; uniform float backdrop;
in vec2 inPicture; in vec2 inSet;
out vec4 shown;
vec3 decoded(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 encoded(vec3 c) { return mix(c * 12.92, 1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
void main() {
  vec3 below = backdrop * decoded(texture(picture, inPicture).rgb);
  float share = inPicture.x < edge ? 0.0 : strength;
  vec4 over = inSet.x < 0.0 ? vec4(0.0) : share * texture(drawn, inSet);
  shown = vec4(encoded(over.rgb + (1.0 - over.a) * below), 1.0);
}`;

// For the measurement: the drawn artwork's grey, its coverage, the camera's grey.
const COMPARE = `precision highp float;
uniform sampler2D picture; uniform sampler2D drawn;
in vec2 inPicture; in vec2 inSet;
out vec4 both;
void main() {
  vec4 artwork = texture(drawn, inSet);
  both = vec4(artwork.r, artwork.a, dot(texture(picture, inPicture).rgb, vec3(0.299, 0.587, 0.114)), 1.0);
}`;

const ARTWORK_VERTEX = `uniform mat4 modelViewMatrix; uniform mat4 projectionMatrix;
in vec3 position; in vec2 uv;
out vec2 at;
void main() { at = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;

const ARTWORK = `precision highp float;
// Without a picture, and from behind, it only hides what is behind it.
uniform sampler2D artwork; uniform float has;
in vec2 at;
out vec4 grey;
void main() { grey = vec4(texture(artwork, at).rrr, gl_FrontFacing ? has : 0.0); }`;

/** @param {ImageBitmap | null} image */
function textureOf(image) {
  const texture = new Texture(image);
  texture.colorSpace = NoColorSpace;
  texture.generateMipmaps = false;
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.flipY = false;
  return texture;
}

/** The inputs of VERTEX about the rows and the pinhole. */
function rows() {
  return { turned: { value: new Vector3() }, moved: { value: new Vector3() }, plane: { value: new Vector4() }, pinhole: { value: new Vector4() }, size: { value: new Vector2() } };
}

/** A picture with the set in it, on a canvas. Without WebGL2 the constructor throws. */
export class Compositor {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.renderer = new WebGLRenderer({ canvas, antialias: false, alpha: false });
    // Colours are encoded by the shader that shows them.
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.renderer.setClearColor(0x000000, 0);
    this.set = new VirtualSet();
    this.picture = textureOf(null);
    /**
     * The handles, which a clean picture does not show.
     * @type {{root: Object3D, isHeld: () => boolean}[]}
     */
    this.handles = [];
    /** Artwork by surface, as the measurement draws it. */
    this.artworks = new Scene();
    /** @type {Known | null} */
    this.known = null;
    this.uniforms = { picture: { value: this.picture }, drawn: { value: /** @type {Texture | null} */ (null) }, strength: { value: 1 }, edge: { value: 0 }, backdrop: { value: 1 }, ...rows() };
    const over = { vertexShader: VERTEX, uniforms: this.uniforms, depthTest: false, depthWrite: false, blending: NoBlending, side: DoubleSide };
    this.whole = new Mesh(wholePicture(), new RawShaderMaterial({ glslVersion: GLSL3, ...over, vertexShader: WHOLE, fragmentShader: COMPOSITE }));
    this.bent = new Mesh(new BufferGeometry(), new RawShaderMaterial({ glslVersion: GLSL3, ...over, fragmentShader: COMPOSITE }));
    this.compared = new Mesh(this.bent.geometry, new RawShaderMaterial({ glslVersion: GLSL3, ...over, fragmentShader: COMPARE }));
    for (const mesh of [this.whole, this.bent, this.compared]) mesh.frustumCulled = false;
    this.whole.renderOrder = -1;
    this.shows = new Scene().add(this.whole, this.bent);
    this.compares = new Scene().add(this.compared);
  }

  /**
   * The camera and the stage of a session.
   * @param {Known} known as /api/v1/scene has them
   * @param {number} floor metres
   */
  setScene(known, floor) {
    const { camera } = known;
    this.known = known;
    this.pinhole = pinhole(camera);
    const { width, height, fx, fy, cx, cy } = this.pinhole;
    this.uniforms.pinhole.value.set(fx, fy, cx, cy);
    this.uniforms.size.value.set(width, height);
    this.bent.geometry.dispose();
    this.bent.geometry = this.compared.geometry = bending(camera);
    this.target?.dispose();
    this.target = new WebGLRenderTarget(width, height, { type: HalfFloatType, format: RGBAFormat, minFilter: LinearFilter, magFilter: LinearFilter, samples: SAMPLES });
    this.measured?.dispose();
    this.measured = new WebGLRenderTarget(camera.width, camera.height, { minFilter: NearestFilter, magFilter: NearestFilter, depthBuffer: false });
    this.uniforms.drawn.value = this.target.texture;
    this.set.camera.projectionMatrix.copy(projection(this.pinhole));
    // By this the gizmo chooses its size.
    this.set.camera.fov = (360 / Math.PI) * Math.atan(height / 2 / fy);
    this.set.camera.projectionMatrixInverse.copy(this.set.camera.projectionMatrix).invert();
    this.set.setStage(known, floor);
    this.renderer.setSize(camera.width, camera.height, false);
  }

  /**
   * The artwork of the stage's surfaces, in their order; null for surfaces without.
   * @param {(ImageBitmap | null)[]} pictures
   */
  setArtworks(pictures) {
    this.artworks.clear();
    this.known?.stage.surfaces.forEach((surface, k) => {
      const artwork = textureOf(pictures[k] ?? null);
      artwork.generateMipmaps = true;
      artwork.minFilter = LinearMipmapLinearFilter;
      artwork.anisotropy = Math.min(ANISOTROPY, this.renderer.capabilities.getMaxAnisotropy());
      artwork.needsUpdate = Boolean(pictures[k]);
      const uniforms = { artwork: { value: artwork }, has: { value: pictures[k] ? 1 : 0 } };
      const material = new RawShaderMaterial({ glslVersion: GLSL3, vertexShader: ARTWORK_VERTEX, fragmentShader: ARTWORK, uniforms, blending: NoBlending, side: DoubleSide });
      this.artworks.add(new Mesh(meshOf(surface), material));
    });
  }

  /** From now on this is the camera's picture. @param {ImageBitmap} image */
  setPicture(image) {
    const before = this.picture.image;
    if (before && (before.width !== image.width || before.height !== image.height)) this.picture.dispose();
    this.picture.image = image;
    this.picture.needsUpdate = true;
    this.renderer.initTexture(this.picture);
  }

  /**
   * The camera's motion while the rows of this frame are read; null if unknown.
   * @param {Known} known
   * @param {Pose} pose
   * @param {Motion | null} motion
   */
  setMotion({ readout_s, stage }, pose, motion) {
    const { turned, moved, plane } = this.uniforms;
    const readout = motion === null ? 0 : readout_s;
    turned.value.fromArray(motion?.turn_rate ?? [0, 0, 0]).multiplyScalar(readout);
    moved.value.fromArray(motion?.velocity ?? [0, 0, 0]).multiplyScalar(readout);
    const [surface] = stage.surfaces;
    const normal = within({ position_m: [0, 0, 0], orientation_xyzw: pose.orientation_xyzw }, turn(surface.pose.orientation_xyzw, [0, 0, 1]));
    const middle = within(pose, surface.pose.position_m);
    const distance = normal.reduce((sum, value, axis) => sum + value * middle[axis], 0);
    // Seen edge on, it says nothing of how far away things are.
    plane.value.fromArray([...normal, Math.abs(distance) > EDGE_ON ? 1 / distance : 0]);
  }

  /**
   * Draws the last picture with the set at the record's pose; without a pose the picture alone.
   * @param {PoseRecord | null} record
   * @param {Motion | null} motion
   * @param {{mode: Mode, share: number, clean: boolean}} how
   */
  draw(record, motion, { mode, share, clean }) {
    if (!this.target || !this.known) return;
    const pose = mode === "image" ? null : record?.pose;
    this.uniforms.strength.value = pose ? (mode === "mix" ? share : 1) : 0;
    this.uniforms.edge.value = mode === "wipe" ? share : 0;
    this.uniforms.backdrop.value = mode === "alone" ? 0 : 1;
    this.renderer.setRenderTarget(this.target);
    if (record && pose) {
      for (const { root, isHeld } of this.handles) root.visible = isHeld() && !clean;
      this.set.setPoses(pose, record.objects);
      this.setMotion(this.known, pose, motion);
      this.renderer.render(this.set.scene, this.set.camera);
    }
    this.renderer.setRenderTarget(null);
    this.renderer.render(this.shows, this.set.camera);
  }

  /**
   * Returns the last picture and the artwork at the pose, for comparison.
   * @param {PoseRecord} record
   * @param {Motion | null} motion
   * @returns {Pair | null}
   */
  pair(record, motion) {
    if (!this.target || !this.measured || !this.known || !record.pose) return null;
    const { width, height } = this.measured;
    this.set.setPoses(record.pose, record.objects);
    this.setMotion(this.known, record.pose, motion);
    this.renderer.setRenderTarget(this.target);
    this.renderer.render(this.artworks, this.set.camera);
    this.renderer.setRenderTarget(this.measured);
    this.renderer.render(this.compares, this.set.camera);
    const read = new Uint8Array(4 * width * height);
    this.renderer.readRenderTargetPixels(this.measured, 0, 0, width, height, read);
    this.renderer.setRenderTarget(null);
    const pair = { width, height, camera: new Float32Array(width * height), drawn: new Float32Array(width * height), covered: new Uint8Array(width * height) };
    for (let y = 0; y < height; y += 1) {
      for (let x = 0; x < width; x += 1) {
        const [from, to] = [4 * ((height - 1 - y) * width + x), y * width + x];
        pair.drawn[to] = read[from];
        pair.covered[to] = read[from + 1] > 253 ? 1 : 0;
        pair.camera[to] = read[from + 2];
      }
    }
    return pair;
  }

  dispose() {
    this.target?.dispose();
    this.measured?.dispose();
    this.picture.dispose();
    this.renderer.dispose();
  }
}

/** The picture without any bending, for where the lens shows no set. */
function wholePicture() {
  const shape = new BufferGeometry();
  const set = (/** @type {string} */ name, /** @type {number[]} */ values, size = 2) => shape.setAttribute(name, new BufferAttribute(new Float32Array(values), size));
  set("position", [-1, 1, 0, -1, -3, 0, 3, 1, 0], 3);
  set("raw", [0, 0, 0, 2, 2, 0]);
  return shape;
}
