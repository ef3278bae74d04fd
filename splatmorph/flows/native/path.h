// Runge-Kutta paths of dx/dt = v(x), 16 points at a time; the plain twin is flows/node.py.
// Compiled once for each (DIM, JACOBIAN): the state of a point is x, and ∂Φ/∂x where asked.
// v = affine part + spline over `count` centers + a SIREN with two hidden layers of `width`.
constexpr int STATE = DIM + JACOBIAN * DIM * DIM;
struct Arguments {          // the twin of path.py's
    const float* starts;    // points × DIM
    const float* affine;    // (1 + DIM) × DIM: velocity at 0, then slopes
    const float* spline;    // centers × (center, weight)
    const float* network;   // see below
    float *states, *rates;  // knots × points × STATE, of every so many steps; rates may be null
    long long points, centers, width, steps, every;
    double rounding_squared, h;
};
const Arguments& given = *(const Arguments*)arguments;
const float* const affine = given.affine;
const long points = given.points, steps = given.steps, every = given.every;
const int count = given.centers, width = given.width;
const float rounding_squared = given.rounding_squared, h = given.h;

auto logarithm = [](Floats x) -> Floats {
// Cephes' polynomial on [sqrt(1/2), sqrt(2)): relative error 1e-7.
#pragma clang fp contract(fast)
    Ints bits = *(Ints*)&x;
    const Ints exponent = (bits - 0x3f3504f3) >> 23;
    bits -= exponent << 23;
    const Floats f = *(Floats*)&bits - 1.f, ff = f * f;
    const float c[] = {-1.1514610310e-1f, 1.1676998740e-1f, -1.2420140846e-1f, 1.4249322787e-1f,
                       -1.6668057665e-1f, 2.0000714765e-1f, -2.4999993993e-1f, 3.3333331174e-1f};
    Floats p = (Floats)7.0376836292e-2f;
    for (int i = 0; i < 8; ++i) p = p * f + c[i];
    const Floats e = __builtin_convertvector(exponent, Floats);
    return e * 0.693359375f + (f * ff * p + (e * -2.12194440e-4f - 0.5f * ff) + f);
};

// The network is stored with its ω multiplied into the weights.
const float* const first = given.network;                // width × (DIM weights, bias)
const float* const second = first + width * (DIM + 1);   // width × (width weights, bias)
const float* const last = second + width * (width + 1);  // width × DIM, then DIM biases

// Layer 1 and its derivatives, [1 + JACOBIAN * DIM][MOST_WIDTH].
constexpr int TANGENTS = JACOBIAN * DIM, BLOCK = 4;
Floats hidden[1 + TANGENTS][MOST_WIDTH];

