// Both models in one canvas: looks, comparison, overlay, marks, clicks, drags and cameras.
import {COPY, FRAGMENT, LINES, MARKS, matchedExtent, parsed, texture, VERTEX} from './gl.js';

const SIDES = ['target', 'source'];
const LOOKS = {texture: 0, colours: 1, checker: 2, plain: 3, baked: 4};
const FIELD_OF_VIEW = 0.6;  // radians, vertically: little perspective, as modellers like it
const FIRST = [1.85, 0.69, 2.64], AXES = {1: [0, 0, 1], 3: [1, 0, 0], 7: [0, 1, 0.001]};
// Added to a unit normal, one after the other, until its place is seen.
const TILTS = [[0, 0, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]];
const NO_BLENDING = 0, ALWAYS = 1;  // of three.js
// Pixels: square of a mark, from it to its number (an eye stays visible), how close grips it, what is no drag.
const MARK = 72, LEADER = 12, GRIP = 9, STILL = 4;

export class Views {
  // `handlers` has functions click, probe, move, select and hint for what is done to the models.
  constructor(root, handlers) {
    this.handlers = handlers;
    this.canvas = root.querySelector('canvas');
    this.tip = root.querySelector('#tip');
    const gl = document.createElement('canvas').getContext('webgl');
    const named = gl?.getExtension('WEBGL_debug_renderer_info');
    const renderer = String(gl?.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
    gl?.getExtension('WEBGL_lose_context')?.loseContext();
    // Without a graphics card the processor draws, beside the computation: smooth edges would double its work.
    this.slow = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
    this.renderer = new THREE.WebGLRenderer({canvas: this.canvas, antialias: !this.slow, alpha: true, preserveDrawingBuffer: true});
    this.renderer.autoClear = false;
    this.shown = {look: 'plain', other: '', split: 0.5, wrapAmount: 0, overlay: false, doubts: true, cages: false, numbers: true,
      linked: true, other_parts: true, pose: ''};
    [this.fit, this.matched] = [Math.hypot(...FIRST), [0, 0, 0, 1]];
    this.blank = texture(new ImageData(1, 1), true);
    [this.samples, this.anisotropy] = this.slow ? [0, 1] : [4, 8];
    this.sides = Object.fromEntries(SIDES.map(name => [name, this.side(name, root.querySelector(`#${name}`))]));
    new ResizeObserver(() => this.resize()).observe(root);
    this.canvas.addEventListener('webglcontextrestored', () => {
      for (const side of Object.values(this.sides)) side.pictureKey = '';
      this.changed();
    });
    this.resize();
  }

  side(name, pane) {
    const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW * 180 / Math.PI, 1, 0.01, 100);
    camera.position.set(...FIRST);
    const controls = new THREE.OrbitControls(camera, pane);
    Object.assign(controls, {enableDamping: false, minDistance: 0.15, maxDistance: 60});
    const depthTexture = new THREE.DepthTexture(1, 1), picture = new THREE.WebGLRenderTarget(1, 1, {depthTexture, samples: this.samples});
    const side = {name, pane, camera, controls, world: new THREE.Scene(), onScreen: new THREE.Scene(), picture, pictureKey: '', parts: {},
      images: {}, loaded: {}, marks: [], points: null, drawn: 0, tall: 0.5, wide: 0.5};
    side.onScreen.add(this.copy(picture));
    controls.addEventListener('change', () => this.turned(side));
    pane.addEventListener('pointerdown', event => this.pressed(side, event), {capture: true});
    pane.addEventListener('pointermove', event => this.moved(side, event));
    pane.addEventListener('pointerup', event => this.released(side, event));
    pane.addEventListener('pointercancel', () => this.cancelled(side));
    pane.addEventListener('pointerleave', () => { this.tip.hidden = true; });
    pane.addEventListener('keydown', event => this.key(side, event));
    return side;
  }

