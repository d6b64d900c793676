// Shaders, and binary glTF files (see skins.py for their attributes) as geometries and textures.
// Compiled for what is shown (LOOK, OTHER, HAS_UVS, DOUBTS, WRAPPED): values that no pixel needs took half of the time where
// the processor draws.
const SHOWS = '#define SHOWS(look) (LOOK == look || OTHER == look)\n';
export const VERTEX = `${SHOWS}
  attribute vec3 place, placeNormal, shown, plain; attribute vec2 own; attribute float trust;
  uniform float wrapAmount; uniform vec4 matched;
  varying vec3 vNormal, vPlace, vShown, vPlain; varying vec2 vUv, vOwn; varying float vTrust;
  void main() {
    vec3 p = position, n = normal;
    #if WRAPPED
      p = mix(position, place, wrapAmount); n = mix(normal, placeNormal, wrapAmount);
    #endif
    #if SHOWS(0) && HAS_UVS
      vUv = uv;
    #elif SHOWS(0)
      vShown = shown;
    #endif
    #if SHOWS(1) || SHOWS(2)
      vPlace = (place - matched.xyz) / matched.w;
    #endif
    #if SHOWS(3)
      vPlain = plain;
    #endif
    #if SHOWS(4)
      vOwn = own;
    #endif
    #if DOUBTS
      vTrust = trust;
    #endif
    vNormal = mat3(viewMatrix) * n;
    gl_Position = projectionMatrix * (viewMatrix * vec4(p, 1.0));
  }`;
export const FRAGMENT = `${SHOWS}
  uniform float split, opacity; uniform sampler2D picture, baked;
  varying vec3 vNormal, vPlace, vShown, vPlain; varying vec2 vUv, vOwn; varying float vTrust;
  float checker(vec3 at) {
    vec3 wave = abs(fract(at * 0.5) - 0.5) * 2.0 - 0.5, s = clamp(wave / max(fwidth(at) * 0.7, 1e-5), -1.0, 1.0);
    return 0.5 + 0.5 * s.x * s.y * s.z;
  }
  vec3 color(int at) {
    vec3 c = vec3(0.6);
    #if SHOWS(0) && HAS_UVS
      if (at == 0) c = texture2D(picture, vUv).rgb;
    #elif SHOWS(0)
      if (at == 0) c = vShown;
    #endif
    #if SHOWS(1)
      if (at == 1) c = (0.5 + 0.62 * vPlace) * mix(0.86, 1.0, checker(vPlace * 12.0));
    #endif
    #if SHOWS(2)
      if (at == 2) c = mix(vec3(0.93, 0.90, 0.84), vec3(0.20, 0.45, 0.55), checker(vPlace * 12.0));
    #endif
    #if SHOWS(3)
      if (at == 3) c = vPlain;
    #endif
    #if SHOWS(4)
      if (at == 4) c = texture2D(baked, vOwn).rgb;
    #endif
    return c;
  }
  void main() {
    int at = OTHER >= 0 && gl_FragCoord.x > split ? OTHER : LOOK;
    vec3 c = color(at);
    #if DOUBTS
      if (at < 3 && vTrust < 0.5) c = mix(c, vec3(0.9, 0.1, 0.1), 0.55);
    #endif
    vec3 n = normalize(gl_FrontFacing ? vNormal : -vNormal);
    float light = 0.36 + 0.14 * n.y + 0.60 * max(dot(n, normalize(vec3(-0.45, 0.65, 0.75))), 0.0)
      + 0.16 * max(dot(n, normalize(vec3(0.8, 0.1, 0.5))), 0.0);
    gl_FragColor = vec4(pow(min(pow(max(c, 0.0), vec3(2.2)) * light, 1.0), vec3(1.0 / 2.2)), opacity);
  }`;
export const LINES = [`attribute vec3 plain; varying vec3 vPlain;
  void main() { vPlain = plain; gl_Position = projectionMatrix * (viewMatrix * vec4(position, 1.0) + vec4(0.0, 0.0, 0.004, 0.0)); }`,
  'varying vec3 vPlain; void main() { gl_FragColor = vec4(vPlain, 1.0); }'];
// A picture with its depths, drawn before, onto the whole viewport.
export const COPY = ['varying vec2 vUv; void main() { vUv = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }',
  `varying vec2 vUv; uniform sampler2D picture; uniform highp sampler2D depths;
  void main() { gl_FragColor = texture2D(picture, vUv); gl_FragDepth = texture2D(depths, vUv).r; }`];
