export {
  BufferAttribute, BufferGeometry, DepthTexture, DoubleSide, LinearMipmapLinearFilter, LineSegments, Mesh, NoColorSpace,
  PerspectiveCamera, Points, Raycaster, RepeatWrapping, Scene, ShaderMaterial, Texture, Vector2, Vector3, WebGLRenderTarget,
  WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
