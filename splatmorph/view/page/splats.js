// Drawing: sort by depth, then one quad a splat, back to front. The quads are one plain mesh:
// instances of four vertices leave graphics processors idle and software ones crawling.

const TEXTURE_WIDTH = 2048;
const MAX_MOVES = 8;

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D uRest, uMoves, uOrder;
uniform highp sampler2D uFade;
uniform float uWeights[${2 * MAX_MOVES}];
uniform int uMoveCount, uSourceCount, uDeforms, uRampSteps;
uniform vec2 uLogScale, uSize, uMiddle;
uniform vec2 uHalves, uGone;
uniform vec3 uMoveScale, uShift;
uniform mat3 uView;
uniform float uFocal, uColour, uDeformScale;
out vec2 at;
out vec4 tint;

ivec2 texel(int i) { return ivec2(i % ${TEXTURE_WIDTH}, i / ${TEXTURE_WIDTH}); }
float byteOf(uint word, int k) { return float(int(word << uint(24 - 8 * k)) >> 24); }

vec3 rgb(uint word) { return vec3(uvec3(word, word >> 8u, word >> 16u) & 255u) / 255.0; }

// How much of a splat is left where so much of its half is.
float exponent(float weight, float lead, float density) {
  if (weight <= 0.0 || weight >= 1.0) return weight;
  float swing = 4.0 * weight * (1.0 - weight);
  float odds = log(weight / (1.0 - weight)) + swing * swing * log(lead / (1.0 - lead));
  float led = 1.0 / (1.0 + exp(-odds));
  return density > 0.0 ? -log(1.0 - led * (1.0 - exp(-density))) / density : led;
}

vec2 faded(int opacity, float weight) {
  float at = weight * float(uRampSteps - 1);
  int row = min(int(at), uRampSteps - 2);
  vec2 low = texelFetch(uFade, ivec2(opacity, row), 0).rg, high = texelFetch(uFade, ivec2(opacity, row + 1), 0).rg;
  return mix(low, high, at - float(row));
}

mat3 rotation(uint word) {
  vec3 small = (vec3(uvec3(word, word >> 10u, word >> 20u) & 1023u) / 511.0 - 1.0) * 0.70710678;
  float large = sqrt(max(0.0, 1.0 - dot(small, small)));
  uint place = word >> 30u;
  vec4 q = place == 0u ? vec4(large, small) : place == 1u ? vec4(small.x, large, small.yz)
         : place == 2u ? vec4(small.xy, large, small.z) : vec4(small, large);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

void main() {
  int i = int(texelFetch(uOrder, texel(gl_VertexID >> 2), 0).r);
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  int side = i < uSourceCount ? 0 : 1;
  uvec4 rest = texelFetch(uRest, texel(2 * i), 0);
  uvec4 form = texelFetch(uRest, texel(2 * i + 1), 0);

  vec3 move = vec3(0.0);
  mat3 deform = mat3(0.0);
  for (int k = 0; k < uMoveCount; k++) {
    uvec4 knot = texelFetch(uMoves, texel(i * uMoveCount + k), 0);
    float weight = uWeights[side * ${MAX_MOVES} + k];
    move += weight * vec3(ivec3(int(knot.x << 16) >> 16, int(knot.x) >> 16, int(knot.y << 16) >> 16));
    if (uDeforms == 1) {
      deform += weight * mat3(byteOf(knot.y, 2), byteOf(knot.y, 3), byteOf(knot.z, 0), byteOf(knot.z, 1), byteOf(knot.z, 2),
                              byteOf(knot.z, 3), byteOf(knot.w, 0), byteOf(knot.w, 1), byteOf(knot.w, 2));
    }
  }
  vec3 p = uView * (uintBitsToFloat(rest.xyz) + uMoveScale * move) + uShift;

  float left = exponent(uHalves[side], float(form.z >> 24u) / 256.0, uintBitsToFloat(form.w));
  vec2 fade = faded(int(rest.w >> 24u), left);
  float opacity = fade.x;
  tint = vec4(mix(rgb(rest.w), rgb(form.z), uGone[side]) * uColour, opacity);

  vec3 steps = vec3(float(form.y & 2047u) / 2047.0, float((form.y >> 11u) & 2047u) / 2047.0, float(form.y >> 22u) / 1023.0);
  vec3 scale = exp(fade.y + mix(uLogScale.xxx, uLogScale.yyy, steps));
  mat3 local = rotation(form.x);
  local = uView * (mat3(1.0) + deform * uDeformScale) * mat3(local[0] * scale.x, local[1] * scale.y, local[2] * scale.z);

  // EWA: the projection's Jacobian at p, its slopes clamped to 1.3 times the field of view.
  vec2 margin = 0.15 * uSize;
  vec2 slope = clamp(p.xy / p.z, (-margin - uMiddle) / uFocal, (uSize + margin - uMiddle) / uFocal);
  float f = uFocal / p.z;
  mat3 m = transpose(local);
  vec3 u = f * (m[0] - slope.x * m[2]);
  vec3 v = f * (m[1] - slope.y * m[2]);
  float a = dot(u, u) + 0.3, b = dot(u, v), c = dot(v, v) + 0.3;

  float middle = 0.5 * (a + c), radius = length(vec2(0.5 * (a - c), b));
  vec2 axis = radius < 1e-6 * middle ? vec2(1.0, 0.0) : normalize(a > c ? vec2(radius + 0.5 * (a - c), b) : vec2(b, radius + 0.5 * (c - a)));
  float reach = sqrt(max(0.0, 2.0 * log(255.0 * opacity)));
  at = corner * reach;
  vec2 pixel = uFocal * p.xy / p.z + at.x * sqrt(middle + radius) * axis + at.y * sqrt(max(middle - radius, 0.3)) * vec2(-axis.y, axis.x);
  gl_Position = vec4((2.0 * (pixel + uMiddle) / uSize - 1.0) * vec2(1.0, -1.0), 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
in vec4 tint;
out vec4 colour;
void main() {
  float alpha = min(0.99, tint.a * exp(-0.5 * dot(at, at)));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(tint.rgb * alpha, alpha);
}`;

function compile(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`The shaders don't compile here: ${gl.getProgramInfoLog(program)}`);
  }
  gl.useProgram(program);
  return program;
}

function texture(gl, unit, [inner, format, type], data, width, height) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, type, data);
}