// Marks are drawn whole, or not at all: where their surface looks away, or a model is in front of their place.
export const MARKS = [`attribute vec3 place, placeNormal; attribute vec2 cell; uniform float wrapAmount, size; varying vec2 vCell;
  uniform highp sampler2D depths;
  void main() {
    vec3 p = mix(position, place, wrapAmount), n = mix(normal, placeNormal, wrapAmount);
    vec4 at = projectionMatrix * (viewMatrix * vec4(p, 1.0) + vec4(0.0, 0.0, 0.05, 0.0));
    vec3 seen = 0.5 + 0.5 * at.xyz / at.w;
    bool hidden = dot(n, normalize(cameraPosition - p)) < -0.4 || texture2D(depths, seen.xy).r < seen.z;
    vCell = cell; gl_PointSize = size; gl_Position = hidden ? vec4(2.0, 2.0, 2.0, 1.0) : at;
  }`,
  `uniform sampler2D atlas; uniform float cells; varying vec2 vCell;
  void main() {
    vec4 c = texture2D(atlas, (vCell + gl_PointCoord) / cells);
    if (c.a < 0.05) discard;
    gl_FragColor = c;
  }`];
const NAMES = {POSITION: 'position', NORMAL: 'normal', TEXCOORD_0: 'uv', TEXCOORD_1: 'own', COLOR_0: 'shown', COLOR_1: 'plain',
  _PLACE: 'place', _PLACE_NORMAL: 'placeNormal', _TRUST: 'trust'};
const ARRAYS = {5126: Float32Array, 5125: Uint32Array, 5123: Uint16Array}, COLUMNS = {SCALAR: 1, VEC2: 2, VEC3: 3};

export async function parsed(buffer) {
  const length = new DataView(buffer).getUint32(12, true), start = 28 + length;
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const array = number => {
    const {componentType, type, count, bufferView} = json.accessors[number], columns = COLUMNS[type];
    const offset = start + json.bufferViews[bufferView].byteOffset;
    return new THREE.BufferAttribute(new ARRAYS[componentType](buffer, offset, count * columns), columns);
  };
  const meshes = (json.meshes ?? []).map(({name, primitives: [part]}) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setIndex(array(part.indices));
    for (const [key, number] of Object.entries(part.attributes)) geometry.setAttribute(NAMES[key], array(number));
    return {name, geometry};
  });
  const images = Object.fromEntries(await Promise.all((json.images ?? []).map(async ({name, bufferView, mimeType}) => {
    const {byteOffset, byteLength} = json.bufferViews[bufferView];
    return [name, await createImageBitmap(new Blob([new Uint8Array(buffer, start + byteOffset, byteLength)], {type: mimeType}))];
  })));
  return {meshes, images};
}

const MAX_PART_RADIUS = 0.7;  // of the source's; larger matched parts count as the whole source
// Centre and radius of the source's matched part, which colours and checker span: of the target's trusted places.
export function matchedExtent(geometries) {
  const low = Array(3).fill(Infinity), high = Array(3).fill(-Infinity);
  for (const geometry of geometries.filter(one => one.getAttribute('place'))) {
    const places = geometry.getAttribute('place').array, trust = geometry.getAttribute('trust').array;
    for (let i = 0; i < places.length; i++) if (trust[Math.floor(i / 3)] >= 0.5) {
      low[i % 3] = Math.min(low[i % 3], places[i]);
      high[i % 3] = Math.max(high[i % 3], places[i]);
    }
  }
  const radius = Math.hypot(...high.map((end, k) => end - low[k])) / 2;
  return radius > 0 && radius < MAX_PART_RADIUS ? [...high.map((end, k) => (end + low[k]) / 2), radius] : [0, 0, 0, 1];
}

export function texture(image, small = false, anisotropy = 1) {
  const made = new THREE.Texture(image);
  Object.assign(made, {flipY: false, colorSpace: THREE.NoColorSpace, generateMipmaps: !small, anisotropy});
  if (small) made.minFilter = made.magFilter;
  else {
    made.minFilter = THREE.LinearMipmapLinearFilter;
    made.wrapS = made.wrapT = THREE.RepeatWrapping;
  }
  made.needsUpdate = true;
  return made;
}
