// Drawing: work out each splat once, sort by depth, then one triangle a splat, back to front. The
// triangles are one plain mesh: instances of a few vertices leave graphics processors idle and
// software ones crawling, and so does a second triangle for each.

function compile(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`The shaders don't compile here: ${gl.getProgramInfoLog(program)}`);
  }
  const uniform = new Proxy({}, { get: (known, name) => known[name] ??= gl.getUniformLocation(program, name) });
  return { program, uniform };
}

function texture(gl, [inner, format, type], data, width, height) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, type, data);
  return made;
}

const rowsOf = (items) => Math.max(1, Math.ceil(items / TEXTURE_WIDTH));
const wordFormat = (gl) => [gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT];

// Four words an item; item i is texel i.
function wordTexture(gl, words) {
  const height = rowsOf(words.length / 4);
  const padded = new Uint32Array(height * TEXTURE_WIDTH * 4);
  padded.set(words);
  return texture(gl, wordFormat(gl), padded, TEXTURE_WIDTH, height);
}

// At rest, three texels a splat: center (3 floats), colour and opacity (4 bytes) | rotation, sizes
// (11, 11 and 10 bits), 2 spare words | gradients of red, green and blue (3 bytes and a spare one
// each), a spare word.
function restWords(scene) {
  const words = new Uint32Array(scene.count * 12);
  const bytes = new Uint8Array(words.buffer);
  const centers = new Uint32Array(scene.centers.buffer);
  for (let i = 0; i < scene.count; i++) {
    const sizes = scene.sizes.subarray(3 * i, 3 * i + 3);
    words.set(centers.subarray(3 * i, 3 * i + 3), 12 * i);
    bytes.set(scene.colours.subarray(4 * i, 4 * i + 4), 48 * i + 12);
    words[12 * i + 4] = scene.rotations[i];
    words[12 * i + 5] = sizes[0] | sizes[1] << 11 | sizes[2] << 22;
    for (let k = 0; k < 3 && scene.shades.length; k++) {
      bytes.set(scene.shades.subarray(9 * i + 3 * k, 9 * i + 3 * k + 3), 48 * i + 32 + 4 * k);
    }
  }
  return words;
}

