// What the studio's pages use of three.js; `make studio-vendor` bundles it.
export {
  BufferAttribute, BufferGeometry, Frustum, GLSL3, InterleavedBuffer, InterleavedBufferAttribute,
  Matrix4, OrthographicCamera, PerspectiveCamera, Plane, Points, Ray, Raycaster, Scene,
  ShaderMaterial, Box3, Vector2, Vector3, WebGLRenderer, Color,
} from "three";
export { MapControls } from "three/examples/jsm/controls/MapControls.js";
