// ∂loss/∂(weights and biases) of this part's points; the first's is laid out as `across`.
float* const slope_first = given.slope_weights + part * given.parameters;
float* const slope_first_bias = slope_first + INPUTS * width;
float* const slope_second = slope_first_bias + width;
float* const slope_second_bias = slope_second + width * width;
float* const slope_last = slope_second_bias + width;
float* const slope_last_bias = slope_last + OUTPUTS * width;
for (float* one = slope_first; one < slope_last_bias + OUTPUTS; ++one) *one = 0.f;
float slope_raw[CHANNELS * OUTPUTS * LANES];  // ∂loss/∂raw
float slope_x[CHANNELS * INPUTS * LANES];     // ∂loss/∂x
float slope_sines[2][ROWS * MOST_WIDTH];      // ∂loss/∂after, then ∂loss/∂before

// `push` in reverse: g, ∂loss/∂h, becomes ∂loss/∂z; twist is g'''.
auto pull = [&](const float* z, float* g, int stride, Floats slope, Floats bend, Floats twist) {
#pragma clang fp contract(fast)
    Floats value = slope * load(g);
    for (int d = 1; d <= DIRECTIONS; ++d) {
        const int row = d * stride;
        value += bend * load(z + row) * load(g + row);
        store(g + row, slope * load(g + row));
    }
    for (int q = 0; q < PAIRS; ++q) {
        const int row = (1 + DIRECTIONS + q) * stride;
        const int i = (1 + PAIR[2 * q]) * stride, j = (1 + PAIR[2 * q + 1]) * stride;
        const Floats by = load(g + row), zi = load(z + i), zj = load(z + j);
        value += (bend * load(z + row) + twist * zi * zj) * by;
        add(g + i, bend * zj * by);
        add(g + j, bend * zi * by);
        store(g + row, slope * by);
    }
    store(g, value);
};

auto pull_sine = [&](const Sines& layer, int i, float omega, float* g) {
    const int size = CHANNELS * width;
    const float squared = omega * omega;
    for (int k = 0; k < width; k += LANES) {
        const Floats slope = load(layer.slopes + i * width + k);
        const Floats bend = -squared * load(layer.after + i * size + k);
        pull(layer.before + i * size + k, g + i * size + k, width, slope, bend, -squared * slope);
    }
};

// From `slope_raw` to `slope_x` and the sums over points that are ∂loss/∂(weights and biases).
auto reverse_network = [&]() {
#pragma clang fp contract(fast)
    const int size = CHANNELS * width;
    for (int o = 0; o < OUTPUTS; ++o) slope_last_bias[o] += total(load(slope_raw + o * LANES));
    for (int i = 0; i < LANES; ++i) {
        for (int c = 0; c < CHANNELS; ++c)
            for (int k = 0; k < width; k += LANES) {
                const Floats unit = load(sines[1].after + i * size + c * width + k);
                Floats sum = (Floats)0.f;
                for (int o = 0; o < OUTPUTS; ++o) {
                    const float by = slope_raw[(c * OUTPUTS + o) * LANES + i];
                    sum += load(last + o * width + k) * by;
                    add(slope_last + o * width + k, unit * by);
                }
                store(slope_sines[1] + i * size + c * width + k, sum);
            }
        pull_sine(sines[1], i, omega, slope_sines[1]);
        for (int k = 0; k < width; k += LANES)
            add(slope_second_bias + k, load(slope_sines[1] + i * size + k));
    }
    multiply(slope_sines[1], 1, width, sines[0].after, ROWS, slope_second, width, true);
    multiply(slope_sines[1], width, 1, second, width, slope_sines[0], ROWS, false);
    for (int i = 0; i < LANES; ++i) {
        pull_sine(sines[0], i, first_omega, slope_sines[0]);
        const float* const row = slope_sines[0] + i * size;
        for (int k = 0; k < width; k += LANES) add(slope_first_bias + k, load(row + k));
        for (int c = 0; c < CHANNELS; ++c)
            for (int n = 0; n < INPUTS; ++n) {
                const int at = (c * INPUTS + n) * LANES + i;
                Floats sum = (Floats)0.f;
                for (int k = 0; k < width; k += LANES) {
                    const Floats by = load(row + c * width + k);
                    sum += load(across + n * width + k) * by;
                    add(slope_first + n * width + k, by * x[at]);
                }
                slope_x[at] = total(sum);
            }
    }
};
