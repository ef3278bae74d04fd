// Splats at one moment of their way, 16 at a time: what lies between the knots, and colours that
// turn. The plain twin is `moment` in transport.py; the way colours turn is rotate_sh's, with the
// PROBES of a band and the INVERSE of its harmonics there. Compiled once for each DEGREE.
constexpr int LANES = 16, COEFFICIENTS = (DEGREE + 1) * (DEGREE + 1), NEAR = 4;
constexpr int ENTRIES = (DEGREE + 1) * (2 * DEGREE + 1) * (2 * DEGREE + 3) / 3;  // with degree 0
typedef float Floats __attribute__((ext_vector_type(16)));
typedef float Float4 __attribute__((ext_vector_type(4)));
typedef Float4 UnalignedFloat4 __attribute__((aligned(4)));

struct Path {
    const float* start;  // count × size
    const float* knots;  // near × count × size, those about the moment
};
struct Turns {
    const float* start;  // null, which is TURN 0 0 0
    const short* knots;  // near × count × 4
};
struct Arguments {                  // the twin of moment.py's
    Path means, quats, log_scales;  // of 3, 4 and 3; log scales may be null, as below
    Turns turns;
    const float *sh, *drift;  // count × COEFFICIENTS × 3, the latter or null
    float *means_out, *quats_out, *log_scales_out, *sh_out;
    long long count, near;
    float weights[NEAR], rest, way;  // of the knots, of the start, and of the drift
};
const Arguments& given = *(const Arguments*)arguments;
const long count = given.count;
const int near = (int)given.near;

auto between = [&](const auto& path, int size, int rows, long first, float* __restrict__ out) {
#pragma clang fp contract(fast)
    if (path.start)
        for (int i = 0; i < rows * size; ++i) out[i] = given.rest * path.start[first * size + i];
    else
        for (int i = 0; i < rows * size; ++i) out[i] = i % size ? 0.f : given.rest * TURN;
    const auto* __restrict__ from = path.knots + first * size;
    for (int k = 0; k < near; ++k, from += count * size) {
        const float weight = given.weights[k];
        for (int i = 0; i < rows * size; ++i) out[i] += weight * from[i];
    }
};

// Harmonics of one degree in the direction x, y, z, by the recurrence of harmonics().
auto band = [&](int degree, Floats x, Floats y, Floats z, Floats* out) {
#pragma clang fp contract(fast)
    Floats cosine = (Floats)1.f, sine = (Floats)0.f;
    float sectoral = 1.f;
#pragma unroll
    for (int m = 0; m <= degree; ++m) {
        Floats below = (Floats)0.f, legendre = (Floats)(sectoral * NORMS[degree * 5 + m]);
#pragma unroll
        for (int order = m; order < degree; ++order) {
            const Floats above = ((2.f * order + 1.f) * z * legendre - (float)(order + m) * below) *
                                 (1.f / (order + 1 - m));
            below = legendre;
            legendre = above;
        }
        out[degree - m] = legendre * sine;
        out[degree + m] = legendre * cosine;
        const Floats kept = cosine;
        cosine = x * cosine - y * sine;
        sine = x * sine + y * kept;
        sectoral *= -(2.f * m + 1.f);
    }
};

const long end = count * (part + 1) / parts;
for (long p = count * part / parts; p < end; p += LANES) {
#pragma clang fp contract(fast)
    const int lanes = end - p < LANES ? (int)(end - p) : LANES;
    between(given.means, 3, lanes, p, given.means_out + p * 3);
    between(given.quats, 4, lanes, p, given.quats_out + p * 4);
    if (given.log_scales.knots)
        between(given.log_scales, 3, lanes, p, given.log_scales_out + p * 3);
    float turn[LANES * 4];
    for (int i = 0; i < LANES * 4; ++i) turn[i] = i % 4 == 0;
    between(given.turns, 4, lanes, p, turn);
    Floats q[4], squared = (Floats)0.f;
    for (int i = 0; i < 4; ++i) {
        for (int l = 0; l < LANES; ++l) q[i][l] = turn[l * 4 + i];
        squared += q[i] * q[i];
    }
    const Floats two = 2.f / squared, w = q[0], x = q[1], y = q[2], z = q[3];
    const Floats rotation[3][3] = {
        {1.f - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)},
        {two * (x * y + w * z), 1.f - two * (x * x + z * z), two * (y * z - w * x)},
        {two * (x * z - w * y), two * (y * z + w * x), 1.f - two * (x * x + y * y)}};

    // Of each band the matrix that turns its coefficients, for 16 splats at once; then each splat
    // turns its own, which lie together in memory, three floats in one load of four.
    Floats turns[ENTRIES];
    Floats* matrix = turns;
    const float *probe = PROBES, *inverse = INVERSE;
#pragma unroll
    for (int degree = 1; degree <= DEGREE; ++degree) {
        const int size = 2 * degree + 1;
        Floats values[(2 * DEGREE + 1) * (2 * DEGREE + 1)];
        for (int j = 0; j < size; ++j, probe += 3) {
            Floats to[3];
            for (int i = 0; i < 3; ++i)
                to[i] = probe[0] * rotation[0][i] + probe[1] * rotation[1][i] +
                        probe[2] * rotation[2][i];
            band(degree, to[0], to[1], to[2], values + j * size);
        }
        for (int m = 0; m < size; ++m, inverse += size, matrix += size)
            for (int k = 0; k < size; ++k) {
                Floats sum = (Floats)0.f;
                for (int j = 0; j < size; ++j) sum += inverse[j] * values[j * size + k];
                matrix[k] = sum;
            }
    }
    const float* const entries = (const float*)turns;
    for (int l = 0; l < lanes; ++l) {
        const long row = (p + l) * COEFFICIENTS * 3;
        float* const out = given.sh_out + row;
        // The last coefficient of all has no fourth float behind it.
        float copy[COEFFICIENTS * 3 + 1];
        const float* colour = given.sh + row;
        if (given.drift || p + l == count - 1) {
            for (int k = 0; k < COEFFICIENTS * 3; ++k)
                copy[k] = colour[k] + (given.drift ? given.way * given.drift[row + k] : 0.f);
            copy[COEFFICIENTS * 3] = 0.f;
            colour = copy;
        }
        for (int c = 0; c < 3; ++c) out[c] = colour[c];
        const float* entry = entries + l;
#pragma unroll
        for (int degree = 1; degree <= DEGREE; ++degree) {
            const int first = degree * degree, size = 2 * degree + 1;
            for (int m = 0; m < size; ++m) {
                Float4 sum = (Float4)0.f;
                for (int k = 0; k < size; ++k, entry += LANES)
                    sum += *entry * *(const UnalignedFloat4*)(colour + (first + k) * 3);
                // Nor may it write into a splat of another thread.
                if (first + m + 1 < COEFFICIENTS)
                    *(UnalignedFloat4*)(out + (first + m) * 3) = sum;
                else
                    for (int c = 0; c < 3; ++c) out[(first + m) * 3 + c] = sum[c];
            }
        }
    }
}
