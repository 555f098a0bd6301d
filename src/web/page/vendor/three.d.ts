// What the page uses of three.js. `remake` makes three.js from it, as one module without the rest,
// and the type checker knows three.js by it.
export {
  AmbientLight, Box3, BoxGeometry, BufferAttribute, BufferGeometry, ConeGeometry, DirectionalLight, DoubleSide, GLSL3, GridHelper, Group, HalfFloatType,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, LoadingManager, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, NearestFilter, NoBlending, NoColorSpace,
  Object3D, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Quaternion, RawShaderMaterial, Raycaster, RGBAFormat, Scene, ShadowMaterial, Texture, TextureLoader,
  Vector2, Vector3, Vector4, WebGLRenderer, WebGLRenderTarget,
} from "three";
export { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
export { TransformControls } from "three/addons/controls/TransformControls.js";
