// Arrays of the models of a report: unpacked, spread, thinned; see models.py.
const ARRAYS = (() => {
  const CELLS = 44;  // of the grid that makes triangles fewer, along the unit ball

  async function inflate(text) {
    if (!('DecompressionStream' in window)) return null;
    const packed = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // One entry of the description as numbers; see _ArrayPacker of models.py.
  const reader = bytes => entry => {
    const {at, kind, count} = entry, columns = entry.columns ?? 1;
    if (kind === 'uint8') return bytes.subarray(at, at + count);
    const size = kind === 'int16' ? 2 : 4, whole = new Int32Array(count);
    for (let b = 0; b < size; b++)
      for (let i = 0, from = at + b * count; i < count; i++) whole[i] |= bytes[from + i] << (8 * b);
    if (size === 2) for (let i = 0; i < count; i++) whole[i] = whole[i] << 16 >> 16;
    for (let i = columns; i < count; i++) {
      whole[i] += whole[i - columns];
      if (size === 2) whole[i] = whole[i] << 16 >> 16;
    }
    if (entry.step === undefined) return whole;
    return Float32Array.from(whole, v => v * entry.step);
  };

  function spread(values, columns, copies, n) {  // values of vertices, also at their copies
    const out = new values.constructor((n + copies.length) * columns);
    out.set(values);
    copies.forEach((v, i) => {
      for (let c = 0; c < columns; c++) out[(n + i) * columns + c] = values[v * columns + c];
    });
    return out;
  }

  function normals(positions, triangles, copies, n) {  // smooth across copies
    const at = v => 3 * (v < n ? v : copies[v - n]), sum = new Float32Array(3 * n), p = positions;
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [at(triangles[t]), at(triangles[t + 1]), at(triangles[t + 2])];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const k of [a, b, c]) { sum[k] += x; sum[k + 1] += y; sum[k + 2] += z; }
    }
    for (let k = 0; k < sum.length; k += 3) {
      const length = Math.hypot(sum[k], sum[k + 1], sum[k + 2]) || 1;
      for (let c = 0; c < 3; c++) sum[k + c] /= length;
    }
    return sum;
  }

  // Vertices of one cell of a grid become one place, with a copy for each part of the texture.
  function thinned({geometry, triangles}) {
    const p = geometry.getAttribute('position').array, uv = geometry.getAttribute('uv').array;
    const places = new Map(), copies = new Map(), of = new Uint32Array(p.length / 3), own = [], first = [], kept = [];
    const cell = value => Math.floor((value + 2) * CELLS / 2) & 255, part = value => Math.round(value * 6) & 15;
    for (let i = 0; i < of.length; i++) {
      const at = (cell(p[3 * i]) << 16) | (cell(p[3 * i + 1]) << 8) | cell(p[3 * i + 2]);
      const key = at * 256 + part(uv[2 * i]) * 16 + part(uv[2 * i + 1]);
      if (!places.has(at)) places.set(at, i);
      if (!copies.has(key)) {
        copies.set(key, own.length);
        own.push(i);
        first.push(places.get(at));
      }
      of[i] = copies.get(key);
    }
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [of[triangles[t]], of[triangles[t + 1]], of[triangles[t + 2]]];
      if (first[a] !== first[b] && first[b] !== first[c] && first[c] !== first[a]) kept.push(a, b, c);
    }
    const small = new THREE.BufferGeometry();
    small.setIndex(new THREE.BufferAttribute(new Uint32Array(kept), 1));
    for (const [name, {array, itemSize, normalized}] of Object.entries(geometry.attributes)) {
      const from = name === 'uv' || name === 'tint' ? own : first, values = new array.constructor(itemSize * own.length);
      from.forEach((v, i) => { for (let c = 0; c < itemSize; c++) values[itemSize * i + c] = array[itemSize * v + c]; });
      small.setAttribute(name, new THREE.BufferAttribute(values, itemSize, normalized));
    }
    return small;
  }

  return {inflate, normals, reader, spread, thinned};
})();