const rowsOf = (items) => Math.max(1, Math.ceil(items / TEXTURE_WIDTH));

// Four words an item; item i is texel i.
function wordTexture(gl, unit, words) {
  const height = rowsOf(words.length / 4);
  const padded = new Uint32Array(height * TEXTURE_WIDTH * 4);
  padded.set(words);
  texture(gl, unit, [gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT], padded, TEXTURE_WIDTH, height);
}

// At rest: center (3 floats), colour and opacity (4 bytes) | rotation, log scales, the colour at
// the other end and the lead (4 bytes), the density of the stack (float).
function restWords(scene) {
  const words = new Uint32Array(scene.count * 8);
  const floats = new Float32Array(words.buffer);
  const centers = new Uint32Array(scene.centers.buffer, scene.centers.byteOffset, scene.centers.length);
  for (let i = 0; i < scene.count; i++) {
    words.set(centers.subarray(3 * i, 3 * i + 3), 8 * i);
    words[8 * i + 3] = scene.colours[i];
    words[8 * i + 4] = scene.rotations[i];
    words[8 * i + 5] = scene.logScales[i];
    words[8 * i + 6] = scene.others[i];
    floats[8 * i + 7] = scene.density(i);
  }
  return words;
}

// A knot: the move (3 × 16 bit) and what the shape is deformed by, less the identity (9 × 8 bit).
function moveWords(scene) {
  const items = scene.moves.length / 3;
  const words = new Uint32Array(items * 4);
  const shorts = new Int16Array(words.buffer);
  const bytes = new Int8Array(words.buffer);
  for (let i = 0; i < items; i++) {
    shorts.set(scene.moves.subarray(3 * i, 3 * i + 3), 8 * i);
    if (scene.deforms.length) bytes.set(scene.deforms.subarray(9 * i, 9 * i + 9), 16 * i + 6);
  }
  return words;
}

// Far to near, by the bits of the float32 depth: exact, two passes of 16 bits.
class DepthSort {
  constructor(count) {
    this.depths = new Float32Array(count);
    this.bits = new Uint32Array(this.depths.buffer);
    // Whole rows of the texture that takes the order.
    const room = rowsOf(count) * TEXTURE_WIDTH;
    this.found = new Uint32Array(room);
    this.order = new Uint32Array(room);
    this.tally = new Uint32Array(65536);
  }

  run(count) {
    this.pass(this.found, this.order, count, 0);
    this.pass(this.order, this.found, count, 16);
    return this.found;
  }

  pass(from, to, count, shift) {
    const { tally, bits } = this;
    tally.fill(0);
    for (let i = 0; i < count; i++) tally[(bits[from[i]] >>> shift) & 65535]++;
    for (let key = 65535, start = 0; key >= 0; key--) [tally[key], start] = [start, start + tally[key]];
    for (let i = 0; i < count; i++) to[tally[(bits[from[i]] >>> shift) & 65535]++] = from[i];
  }
}