// A splat of a leg: if the halves agree, its colour at the other end and the lead (4 bytes), the
// gradients there (3 × 3 bytes) with the density of its stack in the first spare byte; then a texel
// a knot: the move (3 × 16 bit) and what the shape is deformed by, less the identity (9 × 8 bit).
function legWords({ count, moves, deforms, others, otherShades, densities }) {
  const knots = moves.length / 3 / Math.max(1, count);
  const agree = Number(others.length > 0);
  const words = new Uint32Array(count * (knots + agree) * 4);
  const shorts = new Int16Array(words.buffer);
  const bytes = new Int8Array(words.buffer);
  for (let i = 0; i < count; i++) {
    let at = i * (knots + agree);
    if (agree) {
      bytes.set(others.subarray(4 * i, 4 * i + 4), 16 * at);
      for (let k = 0; k < 3 && otherShades.length; k++) bytes.set(otherShades.subarray(9 * i + 3 * k, 9 * i + 3 * k + 3), 16 * at + 4 + 4 * k);
      bytes[16 * at++ + 7] = densities[i];
    }
    for (let k = i * knots; k < (i + 1) * knots; k++, at++) {
      shorts.set(moves.subarray(3 * k, 3 * k + 3), 8 * at);
      if (deforms.length) bytes.set(deforms.subarray(9 * k, 9 * k + 9), 16 * at + 6);
    }
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
    this.most = Math.max(...scene.legs.map((leg) => leg.count));
    this.sort = new DepthSort(this.most);
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false, premultipliedAlpha: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("This page draws with WebGL 2, which this browser does not offer or has switched off.");
    this.gl = gl;
    this.prepare();
  }

  // Everything that lives on the device; called again when the browser gives a lost device back.
  prepare() {
    const { gl, scene, most } = this;
    const rows = rowsOf(most);
    this.place = compile(gl, COVER, PLACE);
    this.span = compile(gl, SPAN, PROFILE);
    this.rest = wordTexture(gl, restWords(scene));
    this.moves = scene.legs.map((leg) => wordTexture(gl, legWords(leg)));
    this.ramp = null;
    this.order = texture(gl, [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT], null, TEXTURE_WIDTH, rows);
    this.outline = texture(gl, wordFormat(gl), null, TEXTURE_WIDTH, rows);
    this.shade = texture(gl, wordFormat(gl), null, TEXTURE_WIDTH, rows);
    this.placed = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.placed);
    [this.outline, this.shade].forEach((made, i) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, made, 0));
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);

    gl.useProgram(this.place.program);
    gl.uniform1i(this.place.uniform.uShades, Number(scene.shades.length > 0));
    gl.uniform1f(this.place.uniform.uShadeScale, scene.shadeScale);
    gl.uniform1f(this.place.uniform.uDensest, scene.densest);
    gl.uniform1i(this.place.uniform.uRampSteps, scene.rampSteps);
    gl.uniform2fv(this.place.uniform.uSizeRange, scene.sizeRange);
    gl.uniform2fv(this.place.uniform.uColourRange, scene.colourRange);

    gl.disable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(0, 0, 0, 0);
  }

  chooseRamp(ramp) {
    if (ramp === this.ramp) return;
    const { gl, scene } = this;
    gl.deleteTexture(this.fade ?? null);
    this.fades = rampRows(scene, ramp);
    this.fade = texture(gl, [gl.RG32F, gl.RG, gl.FLOAT], this.fades, 256, scene.rampSteps);
    this.ramp = ramp;
  }

  visible(view, leg, halves, weights) {
    const { scene, sort, fades } = this;
    const led = leadWeights(halves.weights);
    const agree = leg.others.length > 0;
    const [row, shift] = [view.rows[2], view.shift[2]];
    const [mx, my, mz] = row.map((v, i) => v * leg.moveScale[i]);
    // The depth of a center, x, y, z and 1, on either side.
    const planes = [[...row, shift], [0, 1, 2, 3].map((i) => dot(row, leg.base.map((line) => line[i])) + (i === 3 ? shift : 0))];
    const knots = weights.source.length;
    let count = 0;
    for (let own = 0; own < leg.count; own++) {
      const side = own < leg.sourceCount ? 0 : 1;
      const i = leg.first + own;
      const left = agree ? stackExponent(led[side][leg.others[4 * own + 3]], densityOf(scene, leg.densities[own])) : halves.weights[side];
      // Rising in the weight: what the next row doesn't show is not seen.
      const row = Math.ceil(left * (scene.rampSteps - 1));
      if (fades[2 * (256 * row + scene.colours[4 * i + 3])] < 1 / 255) continue;
      const w = side ? weights.target : weights.source;
      const plane = planes[side];
      let depth = plane[0] * scene.centers[3 * i] + plane[1] * scene.centers[3 * i + 1] + plane[2] * scene.centers[3 * i + 2] + plane[3];
      for (let k = 0, at = 3 * knots * own; k < knots; k++, at += 3) {
        depth += w[k] * (mx * leg.moves[at] + my * leg.moves[at + 1] + mz * leg.moves[at + 2]);
      }
      if (depth < view.near) continue;
      sort.depths[own] = depth;
      sort.found[count++] = own;
    }
    return { order: sort.run(count), count };
  }

  // ``few``: only so many splats, the first of the leg.
  draw(world, { t, ramp, part, few = Infinity }) {
    const at = legAt(this.scene, t);
    if (few < at.leg.count) at.leg = { ...at.leg, count: Math.round(few) };
    const view = movedView(world, at.leg.frame, at.t);
    const weights = moveWeights(at.leg, at.t);
    const halves = halvesAt(part, at.t);
    this.chooseRamp(ramp);
    const { order, count } = this.visible(view, at.leg, halves, weights);
    this.drawPlaces(view, at.leg, halves, weights);
    this.drawSpans(view, order, count);
  }

  use({ program, uniform }, textures) {
    const { gl } = this;
    gl.useProgram(program);
    Object.entries(textures).forEach(([name, held], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, held);
      gl.uniform1i(uniform[name], unit);
    });
    return uniform;
  }

  drawPlaces(view, leg, halves, weights) {
    const { gl } = this;
    const uniform = this.use(this.place, { uRest: this.rest, uMoves: this.moves[leg.index], uFade: this.fade });
    const padded = new Float32Array(2 * MAX_MOVES);
    padded.set(weights.source, 0);
    padded.set(weights.target, MAX_MOVES);
    gl.uniform1fv(uniform.uWeights, padded);
    gl.uniform2fv(uniform.uHalves, halves.weights);
    gl.uniform2fv(uniform.uGone, halves.gone);
    gl.uniform1i(uniform.uAgree, Number(leg.others.length > 0));
    gl.uniform1i(uniform.uMoveCount, weights.source.length);
    gl.uniform1i(uniform.uFirst, leg.first);
    gl.uniform1i(uniform.uSourceCount, leg.sourceCount);
    gl.uniform1i(uniform.uCount, leg.count);
    gl.uniform1i(uniform.uDeforms, Number(leg.deforms.length > 0));
    gl.uniformMatrix3fv(uniform.uBase, true, leg.base.flatMap((line) => line.slice(0, 3)));
    gl.uniform3fv(uniform.uBaseShift, leg.base.map((line) => line[3]));
    gl.uniform3fv(uniform.uMoveScale, leg.moveScale);
    gl.uniform1f(uniform.uDeformScale, leg.deformScale);
    gl.uniformMatrix3fv(uniform.uView, true, view.rows.flat());
    gl.uniform3fv(uniform.uShift, view.shift);
    gl.uniform3fv(uniform.uEye, view.eye);
    gl.uniform2f(uniform.uSize, view.width, view.height);
    gl.uniform2fv(uniform.uMiddle, view.middle);
    gl.uniform1f(uniform.uFocal, view.focal);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.placed);
    gl.viewport(0, 0, TEXTURE_WIDTH, rowsOf(leg.count));
    gl.disable(gl.BLEND);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  drawSpans(view, order, count) {
    const { gl } = this;
    const uniform = this.use(this.span, { uOutline: this.outline, uShade: this.shade, uOrder: this.order });
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rowsOf(count), gl.RED_INTEGER, gl.UNSIGNED_INT, order, 0);
    gl.uniform2f(uniform.uSize, view.width, view.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, view.width, view.height);
    gl.enable(gl.BLEND);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
  }
}
