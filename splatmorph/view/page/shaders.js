// The shaders: one works out every splat once, one spans its triangle, one draws the profile.

const TEXTURE_WIDTH = 2048;
const MAX_MOVES = 8;

// A triangle that covers the target.
const COVER = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

// A fragment a splat: center, longer axis in pixels | shorter axis, opacity, colour.
const PLACE = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D uRest, uMoves;
uniform highp sampler2D uFade;
uniform float uWeights[${2 * MAX_MOVES}];
uniform int uMoveCount, uFirst, uSourceCount, uCount, uDeforms, uShades, uAgree, uRampSteps;
uniform vec2 uHalves, uGone, uSizeRange, uColourRange, uSize, uMiddle;
uniform vec3 uMoveScale, uShift, uEye, uBaseShift;
uniform mat3 uView, uBase;
uniform float uFocal, uDeformScale, uShadeScale, uDensest;
layout(location = 0) out uvec4 outline;
layout(location = 1) out uvec4 shade;

ivec2 texel(int i) { return ivec2(i % ${TEXTURE_WIDTH}, i / ${TEXTURE_WIDTH}); }
float byteOf(uint word, int k) { return float(int(word << uint(24 - 8 * k)) >> 24); }
vec3 bytesOf(uint word) { return vec3(byteOf(word, 0), byteOf(word, 1), byteOf(word, 2)); }

vec3 rgb(uint word) { return vec3(uvec3(word, word >> 8u, word >> 16u) & 255u) / 255.0; }
mat3 gradients(uvec3 words) { return mat3(bytesOf(words.x), bytesOf(words.y), bytesOf(words.z)); }

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

// A step towards the rotation in the polar decomposition (Higham 1986): stretches s become
// (s + 1/s) / 2, the nearer to 1 the smaller they were.
mat3 unstretched(mat3 m) {
  float volume = determinant(m);
  if (abs(volume) < 1e-6) return m;
  return 0.5 * (m + transpose(inverse(m)));
}

void main() {
  int own = int(gl_FragCoord.y) * ${TEXTURE_WIDTH} + int(gl_FragCoord.x);
  if (own >= uCount) discard;
  int i = uFirst + own;
  int side = own < uSourceCount ? 0 : 1;
  uvec4 rest = texelFetch(uRest, texel(3 * i), 0);
  uvec4 form = texelFetch(uRest, texel(3 * i + 1), 0);

  vec3 move = vec3(0.0);
  mat3 deform = mat3(0.0);
  for (int k = 0; k < uMoveCount; k++) {
    uvec4 knot = texelFetch(uMoves, texel(own * (uMoveCount + uAgree) + uAgree + k), 0);
    float weight = uWeights[side * ${MAX_MOVES} + k];
    move += weight * vec3(ivec3(int(knot.x << 16) >> 16, int(knot.x) >> 16, int(knot.y << 16) >> 16));
    if (uDeforms == 1) {
      deform += weight * mat3(byteOf(knot.y, 2), byteOf(knot.y, 3), byteOf(knot.z, 0), byteOf(knot.z, 1), byteOf(knot.z, 2),
                              byteOf(knot.z, 3), byteOf(knot.w, 0), byteOf(knot.w, 1), byteOf(knot.w, 2));
    }
  }
  // The target's half is taken to the source's place before the flow takes it anywhere.
  mat3 base = side == 1 ? uBase : mat3(1.0);
  vec3 place = base * uintBitsToFloat(rest.xyz) + (side == 1 ? uBaseShift : vec3(0.0)) + uMoveScale * move;
  mat3 carried = mat3(1.0) + deform * uDeformScale;
  vec3 p = uView * place + uShift;

  // What it takes on of the other half: colour, and how much of it is left.
  float left = uHalves[side];
  uvec4 other = uvec4(0);
  vec3 colour = rgb(rest.w);
  if (uAgree == 1) {
    other = texelFetch(uMoves, texel(own * (1 + uMoveCount)), 0);
    float root = float(other.y >> 24u) / 255.0;
    left = exponent(left, float(other.x >> 24u) / 256.0, uDensest * root * root);
    colour = mix(colour, rgb(other.x), uGone[side]);
  }
  vec2 fade = faded(int(rest.w >> 24u), left);
  colour = mix(uColourRange.xxx, uColourRange.yyy, colour);
  if (uShades == 1) {
    // Colours turn with their splat: they are seen along the direction turned back.
    vec3 along = place - uEye;
    if (uDeforms == 1) along = along * unstretched(unstretched(carried));
    along = normalize(along * base);
    mat3 gradient = gradients(texelFetch(uRest, texel(3 * i + 2), 0).xyz);
    if (uAgree == 1) gradient += uGone[side] * (gradients(other.yzw) - gradient);
    colour += uShadeScale * (along * gradient);
  }

  vec3 steps = vec3(uvec3(form.y, form.y >> 11u, form.y >> 22u) & uvec3(2047u, 2047u, 1023u)) / vec3(2047.0, 2047.0, 1023.0);
  vec3 size = exp(fade.y + mix(uSizeRange.xxx, uSizeRange.yyy, steps));
  mat3 local = rotation(form.x);
  local = uView * carried * base * mat3(local[0] * size.x, local[1] * size.y, local[2] * size.z);

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
  vec2 pixel = uFocal * p.xy / p.z + uMiddle;
  outline = floatBitsToUint(vec4(pixel, axis * sqrt(middle + radius)));
  colour = max(colour, 0.0);
  shade = uvec4(floatBitsToUint(vec2(sqrt(max(middle - radius, 0.3)), fade.x)), packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, 0.0)));
}`;

const SPAN = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D uOrder, uOutline, uShade;
uniform vec2 uSize;
out vec2 at;
out vec4 tint;
ivec2 texel(int i) { return ivec2(i % ${TEXTURE_WIDTH}, i / ${TEXTURE_WIDTH}); }
void main() {
  ivec2 own = texel(int(texelFetch(uOrder, texel(gl_VertexID / 3), 0).r));
  vec4 outline = uintBitsToFloat(texelFetch(uOutline, own, 0));
  uvec4 shade = texelFetch(uShade, own, 0);
  float shorter = uintBitsToFloat(shade.x), opacity = uintBitsToFloat(shade.y);
  float reach = sqrt(max(0.0, 2.0 * log(255.0 * opacity)));
  // Of the triangle round the unit circle.
  int corner = gl_VertexID % 3;
  at = (corner == 2 ? vec2(0.0, 2.0) : vec2(corner == 0 ? -1.7320508 : 1.7320508, -1.0)) * reach;
  tint = vec4(unpackHalf2x16(shade.z), unpackHalf2x16(shade.w).x, opacity);
  vec2 longer = outline.zw;
  vec2 pixel = outline.xy + at.x * longer + at.y * shorter * normalize(vec2(-longer.y, longer.x));
  gl_Position = vec4((2.0 * pixel / uSize - 1.0) * vec2(1.0, -1.0), 0.0, 1.0);
}`;

const PROFILE = `#version 300 es
precision highp float;
in vec2 at;
in vec4 tint;
out vec4 colour;
void main() {
  float alpha = min(0.99, tint.a * exp(-0.5 * dot(at, at)));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(tint.rgb * alpha, alpha);
}`;
