export {
  BufferAttribute, BufferGeometry, DoubleSide, LinearMipmapLinearFilter, LineSegments, Mesh, NoColorSpace,
  PerspectiveCamera, Points, Raycaster, RepeatWrapping, Scene, ShaderMaterial, Texture, Vector2, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