class SplatPainter {
  constructor(canvas, scene) {
    this.scene = scene;
    this.canvas = canvas;
    this.sort = new DepthSort(scene.count);
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false, premultipliedAlpha: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("This page draws with WebGL 2, which this browser does not offer or has switched off.");
    this.gl = gl;
    this.prepare();
  }

  // Everything that lives on the device; called again when the browser gives a lost device back.
  prepare() {
    const { gl, scene } = this;
    const program = compile(gl);
    this.uniform = new Proxy({}, { get: (known, name) => known[name] ??= gl.getUniformLocation(program, name) });
    wordTexture(gl, 0, restWords(scene));
    wordTexture(gl, 1, moveWords(scene));
    this.ramp = null;
    texture(gl, 3, [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT], null, TEXTURE_WIDTH, rowsOf(scene.count));
    ["uRest", "uMoves", "uFade", "uOrder"].forEach((name, unit) => gl.uniform1i(this.uniform[name], unit));
    gl.uniform1i(this.uniform.uMoveCount, scene.knots.length - 1);
    gl.uniform1i(this.uniform.uSourceCount, scene.source.count);
    gl.uniform1i(this.uniform.uRampSteps, scene.rampSteps);
    gl.uniform1i(this.uniform.uDeforms, Number(scene.deforms.length > 0));
    gl.uniform2fv(this.uniform.uLogScale, scene.logScaleRange);
    gl.uniform3fv(this.uniform.uMoveScale, scene.moveScale);
    gl.uniform1f(this.uniform.uDeformScale, scene.deformScale);
    gl.uniform1f(this.uniform.uColour, scene.colourScale);

    const mesh = new Uint32Array(6 * scene.count);
    for (let i = 0; i < scene.count; i++) mesh.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 2, 4 * i + 1, 4 * i + 3], 6 * i);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh, gl.STATIC_DRAW);

    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(0, 0, 0, 0);
  }

  visible(view, halves, weights) {
    const { scene, sort, fades } = this;
    const led = leadWeights(halves.weights);
    const [rx, ry, rz] = view.rows[2];
    const [mx, my, mz] = [rx, ry, rz].map((v, i) => v * scene.moveScale[i]);
    const knots = scene.knots.length - 1;
    let count = 0;
    for (let i = 0; i < scene.count; i++) {
      const side = i < scene.source.count ? 0 : 1;
      const left = stackExponent(led[side][scene.others[i] >>> 24], scene.density(i));
      // Rising in the weight: what the next row doesn't show is not seen.
      const row = Math.ceil(left * (scene.rampSteps - 1));
      if (fades[2 * (256 * row + (scene.colours[i] >>> 24))] < 1 / 255) continue;
      const w = side ? weights.target : weights.source;
      let depth = rx * scene.centers[3 * i] + ry * scene.centers[3 * i + 1] + rz * scene.centers[3 * i + 2] + view.shift[2];
      for (let k = 0, at = 3 * knots * i; k < knots; k++, at += 3) {
        depth += w[k] * (mx * scene.moves[at] + my * scene.moves[at + 1] + mz * scene.moves[at + 2]);
      }
      if (depth < scene.camera.near) continue;
      sort.depths[i] = depth;
      sort.found[count++] = i;
    }
    return { order: sort.run(count), count };
  }

  draw(view, { t, ramp, part }) {
    const { gl, scene } = this;
    const weights = moveWeights(scene, t);
    const halves = halvesAt(part, t);
    if (ramp !== this.ramp) {
      this.fades = rampRows(scene, ramp);
      texture(gl, 2, [gl.RG32F, gl.RG, gl.FLOAT], this.fades, 256, scene.rampSteps);
      this.ramp = ramp;
    }
    const { order, count } = this.visible(view, halves, weights);
    gl.viewport(0, 0, view.width, view.height);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.activeTexture(gl.TEXTURE3);
    const rows = rowsOf(count);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, order, 0);
    const padded = new Float32Array(2 * MAX_MOVES);
    padded.set(weights.source, 0);
    padded.set(weights.target, MAX_MOVES);
    gl.uniform1fv(this.uniform.uWeights, padded);
    gl.uniform2fv(this.uniform.uHalves, halves.weights);
    gl.uniform2fv(this.uniform.uGone, halves.gone);
    gl.uniformMatrix3fv(this.uniform.uView, true, view.rows.flat());
    gl.uniform3fv(this.uniform.uShift, view.shift);
    gl.uniform2f(this.uniform.uSize, view.width, view.height);
    gl.uniform2fv(this.uniform.uMiddle, view.middle);
    gl.uniform1f(this.uniform.uFocal, view.focal);
    gl.drawElements(gl.TRIANGLES, 6 * count, gl.UNSIGNED_INT, 0);
  }
}