  // What draws a side's picture onto the canvas: one triangle that covers it.
  copy({texture, depthTexture}) {
    const geometry = new THREE.BufferGeometry(), values = (list, columns) => new THREE.BufferAttribute(new Float32Array(list), columns);
    geometry.setAttribute('position', values([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
    geometry.setAttribute('uv', values([0, 0, 2, 0, 0, 2], 2));
    const uniforms = {picture: {value: texture}, depths: {value: depthTexture}};
    const mesh = new THREE.Mesh(geometry, new THREE.ShaderMaterial({vertexShader: COPY[0], fragmentShader: COPY[1], uniforms,
      blending: NO_BLENDING, depthFunc: ALWAYS}));
    mesh.frustumCulled = false;
    return mesh;
  }

  // Shaders' values of a part; a part that has no values of some kind gets constant ones.
  part(side, {name, geometry}) {
    if (name === 'cage' || name === 'curves')
      return new THREE.LineSegments(geometry, new THREE.ShaderMaterial({vertexShader: LINES[0], fragmentShader: LINES[1]}));
    const n = geometry.getAttribute('position').count;
    const constant = (columns, value) => new THREE.BufferAttribute(new Float32Array(columns * n).fill(value), columns);
    const has = key => geometry.getAttribute(key);
    if (!has('plain')) geometry.setAttribute('plain', constant(3, 0.6));
    if (!has('shown')) geometry.setAttribute('shown', has('plain'));
    if (!has('place')) geometry.setAttribute('place', has('position'));
    if (!has('placeNormal')) geometry.setAttribute('placeNormal', has('normal'));
    const HAS_UVS = +!!has('uv');
    for (const key of ['uv', 'own']) if (!has(key)) geometry.setAttribute(key, constant(2, 0));
    if (!has('trust')) geometry.setAttribute('trust', constant(1, 1));
    const values = {split: 0, opacity: 1, picture: this.blank, baked: this.blank, wrapAmount: 0, matched: this.matched};
    const uniforms = Object.fromEntries(Object.entries(values).map(([key, value]) => [key, {value}]));
    const material = new THREE.ShaderMaterial({vertexShader: VERTEX, fragmentShader: FRAGMENT, side: THREE.DoubleSide, uniforms, defines: {HAS_UVS}});
    material.transparent = name === 'other_parts';
    return new THREE.Mesh(geometry, material);
  }

  // Fetch one kind of a side's drawings, unless it is what is there already; an answer that a newer one overtook is left.
  async load(name, kind, key) {
    const side = this.sides[name];
    if (side.loaded[kind] === key) return;
    side.loaded[kind] = key;
    const answer = await fetch(`drawn/${key}`).catch(() => ({ok: false}));  // the studio has ended
    if (!answer.ok || side.loaded[kind] !== key) {
      if (side.loaded[kind] === key) side.loaded[kind] = null;
      return;
    }
    const {meshes, images} = await parsed(await answer.arrayBuffer());
    if (side.loaded[kind] !== key) return;
    for (const [old, mesh] of Object.entries(side.parts)) if (mesh.kind === kind) {
      side.world.remove(mesh);
      mesh.geometry.dispose();
      mesh.material.dispose();
      delete side.parts[old];
    }
    if (kind === 'skin') {
      const own = meshes.filter(one => ['model', 'seams'].includes(one.name));  // one of them may have no triangle
      this.measure(side, own.map(one => one.geometry.getAttribute('position').array));
      if (name === 'target') this.matched = matchedExtent(own.map(one => one.geometry));
      for (const image of Object.values(side.images)) image.dispose();
      side.images = Object.fromEntries(Object.entries(images).map(([id, image]) => [id, texture(image, id === 'seams', this.anisotropy)]));
      side.drawn += 1;
    }
    for (const one of meshes) {
      const mesh = this.part(side, one);
      Object.assign(mesh, {kind, key});
      side.parts[one.name] = mesh;
      side.world.add(mesh);
    }
    this.changed();
  }

  forget() { for (const side of Object.values(this.sides)) side.loaded = {}; }

  set(shown) {
    if (Object.entries(shown).every(([key, value]) => this.shown[key] === value)) return;
    Object.assign(this.shown, shown);
    for (const {pane, controls} of Object.values(this.sides)) {
      const border = pane.querySelector('.border');
      border.hidden = !this.shown.other;
      border.style.left = `${100 * this.shown.split}%`;
    }
    this.changed();
  }

  // Landmarks of a side and the asked place: {number, name, color, at, place, solid, selected, wrong}; `at` and `place`
  // are position and normal here and on the other model.
  setMarks(name, marks) {
    const side = this.sides[name], ratio = this.renderer.getPixelRatio();
    const drawn = JSON.stringify([marks, this.shown.numbers, ratio]);
    if (side.dragged || side.drawnMarks === drawn) return;
    side.drawnMarks = drawn;
    side.marks = marks;
    const cell = MARK * ratio, cells = Math.ceil(Math.sqrt(marks.length)) || 1;
    const paper = document.createElement('canvas');
    paper.width = paper.height = cells * cell;
    const pen = paper.getContext('2d');
    pen.scale(ratio, ratio);
    marks.forEach((mark, i) => this.draw(pen, mark, MARK * (i % cells + 0.5), MARK * (Math.floor(i / cells) + 0.5)));
    if (side.points) {
      side.onScreen.remove(side.points);
      side.points.geometry.dispose();
      side.points.material.uniforms.atlas.value.dispose();
      side.points.material.dispose();
    }
    side.points = null;
    if (marks.length) {
      const geometry = new THREE.BufferGeometry();
      const values = (list, columns) => new THREE.BufferAttribute(new Float32Array(list.flat()), columns);
      for (const [name, of, from] of [['position', 'at', 0], ['normal', 'at', 3], ['place', 'place', 0], ['placeNormal', 'place', 3]])
        geometry.setAttribute(name, values(marks.map(mark => (mark[of] ?? mark.at).slice(from, from + 3)), 3));
      geometry.setAttribute('cell', values(marks.map((_, i) => [i % cells, Math.floor(i / cells)]), 2));
      const uniforms = {atlas: {value: texture(paper, true)}, cells: {value: cells}, size: {value: cell}, wrapAmount: {value: 0},
        depths: {value: side.picture.depthTexture}};
      const material = new THREE.ShaderMaterial({vertexShader: MARKS[0], fragmentShader: MARKS[1], uniforms, transparent: true,
        depthTest: false, depthWrite: false});
      side.points = new THREE.Points(geometry, material);
      side.points.frustumCulled = false;
      side.points.renderOrder = 2;
      side.onScreen.add(side.points);
    }
    this.changed();
  }

  draw(pen, {number, color, solid, selected, wrong}, x, y) {
    const radius = selected ? 6 : 4;
    pen.globalAlpha = solid ? 1 : 0.55;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fillStyle = wrong ? '#e02020' : color;
    pen.fill();
    pen.lineWidth = 1.5;
    pen.strokeStyle = selected ? '#fff' : '#000c';
    pen.stroke();
    if (!number || !this.shown.numbers) return;
    const text = `${number}${wrong ? '!' : solid ? '' : '?'}`;
    pen.globalAlpha = 1;
    pen.font = '600 10px system-ui, sans-serif';
    pen.lineJoin = 'round';
    pen.beginPath();
    pen.moveTo(x + 0.7 * radius, y - 0.7 * radius);
    pen.lineTo(x + LEADER - 1, y - LEADER + 1);
    for (const [width, color] of [[2.5, '#000b'], [1, '#fff']]) {
      Object.assign(pen, {lineWidth: width, strokeStyle: color});
      pen.stroke();
    }
    Object.assign(pen, {lineWidth: 2.5, strokeStyle: '#000b', fillStyle: '#fff'});
    pen.strokeText(text, x + LEADER, y - LEADER);
    pen.fillText(text, x + LEADER, y - LEADER);
  }

  // Cameras

  turned(side) {
    if (this.shown.linked) this.follow(side);
    this.changed();
  }

  follow(side) {
    for (const other of Object.values(this.sides)) if (other !== side) {
      other.camera.position.copy(side.camera.position);
      other.controls.target.copy(side.controls.target);
      other.camera.lookAt(other.controls.target);
    }
  }

  frame(direction = FIRST, sides = Object.values(this.sides)) {
    for (const {camera, controls} of sides) {
      controls.target.set(0, 0, 0);
      camera.position.set(...direction).setLength(this.fit);
      controls.update();
    }
    this.changed();
  }

  // Turn each model, or both as the target, until its place is seen: along its normal, or, where another part hides it, tilted;
  // from a little aside, as no camera looks straight down.
  reveal(places) {
    for (const side of this.shown.linked ? [this.sides.target] : Object.values(this.sides)) {
      if (!places[side.name] || this.shown.pose || this.wrapAmount(side)) continue;  // drawn elsewhere
      const at = new THREE.Vector3(...places[side.name].slice(0, 3)), seen = at.clone().project(side.camera);
      if (Math.max(...seen.toArray().map(Math.abs)) <= 1 && !this.hides(side, at)) continue;
      const look = tilt => {
        this.frame(places[side.name].slice(3).map((value, i) => value + tilt[i] + 0.1 * FIRST[i]), [side]);
        return !this.hides(side, at);
      };
      if (!TILTS.some(look)) look(TILTS[0]);
    }
  }

  // How far away both models fit into their panes while they turn about the vertical.
  measure(side, lists) {
    side.tall = side.wide = 0.1;
    for (const positions of lists) for (let i = 0; i < positions.length; i += 3) {
      side.tall = Math.max(side.tall, Math.abs(positions[i + 1]));
      side.wide = Math.max(side.wide, Math.hypot(positions[i], positions[i + 2]));
    }
    this.refit();
  }

  refit() {
    const before = this.fit, half = Math.tan(FIELD_OF_VIEW / 2), all = Object.values(this.sides);
    const tall = Math.max(...all.map(one => one.tall)), wide = Math.max(...all.map(one => one.wide));
    const aspect = Math.min(...all.map(one => one.camera.aspect));
    this.fit = Math.max(tall / 0.88, wide / 0.95 / aspect) / half + 0.4 * wide;
    // Computed for all before any moves: a camera that moves takes the linked one along.
    const moved = all.map(({camera, controls}) => camera.position.clone().sub(controls.target).multiplyScalar(this.fit / before));
    all.forEach(({camera, controls}, i) => {
      camera.position.copy(moved[i]).add(controls.target);
      controls.update();
    });
    this.changed();
  }

  key(side, event) {
    const step = {ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key];
    if (!step || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const away = side.camera.position.clone().sub(side.controls.target), flat = Math.hypot(away.x, away.z);
    const azimuth = Math.atan2(away.x, away.z) - step[0] * 0.17, length = away.length();
    const rise = Math.max(-1.5, Math.min(1.5, Math.atan2(away.y, flat) + step[1] * 0.17));
    away.set(Math.sin(azimuth) * Math.cos(rise), Math.sin(rise), Math.cos(azimuth) * Math.cos(rise)).multiplyScalar(length);
    side.camera.position.copy(side.controls.target).add(away);
    side.controls.update();
    this.turned(side);
  }

  viewAlong(key) { if (AXES[key]) this.frame(AXES[key]); }

  resize() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, this.slow ? 1 : 2));  // other on another screen
    this.renderer.setSize(width, height, false);
    for (const side of Object.values(this.sides)) {
      side.camera.aspect = side.pane.clientWidth / side.pane.clientHeight;
      side.camera.updateProjectionMatrix();
    }
    this.refit();
  }

  // Frames are drawn only when something has changed.
  changed() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.render();
    });
  }

  // Drawing both models takes a processor 0.2 s: the picture of each is drawn again only if that changes it, marks every time.
  render() {
    const height = this.canvas.clientHeight, left = this.canvas.getBoundingClientRect().left;
    this.renderer.setScissorTest(true);
    for (const side of Object.values(this.sides)) {
      const box = side.pane.getBoundingClientRect(), at = [box.left - left, height - box.height, box.width, box.height];
      this.drawPicture(side, at);
      this.renderer.setViewport(...at);
      this.renderer.setScissor(...at);
      this.renderer.clear();
      if (side.points) side.points.material.uniforms.wrapAmount.value = this.wrapAmount(side);
      this.renderer.render(side.onScreen, side.camera);
      if (side.name === 'target' && this.shown.overlay) {
        this.prepare(this.sides.source, at, 0.45);
        for (const only of [true, false]) {  // depths first: only the nearest surface is half transparent
          for (const mesh of Object.values(this.sides.source.parts)) mesh.material.colorWrite = !only;
          this.renderer.render(this.sides.source.world, side.camera);
        }
      }
    }
    this.frames = (this.frames ?? 0) + 1;
  }

  // A side's own models; the key has all that `prepare` and the camera read.
  drawPicture(side, [, , w, h]) {
    const {camera: {position, quaternion, projectionMatrix}, parts} = side, ratio = this.renderer.getPixelRatio();
    const {look, other, split, doubts, cages, other_parts, pose} = this.shown;
    const images = [side, this.sides.source].flatMap(one => Object.values(one.images));
    const key = JSON.stringify([w, h, ratio, position, quaternion, projectionMatrix, look, other, split, doubts, cages, other_parts, pose,
      this.wrapAmount(side), this.matched, [...Object.values(parts), ...images].map(one => one.uuid)]);
    if (side.pictureKey === key) return;
    side.pictureKey = key;
    side.picture.setSize(Math.max(1, Math.round(w * ratio)), Math.max(1, Math.round(h * ratio)));
    this.renderer.setRenderTarget(side.picture);
    this.renderer.clear();
    this.prepare(side, [0, 0, w], 1);
    this.renderer.render(side.world, side.camera);
    this.renderer.setRenderTarget(null);
  }

  // How far a side's model is on its way to its place on the other.
  wrapAmount(side) { return side.name === 'target' ? this.shown.wrapAmount : 0; }

  prepare(side, [x, , w], opacity) {
    const {shown} = this, over = opacity < 1, ratio = this.renderer.getPixelRatio();
    const wrapAmount = this.wrapAmount(side);
    for (const [name, mesh] of Object.entries(side.parts)) {
      const uniforms = mesh.material.uniforms;
      const still = !wrapAmount && !over && !shown.pose;
      mesh.visible = name === 'cage' ? shown.cages && still : name === 'curves' ? still : name !== 'other_parts' || (shown.other_parts && still);
      if (name === 'cage' || name === 'curves') continue;
      const picture = name === 'seams' ? side.images.seams : this.sides.source.images.texture ?? this.blank;
      const known = name => name === 'baked' && !side.images.baked ? (side.name === 'source' ? 'texture' : 'plain') : name;
      const values = {wrapAmount, picture, matched: this.matched, split: (x + shown.split * w) * ratio, baked: side.images.baked ?? this.blank,
        opacity: name === 'other_parts' ? 0.3 : opacity};
      for (const [key, value] of Object.entries(values)) uniforms[key].value = value;
      const LOOK = LOOKS[known(shown.look)], OTHER = shown.other ? LOOKS[known(shown.other)] : -1;
      this.define(mesh.material, {LOOK, OTHER, DOUBTS: +shown.doubts, WRAPPED: +(wrapAmount > 0)});
      mesh.material.transparent = over || name === 'other_parts';
    }
  }

  // A material is compiled again only for other constants.
  define(material, values) {
    material.needsUpdate ||= Object.entries(values).some(([key, value]) => material.defines[key] !== value);
    Object.assign(material.defines, values);
  }

  // Clicks and drags

  ray(side, event) {
    const box = side.pane.getBoundingClientRect();
    const at = new THREE.Vector2(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, side.camera);
    return ray;
  }

  hit(side, ray) {
    const meshes = ['model', 'seams'].map(name => side.parts[name]).filter(Boolean);
    return ray.intersectObjects(meshes)[0];
  }

  // The nearest visible landmark under the pointer.
  markAt(side, event) {
    const wrapAmount = this.wrapAmount(side);
    const box = side.pane.getBoundingClientRect(), v = new THREE.Vector3(), end = new THREE.Vector3();
    const near = [];
    for (const mark of side.marks) {
      if (!mark.number) continue;
      const [x, y, z] = mark.at, [px, py, pz] = mark.place ?? mark.at;
      const at = v.set(x, y, z).lerp(end.set(px, py, pz), wrapAmount).clone();
      v.project(side.camera);
      const away = Math.hypot((v.x + 1) / 2 * box.width + box.left - event.clientX, (1 - v.y) / 2 * box.height + box.top - event.clientY);
      if (away < GRIP) near.push({mark, at, away});
    }
    return near.sort((a, b) => a.away - b.away).find(({at}) => wrapAmount || !this.hides(side, at))?.mark ?? null;
  }

  // Whether a side's model is in front of a point.
  hides(side, at) {
    const ray = new THREE.Raycaster(side.camera.position.clone(), at.clone().sub(side.camera.position).normalize());
    ray.far = at.distanceTo(side.camera.position) - 0.06;
    return !!this.hit(side, ray);
  }

  pressed(side, event) {
    if (event.button !== 0) return;
    side.start = [event.clientX, event.clientY];
    const mark = this.markAt(side, event);
    if (!mark || !mark.solid || this.wrapAmount(side)) return;
    side.dragged = mark;
    side.controls.enabled = false;
    side.pane.setPointerCapture(event.pointerId);
  }

  moved(side, event) {
    if (side.dragged && !event.buttons) this.cancelled(side);  // it was released where the page does not see it
    if (side.dragged) {
      this.tip.hidden = true;
      const hit = this.hit(side, this.ray(side, event));
      if (hit) this.place(side, side.dragged, hit.point.toArray());
      return;
    }
    const mark = event.buttons ? null : this.markAt(side, event);
    this.tip.hidden = !mark;
    side.pane.style.cursor = mark ? 'grab' : '';
    if (!mark) return;
    const box = this.canvas.getBoundingClientRect();
    this.tip.textContent = mark.name;
    Object.assign(this.tip.style, {left: `${event.clientX - box.left}px`, top: `${event.clientY - box.top}px`});
  }

  place(side, mark, at) {
    const positions = side.points.geometry.getAttribute('position');
    positions.setXYZ(side.marks.indexOf(mark), at[0], at[1], at[2]);
    positions.needsUpdate = true;
    side.drawnMarks = null;
    this.changed();
  }

  // A drag that has no end, as when a dialog of the system takes the pointer, moves nothing.
  cancelled(side) {
    const mark = side.dragged;
    side.start = side.dragged = null;
    side.controls.enabled = true;
    if (mark) this.place(side, mark, mark.at);
  }

  released(side, event) {
    if (!side.start) return;
    const drag = Math.hypot(event.clientX - side.start[0], event.clientY - side.start[1]) > STILL, mark = side.dragged;
    side.start = side.dragged = null;
    side.controls.enabled = true;
    const {origin, direction} = this.ray(side, event).ray;
    const ray = {side: side.name, origin: origin.toArray(), direction: direction.toArray()};
    if (mark) {
      if (!drag) {
        this.place(side, mark, mark.at);  // a press that shook a little
        this.handlers.select(mark.number);
      }
      else if (this.hit(side, this.ray(side, event))) this.handlers.move({...ray, number: mark.number});
      else this.place(side, mark, mark.at);
      return;
    }
    if (drag) return;
    if (this.shown.pose) this.handlers.hint('Set Pose back to rest to place landmarks.');
    else if (this.shown.wrapAmount && side.name === 'target') this.handlers.hint('Set Wrap back to 0 to place landmarks.');
    else if (event.shiftKey) this.handlers.probe(ray);
    else {
      const over = this.markAt(side, event);
      if (over?.number) this.handlers.select(over.number);
      else if (this.hit(side, this.ray(side, event))) this.handlers.click(ray);
      else this.handlers.select(null);
    }
  }
}