auto rate = [&](const Floats* state, Floats* out) {
#pragma clang fp contract(fast)
    Floats v[DIM], slope[DIM][DIM];
    for (int i = 0; i < DIM; ++i) {
        v[i] = (Floats)affine[i];
        for (int j = 0; j < DIM; ++j) {
            slope[i][j] = (Floats)affine[(1 + j) * DIM + i];
            v[i] += slope[i][j] * state[j];
        }
    }
    for (int k = 0; k < count; ++k) {
        const float* const center = given.spline + k * 2 * DIM;
        const float* const weight = center + DIM;
        Floats offset[DIM], squared = (Floats)rounding_squared;
        for (int i = 0; i < DIM; ++i) {
            offset[i] = state[i] - center[i];
            squared += offset[i] * offset[i];
        }
        Floats kernel, gradient;
        if constexpr (DIM == 3) {
            kernel = -__builtin_elementwise_sqrt(squared);
            if constexpr (JACOBIAN) gradient = 1.f / kernel;
        } else {
            const Floats l = logarithm(squared);
            kernel = 0.5f * squared * l;
            if constexpr (JACOBIAN) gradient = l + 1.f;
        }
        for (int i = 0; i < DIM; ++i) {
            v[i] += kernel * weight[i];
            if constexpr (JACOBIAN) {
                const Floats pull = gradient * weight[i];
                for (int j = 0; j < DIM; ++j) slope[i][j] += pull * offset[j];
            }
        }
    }
    if (width) {
        for (int o = 0; o < width; ++o) {
            const float* const w = first + o * (DIM + 1);
            Floats z = (Floats)w[DIM];
            for (int j = 0; j < DIM; ++j) z += state[j] * w[j];
            Floats turn;
            hidden[0][o] = sine_cosine(z, turn);
            if constexpr (JACOBIAN) {
                for (int j = 0; j < DIM; ++j) hidden[1 + j][o] = turn * w[j];
            }
        }
        for (int i = 0; i < DIM; ++i) v[i] += last[width * DIM + i];
        for (int o = 0; o < width; o += BLOCK) {
            Floats z[1 + TANGENTS][BLOCK];
            for (int b = 0; b < BLOCK; ++b) {
                z[0][b] = (Floats)second[(o + b) * (width + 1) + width];
                for (int j = 0; j < TANGENTS; ++j) z[1 + j][b] = (Floats)0.f;
            }
            for (int k = 0; k < width; ++k)
                for (int b = 0; b < BLOCK; ++b) {
                    const float w = second[(o + b) * (width + 1) + k];
                    for (int j = 0; j <= TANGENTS; ++j) z[j][b] += hidden[j][k] * w;
                }
            for (int b = 0; b < BLOCK; ++b) {
                const float* const w = last + (o + b) * DIM;
                Floats turn;
                const Floats h = sine_cosine(z[0][b], turn);
                for (int i = 0; i < DIM; ++i) v[i] += h * w[i];
                if constexpr (JACOBIAN) {
                    for (int j = 0; j < DIM; ++j) {
                        const Floats along = turn * z[1 + j][b];
                        for (int i = 0; i < DIM; ++i) slope[i][j] += along * w[i];
                    }
                }
            }
        }
    }
    for (int i = 0; i < DIM; ++i) out[i] = v[i];
    if constexpr (JACOBIAN)
        for (int i = 0; i < DIM; ++i)
            for (int j = 0; j < DIM; ++j) {
                Floats sum = (Floats)0.f;
                for (int l = 0; l < DIM; ++l) sum += slope[i][l] * state[DIM + l * DIM + j];
                out[DIM + i * DIM + j] = sum;
            }
};

const long begin = points * part / parts / LANES * LANES;
const long end = part + 1 == parts ? points : points * (part + 1) / parts / LANES * LANES;
for (long p = begin; p < end; p += LANES) {
#pragma clang fp contract(fast)
    const int lanes = end - p < LANES ? (int)(end - p) : LANES;
    Floats x[STATE], k1[STATE], k[STATE], sum[STATE], next[STATE];
    for (int i = 0; i < DIM; ++i)
        for (int l = 0; l < LANES; ++l) x[i][l] = given.starts[(p + (l < lanes ? l : 0)) * DIM + i];
    for (int i = DIM; i < STATE; ++i) x[i] = (Floats)((i - DIM) % (DIM + 1) == 0 ? 1.f : 0.f);
    auto save = [&](float* to, const Floats* from, long knot) {
        float* const row = to + (knot * points + p) * STATE;
        for (int l = 0; l < lanes; ++l)
            for (int i = 0; i < STATE; ++i) row[l * STATE + i] = from[i][l];
    };
    rate(x, k1);
    for (int n = 0; n < steps; ++n) {
        if (n % every == 0) {
            save(given.states, x, n / every);
            if (given.rates) save(given.rates, k1, n / every);
        }
        for (int i = 0; i < STATE; ++i) {
            sum[i] = k1[i];
            next[i] = x[i] + 0.5f * h * k1[i];
        }
        rate(next, k);
        for (int i = 0; i < STATE; ++i) {
            sum[i] += 2.f * k[i];
            next[i] = x[i] + 0.5f * h * k[i];
        }
        rate(next, k);
        for (int i = 0; i < STATE; ++i) {
            sum[i] += 2.f * k[i];
            next[i] = x[i] + h * k[i];
        }
        rate(next, k);
        for (int i = 0; i < STATE; ++i) x[i] += (h / 6.f) * (sum[i] + k[i]);
        if (given.rates || n + 1 < steps) rate(x, k1);
    }
    save(given.states, x, steps / every);
    if (given.rates) save(given.rates, k1, steps / every);
}
