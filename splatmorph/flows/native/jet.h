// A network of two hidden sine layers with derivatives, for 16 points at a time; the plain twin is
// Network.push in flows/network.py. A point has `channels` rows: its value, its derivatives along
// `directions`, and the second ones along `pairs` of those. Units lie along the registers.
constexpr int TALL = 8, WIDE = 2 * LANES, MOST_CHANNELS = 10, MOST_INPUTS = 8, MOST_WIDTH = 256;
constexpr int ROWS = LANES * MOST_CHANNELS;
typedef float Loose __attribute__((ext_vector_type(16), aligned(4)));
auto load = [](const float* from) -> Floats { return *(const Loose*)from; };
auto store = [](float* to, Floats value) { *(Loose*)to = value; };
auto add = [](float* to, Floats value) { *(Loose*)to += value; };
auto total = [](Floats v) -> float {
    const auto eight = v.lo + v.hi;
    const auto four = eight.lo + eight.hi;
    return (four.x + four.z) + (four.y + four.w);
};

struct Arguments {                                         // the twin of jet.py's
    const float *first, *first_bias;                       // width × inputs
    const float *second, *second_bias;                     // width × width
    const float *last, *last_bias;                         // outputs × width
    const int* pair;                                       // pairs × 2 directions
    const float* from;                                     // what the network or coupling is given
    float* to;                                             // what it makes of it
    float* kept;                                           // points × channels × width, or null
    const float* slope_to;                                 // ∂loss/∂to, and what follows from it:
    float *slope_from, *slope_weights;
    const int* outer_pair;                                 // a coupling's jet, see coupling.h
    long points, inputs, width, outputs, directions, pairs, outer_directions, outer_pairs, moved;
    double first_omega, omega, bound;
};
const Arguments& given = *(const Arguments*)arguments;
const float *const first = given.first, *const second = given.second, *const last = given.last;
const int inputs = given.inputs, width = given.width, outputs = given.outputs;
const int directions = given.directions, pairs = given.pairs, channels = 1 + directions + pairs;
const int* const pair = given.pair;
const float first_omega = given.first_omega, omega = given.omega;
const long points = given.points, end = points * (part + 1) / parts;

float across[MOST_INPUTS * MOST_WIDTH];                    // `first` with the units in a row
for (int k = 0; k < width; ++k)
    for (int n = 0; n < inputs; ++n) across[n * width + k] = first[k * inputs + n];

float x[MOST_CHANNELS * MOST_INPUTS * LANES];              // channels × inputs × points
float raw[MOST_CHANNELS * MOST_INPUTS * LANES];            // channels × outputs × points
float z[ROWS * MOST_WIDTH], hidden[ROWS * MOST_WIDTH];     // points × channels × width

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
    for (int d = 1; d <= directions; ++d) store(h + d * stride, slope * load(z + d * stride));
    for (int q = 0; q < pairs; ++q) {
        const int row = (1 + directions + q) * stride;
        const Floats i = load(z + (1 + pair[2 * q]) * stride);
        const Floats j = load(z + (1 + pair[2 * q + 1]) * stride);
        store(h + row, slope * load(z + row) + bend * i * j);
    }
};

auto push_sine = [&](const float* z, float omega, float* h) {
    for (int k = 0; k < width; k += LANES) {
        const Floats angle = omega * load(z + k), g = sine(angle);
        push(z + k, h + k, width, g, omega * sine(angle + 1.57079633f), -omega * omega * g);
    }
};

// Rows of the first layer of point i, before its sine.
auto enter = [&](int i, float* z) {
    #pragma clang fp contract(fast)
    for (int c = 0; c < channels; ++c)
        for (int k = 0; k < width; k += LANES) {
            Floats sum = c ? (Floats)0.f : load(given.first_bias + k);
            for (int n = 0; n < inputs; ++n)
                sum += load(across + n * width + k) * x[(c * inputs + n) * LANES + i];
            store(z + c * width + k, sum);
        }
};

// `raw` of point i from the rows h after the second layer's sine.
auto leave = [&](int i, const float* h) {
    #pragma clang fp contract(fast)
    for (int c = 0; c < channels; ++c)
        for (int o = 0; o < outputs; ++o) {
            Floats sum = (Floats)0.f;
            for (int k = 0; k < width; k += LANES)
                sum += load(h + c * width + k) * load(last + o * width + k);
            raw[(c * outputs + o) * LANES + i] = total(sum) + (c ? 0.f : given.last_bias[o]);
        }
};
