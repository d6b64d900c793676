// Models of a report that turn together. Reads #models (JSON) and #models-data (base64 of deflate); see models.py.
(async () => {
  const root = document.getElementById('viewer');
  const canvas = root.querySelector('canvas');
  const scene = JSON.parse(document.getElementById('models').textContent);
  const SIDES = ['source', 'target'];
  const FRAME_BUDGET = 33;  // milliseconds; slower machines get fewer triangles, then fewer pixels, while models move

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({canvas, antialias: true, alpha: true, preserveDrawingBuffer: true});
  } catch { return; }  // the still pictures stay

  const {inflate, normals, reader, spread, thinned} = ARRAYS;
  const bytes = await inflate(document.getElementById('models-data').textContent.trim());
  if (!bytes) return;
  const read = reader(bytes);

  const VERTEX = `
    attribute vec3 place; attribute vec3 tint; attribute float doubt;
    varying vec3 vNormal, vPlace, vTint; varying vec2 vUv; varying float vDoubt;
    void main() {
      vNormal = mat3(viewMatrix) * normal; vPlace = place; vTint = tint; vUv = uv; vDoubt = doubt;
      gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
    }`;
  const FRAGMENT = `
    uniform int look; uniform sampler2D picture; uniform vec3 cells; uniform vec3 ramp[6];
    varying vec3 vNormal, vPlace, vTint; varying vec2 vUv; varying float vDoubt;
    float checker(vec3 at, float sharp) {
      vec3 wave = abs(fract(at * 0.5) - 0.5) * 2.0 - 0.5;
      vec3 s = clamp(wave / max(fwidth(at) * sharp, 1e-5), -1.0, 1.0);
      return 0.5 + 0.5 * s.x * s.y * s.z;
    }
    vec3 color() {
      if (look == 0) return texture2D(picture, vUv).rgb;
      if (look == 1) return vTint;
      if (look == 2) return mix(vec3(0.93, 0.90, 0.84), vec3(0.20, 0.45, 0.55), checker(vPlace * cells, 0.7));
      if (look == 3) return (0.16 + 0.78 * clamp(vPlace, 0.0, 1.0)) * mix(0.86, 1.0, checker(vPlace * cells, 0.7));
      float at = clamp(vDoubt, 0.0, 1.0) * 5.0;
      int i = int(min(at, 4.0));
      return mix(ramp[i], ramp[i + 1], at - float(i));
    }
    void main() {
      vec3 n = normalize(gl_FrontFacing ? vNormal : -vNormal);
      float key = max(dot(n, normalize(vec3(-0.45, 0.65, 0.75))), 0.0);
      float fill = max(dot(n, normalize(vec3(0.8, 0.1, 0.5))), 0.0);
      float light = 0.34 + 0.14 * n.y + 0.62 * key + 0.16 * fill;
      vec3 c = pow(max(color(), 0.0), vec3(2.2)) * light;
      c += 0.045 * pow(1.0 - max(n.z, 0.0), 3.0);
      gl_FragColor = vec4(pow(min(c, 1.0), vec3(1.0 / 2.2)), 1.0);
    }`;
  const LOOKS = {picture: 0, own: 1, checker: 2, places: 3, doubt: 4};

  const sides = Object.fromEntries(SIDES.map(name => [name, model(name)]));

  function model(name) {
    const said = scene.sides[name], n = said.vertices;
    const copies = read(said.copies), triangles = read(said.triangles), rest = read(said.positions);
    const geometry = new THREE.BufferGeometry();
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(triangles), 1));
    const all = (values, columns, normalized = false) =>
      new THREE.BufferAttribute(spread(values, columns, copies, n), columns, normalized);
    geometry.setAttribute('position', all(rest, 3));
    geometry.setAttribute('normal', all(normals(rest, triangles, copies, n), 3));
    geometry.setAttribute('doubt', all(read(said.doubt), 1, true));
    let places;
    if (said.places) places = read(said.places);
    else {
      const m = said.places_of_positions;
      places = new Float32Array(3 * n);
      for (let i = 0; i < 3 * n; i += 3)
        for (let r = 0; r < 3; r++)
          places[i + r] = m[3 * r] * rest[i] + m[3 * r + 1] * rest[i + 1] + m[3 * r + 2] * rest[i + 2] + m[9 + r];
    }
    geometry.setAttribute('place', all(places, 3));
    const drawn = n + copies.length;
    geometry.setAttribute('uv', new THREE.BufferAttribute(said.uvs ? read(said.uvs) : new Float32Array(2 * drawn), 2));
    const keyed = said.key_colors && new THREE.BufferAttribute(read(said.key_colors), 3, true);
    geometry.setAttribute('tint', keyed ?? new THREE.BufferAttribute(new Uint8Array(3 * drawn), 3, true));
    const material = new THREE.ShaderMaterial({
      vertexShader: VERTEX, fragmentShader: FRAGMENT, side: THREE.DoubleSide,
      uniforms: {
        look: {value: 2}, picture: {value: null}, cells: {value: new THREE.Vector3(...scene.cells)},
        ramp: {value: scene.ramp.map(c => new THREE.Vector3(...c))},
      },
    });
    const mesh = new THREE.Mesh(geometry, material), world = new THREE.Scene();
    world.add(mesh);
    const dots = points(said.landmarks);
    if (dots) world.add(dots);
    const tints = scene.looks.map(look => !look[name]?.kind ? null
      : all(read(look[name]), 3, true));
    return {name, n, copies, triangles, rest, places, geometry, material, mesh, world, dots, keyed, tints, box: null};
  }

  function points(landmarks) {
    if (!landmarks.length) return null;
    const geometry = new THREE.BufferGeometry();
    const flat = landmarks.flatMap(([x, y, z, nx, ny, nz]) => [x + 0.004 * nx, y + 0.004 * ny, z + 0.004 * nz]);
    geometry.setAttribute('position', new THREE.BufferAttribute(new Float32Array(flat), 3));
    const colors = new Uint8Array(scene.landmark_colors.flat());
    geometry.setAttribute('tint', new THREE.BufferAttribute(colors, 3, true));
    const material = new THREE.ShaderMaterial({
      uniforms: {size: {value: 10}},
      vertexShader: `attribute vec3 tint; varying vec3 vTint; uniform float size;
        void main() { vTint = tint; gl_PointSize = size;
          gl_Position = projectionMatrix * (viewMatrix * vec4(position, 1.0) + vec4(0.0, 0.0, 0.04, 0.0)); }`,
      fragmentShader: `varying vec3 vTint;
        void main() {
          float r = length(gl_PointCoord - 0.5) * 2.0;
          if (r > 1.0) discard;
          gl_FragColor = vec4(r > 0.72 ? vec3(0.08, 0.10, 0.13) : vTint, 1.0);
        }`,
    });
    return new THREE.Points(geometry, material);
  }

  // One camera for both: the models lie in unit balls, and each is seen in its own half.
  const camera = new THREE.PerspectiveCamera(28, 1, 0.1, 100);
  const controls = new THREE.OrbitControls(camera, canvas);
  Object.assign(controls, {enableDamping: true, dampingFactor: 0.12, enableZoom: false, minDistance: 0.4, maxDistance: 14});
  const VIEWS = {start: [35, 12], front: [0, 4], side: [90, 4], back: [180, 4]};
  // What must fit in while both turn about the vertical.
  let fit = 4.2, tall = 0.1, wide = 0.1;
  for (const {rest} of Object.values(sides))
    for (let i = 0; i < rest.length; i += 3) {
      tall = Math.max(tall, Math.abs(rest[i + 1]));
      wide = Math.max(wide, Math.hypot(rest[i], rest[i + 2]));
    }

  function lookFrom(azimuth, elevation, at = [0, 0, 0], distance = fit) {
    const [a, e] = [azimuth * Math.PI / 180, elevation * Math.PI / 180], damped = controls.enableDamping;
    controls.enableDamping = false;
    controls.update();  // ends the motion that a drag has left: it would turn the new view
    controls.enableDamping = damped;
    controls.target.set(...at);
    camera.position.set(
      at[0] + distance * Math.sin(a) * Math.cos(e), at[1] + distance * Math.sin(e),
      at[2] + distance * Math.cos(a) * Math.cos(e));
    controls.update();
    changed();
  }

  // Below a width, one model above the other.
  function layout() {
    const {clientWidth: width, clientHeight: height} = canvas, stacked = width < 620;
    const w = stacked ? width : width / 2, h = stacked ? height / 2 : height;
    SIDES.forEach((name, i) => { sides[name].box = {x: stacked ? 0 : i * w, y: stacked ? i * h : 0, w, h}; });
    camera.aspect = w / h;
    const before = fit;
    const tangent = Math.tan(14 * Math.PI / 180);
    fit = Math.max(tall / 0.9, wide / 0.95 / camera.aspect) / tangent + 0.4 * wide;
    camera.position.sub(controls.target).multiplyScalar(fit / before).add(controls.target);
    camera.updateProjectionMatrix();
    root.classList.toggle('stacked', stacked);
    resolution(ratio);
  }

  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  function resolution(value) {
    const {clientWidth: width, clientHeight: height} = canvas;
    renderer.setPixelRatio(value);
    renderer.setSize(width, height, false);
    for (const side of Object.values(sides)) if (side.dots) side.dots.material.uniforms.size.value = 10 * value;
    changed();
  }

  function draw() {
    const height = canvas.clientHeight;
    renderer.setScissorTest(true);
    for (const {box, world} of Object.values(sides)) {
      renderer.setViewport(box.x, height - box.y - box.h, box.w, box.h);
      renderer.setScissor(box.x, height - box.y - box.h, box.w, box.h);
      renderer.render(world, camera);
    }
    labels();
  }

  const hidden = new Set();  // pins

  // Frames are drawn only when something has changed. Slow machines draw fewer triangles and pixels while models move.
  let waiting = false, turned = false, still = 0, slow = 0, last = 0, weak = false, coarse = false;
  function changed() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(frame);
  }
  function frame(now) {
    waiting = false;
    const moving = controls.update() || turned;
    turned = false;
    if (moving && weak && !coarse) {
      detail(true);
      resolution(ratio / 1.5);
    }
    draw();
    slow = last && moving && now - last > FRAME_BUDGET && now - last < 2000 ? slow + 1 : 0;
    last = moving ? now : 0;
    if (slow >= 3 && !weak) {
      weak = true;
      controls.enableDamping = false;
    }
    hidden.clear();
    clearTimeout(still);
    still = setTimeout(rest, 200);
  }
  function rest() {
    if (waiting) return;
    if (coarse) {
      detail(false);
      resolution(ratio);
    } else occluded();
  }

  function detail(low) {
    if (coarse === low) return;
    coarse = low;
    for (const side of Object.values(sides)) {
      if (low) side.thin ??= thinned(side);
      side.mesh.geometry = low ? side.thin : side.geometry;
    }
  }
  function renewed() {  // another look or shape
    for (const side of Object.values(sides)) {
      side.mesh.geometry = side.geometry;
      side.thin?.dispose();
      side.thin = null;
    }
    coarse = false;
    resolution(ratio);
  }
  controls.addEventListener('change', () => { turned = true; changed(); });

  // Numbers on the models.
  const layer = root.querySelector('.layer'), v = new THREE.Vector3();
  const pins = scene.marks.map(mark => {
    const pin = document.createElement('button');
    pin.type = 'button';
    pin.className = 'pin';
    pin.textContent = mark.number;
    pin.setAttribute('aria-label', `Mark ${mark.number} on the ${mark.side}: ${mark.text}`);
    pin.title = mark.text;
    pin.addEventListener('click', () => show(mark.side, mark.place));
    layer.append(pin);
    return {side: mark.side, place: mark.place, pin};
  });
  const rings = Object.fromEntries(SIDES.map(name => {
    const ring = document.createElement('span');
    ring.className = 'ring';
    ring.hidden = true;
    layer.append(ring);
    return [name, ring];
  }));
  const tip = document.createElement('span');
  tip.className = 'tip';
  tip.hidden = true;
  layer.append(tip);

  function screen(side, [x, y, z]) {
    const {box} = sides[side];
    v.set(x, y, z).project(camera);
    return [box.x + (v.x + 1) / 2 * box.w, box.y + (1 - v.y) / 2 * box.h, box];
  }
  function labels() {
    for (const {side, place, pin} of pins) {
      const [x, y, box] = screen(side, place);
      const [nx, ny, nz] = place.slice(3);
      const facing = (camera.position.x - place[0]) * nx + (camera.position.y - place[1]) * ny
        + (camera.position.z - place[2]) * nz > 0;
      const inside = x > box.x && x < box.x + box.w && y > box.y && y < box.y + box.h;
      pin.style.transform = `translate(${x}px, ${y}px) translate(-50%, -50%)`;
      pin.classList.toggle('behind', !facing || hidden.has(pin));
      pin.hidden = !inside || shape !== 0;
    }
  }

  // Once all is still, pins behind other parts of their model are found.
  const toPin = new THREE.Raycaster();
  function occluded() {
    hidden.clear();
    for (const {side, place, pin} of pins) {
      const at = new THREE.Vector3(...place), away = at.distanceTo(camera.position);
      toPin.set(camera.position, at.sub(camera.position).normalize());
      toPin.far = away - 0.03;
      if (toPin.intersectObject(sides[side].mesh).length) hidden.add(pin);
    }
    labels();
  }

  // Turn to a place so that it faces the eye, and come closer.
  function show(side, place) {
    const [x, y, z, nx, ny, nz] = place;
    const flat = Math.hypot(nx, nz);
    const azimuth = flat > 0.2 ? Math.atan2(nx, nz) * 180 / Math.PI : 35;
    const elevation = Math.max(-50, Math.min(65, Math.atan2(ny, flat) * 180 / Math.PI * 0.8));
    lookFrom(azimuth, elevation, [x, y, z], 0.42 * fit);
    root.scrollIntoView({block: 'nearest', behavior: matchMedia('(prefers-reduced-motion: reduce)').matches ? 'auto' : 'smooth'});
  }

  // What both are coloured by.
  const legend = root.querySelector('.legend');
  const images = new Map();
  async function picture(id) {  // of an image of its own: one in a closed fold may have no size
    const image = new Image();
    image.src = document.getElementById(id).src;
    await image.decode();
    const texture = new THREE.Texture(image);
    Object.assign(texture, {colorSpace: THREE.NoColorSpace, generateMipmaps: true, anisotropy: 8});
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.needsUpdate = true;
    images.set(id, texture);
  }
  function showLook(number) {
    const look = scene.looks[number];
    for (const side of Object.values(sides)) {
      const own = look[side.name], uniforms = side.material.uniforms;
      if (typeof own === 'string') {
        uniforms.look.value = LOOKS.picture;
        uniforms.picture.value = images.get(own);
      } else {
        uniforms.look.value = LOOKS[look.kind];
        const tint = side.tints[number] ?? (look.kind === 'own' ? side.keyed : null);
        if (tint) side.geometry.setAttribute('tint', tint);
      }
    }
    legend.textContent = look.legend;
    renewed();
  }
  root.querySelectorAll('input[name=look]').forEach(input =>
    input.addEventListener('change', () => showLook(Number(input.value))));

  let shape = 0;
  function showShape(number) {
    shape = number;
    for (const side of Object.values(sides)) {
      const entry = number ? scene.shapes[number - 1][side.name] : null;
      const positions = entry ? read(entry) : side.rest;
      const {geometry, copies, triangles, n} = side;
      geometry.getAttribute('position').copyArray(spread(positions, 3, copies, n)).needsUpdate = true;
      geometry.getAttribute('normal').copyArray(spread(normals(positions, triangles, copies, n), 3, copies, n)).needsUpdate = true;
      geometry.computeBoundingSphere();
    }
    dotsShown();
    renewed();
  }
  root.querySelector('select')?.addEventListener('change', event => showShape(Number(event.target.value)));

  const dotted = root.querySelector('input[name=landmarks]');
  function dotsShown() {
    for (const side of Object.values(sides)) if (side.dots) side.dots.visible = dotted.checked && shape === 0;
    changed();
  }
  dotted?.addEventListener('change', dotsShown);

  // The place under the pointer, and its counterpart.
  const ray = new THREE.Raycaster();
  let pointed = null;
  canvas.addEventListener('pointermove', event => {
    if (event.buttons || event.pointerType === 'touch') return hide();
    const first = pointed === null;
    pointed = event;
    if (first) requestAnimationFrame(() => { const at = pointed; pointed = null; if (at) point(at); });
  });
  canvas.addEventListener('pointerleave', hide);
  canvas.addEventListener('pointerdown', hide);
  function hide() { pointed = null; for (const name of SIDES) rings[name].hidden = true; tip.hidden = true; }
  function point(event) {
    const rect = canvas.getBoundingClientRect(), x = event.clientX - rect.left, y = event.clientY - rect.top;
    const side = Object.values(sides).find(({box}) => x >= box.x && x < box.x + box.w && y >= box.y && y < box.y + box.h);
    if (!side) return hide();
    const {box} = side;
    ray.setFromCamera(new THREE.Vector2(2 * (x - box.x) / box.w - 1, 1 - 2 * (y - box.y) / box.h), camera);
    const hit = ray.intersectObject(side.mesh)[0];
    if (!hit) return hide();
    const other = sides[side.name === 'source' ? 'target' : 'source'];
    const at = interpolated(side, hit), partner = nearest(other, at);
    put(rings[side.name], side.name, hit.point.toArray());
    put(rings[other.name], other.name, partner);
    named(side, x, y);
  }
  function put(ring, name, place) {
    const [x, y] = screen(name, place);
    ring.hidden = false;
    ring.style.transform = `translate(${x}px, ${y}px) translate(-50%, -50%)`;
  }
  function interpolated(side, hit) {  // its place on the source, as the map says
    const corners = [hit.face.a, hit.face.b, hit.face.c], attribute = side.geometry.getAttribute('position');
    const p = corners.map(c => new THREE.Vector3().fromBufferAttribute(attribute, c));
    const area = (a, b, c) => b.clone().sub(a).cross(c.clone().sub(a)).length();
    const w = [area(hit.point, p[1], p[2]), area(p[0], hit.point, p[2]), area(p[0], p[1], hit.point)];
    const total = w[0] + w[1] + w[2] || 1, places = side.geometry.getAttribute('place').array;
    return [0, 1, 2].map(k => corners.reduce((sum, c, i) => sum + w[i] / total * places[3 * c + k], 0));
  }
  function nearest(side, [x, y, z]) {
    const {places, n} = side, positions = side.geometry.getAttribute('position').array;
    const [sx, sy, sz] = scene.cells;
    let best = Infinity, found = 0;
    for (let i = 0; i < n; i++) {
      const dx = (places[3 * i] - x) * sx, dy = (places[3 * i + 1] - y) * sy, dz = (places[3 * i + 2] - z) * sz;
      const d = dx * dx + dy * dy + dz * dz;
      if (d < best) { best = d; found = i; }
    }
    return [positions[3 * found], positions[3 * found + 1], positions[3 * found + 2]];
  }
  function named(side, x, y) {
    tip.hidden = true;
    if (!side.dots?.visible) return;
    scene.sides[side.name].landmarks.forEach((place, i) => {
      const [px, py] = screen(side.name, place);
      const facing = camera.position.clone().sub(v.set(...place)).dot(new THREE.Vector3(...place.slice(3))) > 0;
      if (facing && Math.hypot(px - x, py - y) < 9) {
        tip.hidden = false;
        tip.textContent = scene.landmarks[i];
        tip.style.transform = `translate(${px}px, ${py - 22}px) translate(-50%, -50%)`;
      }
    });
  }

  // Keys and buttons.
  const STEP = 10 * Math.PI / 180;
  function turn(azimuth, elevation) {
    const offset = camera.position.clone().sub(controls.target), r = offset.length();
    const a = Math.atan2(offset.x, offset.z) + azimuth;
    const e = Math.max(-1.5, Math.min(1.5, Math.asin(offset.y / r) + elevation));
    lookFrom(a * 180 / Math.PI, e * 180 / Math.PI, controls.target.toArray(), r);
  }
  function closer(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    changed();
  }
  const KEYS = {
    ArrowLeft: () => turn(-STEP, 0), ArrowRight: () => turn(STEP, 0), ArrowUp: () => turn(0, STEP),
    ArrowDown: () => turn(0, -STEP), '+': () => closer(0.85), '=': () => closer(0.85), '-': () => closer(1 / 0.85),
    f: () => lookFrom(...VIEWS.start), 1: () => lookFrom(...VIEWS.front), 3: () => lookFrom(...VIEWS.side),
  };
  canvas.addEventListener('keydown', event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
    event.preventDefault();
    root.classList.remove('pointed');
    KEYS[event.key]();
  });
  // The wheel scrolls the page until the models are clicked.
  canvas.addEventListener('focus', () => { controls.enableZoom = true; });
  canvas.addEventListener('blur', () => { controls.enableZoom = false; });
  canvas.addEventListener('pointerdown', () => { root.classList.add('pointed'); canvas.focus(); });
  root.querySelectorAll('button[data-view]').forEach(button =>
    button.addEventListener('click', () => lookFrom(...VIEWS[button.dataset.view])));
  document.querySelectorAll('button[data-mark]').forEach(button => button.addEventListener('click', () => {
    const mark = scene.marks[Number(button.dataset.mark)];
    show(mark.side, mark.place);
  }));
  document.querySelectorAll('button[data-landmark]').forEach(button => button.addEventListener('click', () => {
    show('target', scene.sides.target.landmarks[Number(button.dataset.landmark)]);
  }));
  canvas.addEventListener('webglcontextlost', () => document.documentElement.classList.remove('turns'));

  const worn = scene.looks.flatMap(look => SIDES.map(name => look[name])).filter(own => typeof own === 'string');
  await Promise.all(worn.map(picture));
  document.documentElement.classList.add('turns');
  new ResizeObserver(layout).observe(canvas);
  layout();
  lookFrom(...VIEWS.start);
  showLook(0);
  dotted && dotsShown();

  root.dataset.ready = 'yes';
})();
addEventListener('beforeprint', () => document.querySelectorAll('details').forEach(one => { one.open = true; }));
