// A network of two hidden sine layers with derivatives, for 16 points at a time; the plain twin is
// Network.push in flows/network.py. A point has `channels` rows: its value, its derivatives along
// `directions`, and the second ones along `pairs` of those. Units lie along the registers.
constexpr int CHANNELS = 1 + DIRECTIONS + PAIRS, ROWS = LANES * CHANNELS;
constexpr int TALL = 8, WIDE = 2 * LANES;
typedef float Loose __attribute__((ext_vector_type(16), aligned(4)));
auto load = [](const float* from) -> Floats { return *(const Loose*)from; };
auto store = [](float* to, Floats value) { *(Loose*)to = value; };
auto add = [](float* to, Floats value) { *(Loose*)to += value; };
auto total = [](Floats v) -> float {
    const auto eight = v.lo + v.hi;
    const auto four = eight.lo + eight.hi;
    return (four.x + four.z) + (four.y + four.w);
};

struct Arguments {                      // the twin of jet.py's
    const float *first, *first_bias;    // width × INPUTS
    const float *second, *second_bias;  // width × width
    const float *last, *last_bias;      // OUTPUTS × width
    const float* from;                  // what the network or coupling is given
    float* to;                          // what it makes of it
    const float* turn;                  // DIM × DIM, before a coupling, or null
    const float* slope_to;              // ∂loss/∂to, and what follows from it:
    float *slope_from, *slope_weights;  // the latter parts × parameters
    long long points, width, parameters, moved;
    double first_omega, omega, bound;
};
const Arguments& given = *(const Arguments*)arguments;
const float *const first = given.first, *const second = given.second, *const last = given.last;
const int width = given.width;
const float first_omega = given.first_omega, omega = given.omega;
const long points = given.points, end = points * (part + 1) / parts;

float across[INPUTS * MOST_WIDTH];  // `first` with the units in a row
for (int k = 0; k < width; ++k)
    for (int n = 0; n < INPUTS; ++n) across[n * width + k] = first[k * INPUTS + n];

float turned[MOST_WIDTH * MOST_WIDTH];  // `second` likewise
for (int o = 0; o < width; ++o)
    for (int k = 0; k < width; ++k) turned[k * width + o] = second[o * width + k];

float x[CHANNELS * INPUTS * LANES];     // channels × inputs × points
float raw[CHANNELS * OUTPUTS * LANES];  // channels × outputs × points
struct Sines {                          // a layer's: points × channels × width
    float before[ROWS * MOST_WIDTH], after[ROWS * MOST_WIDTH];
    float slopes[LANES * MOST_WIDTH];  // g' at the value
} sines[2];

// Rows × points × components in memory, rows × components × 16 points at hand; zero beyond `count`.
auto gather = [&](const float* from, int size, int rows, long p, int count, float* block) {
    for (int c = 0; c < rows; ++c)
        for (int i = 0; i < LANES; ++i)
            for (int n = 0; n < size; ++n)
                block[(c * size + n) * LANES + i] =
                    i < count ? from[(c * points + p + i) * size + n] : 0.f;
};
auto scatter = [&](const float* block, int size, int rows, long p, int count, float* to) {
    for (int c = 0; c < rows; ++c)
        for (int i = 0; i < count; ++i)
            for (int n = 0; n < size; ++n)
                to[(c * points + p + i) * size + n] = block[(c * size + n) * LANES + i];
};

// out[i][j] (+)= Σₗ a[i * row + l * step] b[l][j], b and out `width` wide, `tall` rows of out.
auto multiply = [&](const float* a, int row, int step, const float* b, int count, float* out,
                    int tall, bool more) {
#pragma clang fp contract(fast)
    for (int j = 0; j < width; j += WIDE)
        for (int i = 0; i < tall; i += TALL) {
            Floats left[TALL], right[TALL];
            for (int r = 0; r < TALL; ++r) left[r] = right[r] = (Floats)0.f;
            const float* from = a + i * row;
            for (int l = 0; l < count; ++l, from += step) {
                const Floats u = load(b + l * width + j), v = load(b + l * width + j + LANES);
                for (int r = 0; r < TALL; ++r) {
                    left[r] += u * from[r * row];
                    right[r] += v * from[r * row];
                }
            }
            for (int r = 0; r < TALL; ++r) {
                float* const to = out + (i + r) * width + j;
                store(to, more ? load(to) + left[r] : left[r]);
                store(to + LANES, more ? load(to + LANES) + right[r] : right[r]);
            }
        }
};

// Rows h of g(z), `stride` apart, for a g of given values, slopes g' and bends g''.
auto push = [&](const float* z, float* h, int stride, Floats g, Floats slope, Floats bend) {
#pragma clang fp contract(fast)
    store(h, g);
    for (int d = 1; d <= DIRECTIONS; ++d) store(h + d * stride, slope * load(z + d * stride));
    for (int q = 0; q < PAIRS; ++q) {
        const int row = (1 + DIRECTIONS + q) * stride;
        const Floats i = load(z + (1 + PAIR[2 * q]) * stride);
        const Floats j = load(z + (1 + PAIR[2 * q + 1]) * stride);
        store(h + row, slope * load(z + row) + bend * i * j);
    }
};

auto push_sine = [&](Sines& layer, int i, float omega) {
    const int size = CHANNELS * width;
    for (int k = 0; k < width; k += LANES) {
        const float* const z = layer.before + i * size + k;
        Floats slope;
        const Floats g = sine_cosine(omega * load(z), slope);
        slope *= omega;
        push(z, layer.after + i * size + k, width, g, slope, -omega * omega * g);
        store(layer.slopes + i * width + k, slope);
    }
};

// From x through both layers to `raw`.
auto run_network = [&]() {
#pragma clang fp contract(fast)
    const int size = CHANNELS * width;
    for (int i = 0; i < LANES; ++i) {
        for (int c = 0; c < CHANNELS; ++c)
            for (int k = 0; k < width; k += LANES) {
                Floats sum = c ? (Floats)0.f : load(given.first_bias + k);
                for (int n = 0; n < INPUTS; ++n)
                    sum += load(across + n * width + k) * x[(c * INPUTS + n) * LANES + i];
                store(sines[0].before + i * size + c * width + k, sum);
            }
        push_sine(sines[0], i, first_omega);
    }
    multiply(sines[0].after, width, 1, turned, width, sines[1].before, ROWS, false);
    for (int i = 0; i < LANES; ++i) {
        for (int k = 0; k < width; k += LANES)
            add(sines[1].before + i * size + k, load(given.second_bias + k));
        push_sine(sines[1], i, omega);
        for (int c = 0; c < CHANNELS; ++c)
            for (int o = 0; o < OUTPUTS; ++o) {
                const float* const h = sines[1].after + i * size + c * width;
                Floats sum = (Floats)0.f;
                for (int k = 0; k < width; k += LANES)
                    sum += load(h + k) * load(last + o * width + k);
                raw[(c * OUTPUTS + o) * LANES + i] = total(sum) + (c ? 0.f : given.last_bias[o]);
            }
    }
};
