float* const slope_first = given.slope_weights             // inputs × width: `across`'s
    + part * (width * (inputs + width + outputs + 2) + outputs);
float* const slope_first_bias = slope_first + inputs * width;
float* const slope_second = slope_first_bias + width;
float* const slope_second_bias = slope_second + width * width;
float* const slope_last = slope_second_bias + width;
float* const slope_last_bias = slope_last + outputs * width;
float slope_raw[MOST_CHANNELS * MOST_INPUTS * LANES];      // ∂loss/∂raw
float slope_x[MOST_CHANNELS * MOST_INPUTS * LANES];        // ∂loss/∂x
float entered[ROWS * MOST_WIDTH], g[ROWS * MOST_WIDTH];

// `push` in reverse: g, ∂loss/∂h, becomes ∂loss/∂z; twist is g'''.
auto pull = [&](const float* z, float* g, int stride, Floats slope, Floats bend, Floats twist) {
    #pragma clang fp contract(fast)
    Floats value = slope * load(g);
    for (int d = 1; d <= directions; ++d) {
        const int row = d * stride;
        value += bend * load(z + row) * load(g + row);
        store(g + row, slope * load(g + row));
    }
    for (int q = 0; q < pairs; ++q) {
        const int row = (1 + directions + q) * stride;
        const int i = (1 + pair[2 * q]) * stride, j = (1 + pair[2 * q + 1]) * stride;
        const Floats by = load(g + row), zi = load(z + i), zj = load(z + j);
        value += (bend * load(z + row) + twist * zi * zj) * by;
        add(g + i, bend * zj * by);
        add(g + j, bend * zi * by);
        store(g + row, slope * by);
    }
    store(g, value);
};

auto pull_sine = [&](const float* z, float omega, float* g) {
    for (int k = 0; k < width; k += LANES) {
        const Floats angle = omega * load(z + k), slope = omega * sine(angle + 1.57079633f);
        pull(z + k, g + k, width, slope, -omega * omega * sine(angle), -omega * omega * slope);
    }
};

// `raw` and the rows `hidden` after the second sine, from what the way forward kept.
auto recall_network = [&](long p, int count) {
    const int size = channels * width;
    for (int i = 0; i < LANES; ++i) {
        for (int k = 0; k < size; k += LANES)
            store(z + i * size + k,
                  i < count ? load(given.kept + (p + i) * size + k) : (Floats)0.f);
        push_sine(z + i * size, omega, hidden + i * size);
        leave(i, hidden + i * size);
    }
};

// From `slope_raw` to `slope_x` and the sums over points that are ∂loss/∂(weights and biases).
auto reverse_network = [&]() {
    #pragma clang fp contract(fast)
    const int size = channels * width, rows = LANES * channels;
    for (int i = 0; i < LANES; ++i) {
        float* const row = g + i * size;
        for (int c = 0; c < channels; ++c)
            for (int k = 0; k < width; k += LANES) {
                const Floats unit = load(hidden + i * size + c * width + k);
                Floats sum = (Floats)0.f;
                for (int o = 0; o < outputs; ++o) {
                    const float by = slope_raw[(c * outputs + o) * LANES + i];
                    sum += load(last + o * width + k) * by;
                    add(slope_last + o * width + k, unit * by);
                }
                store(row + c * width + k, sum);
            }
        pull_sine(z + i * size, omega, row);
        for (int k = 0; k < width; k += LANES) add(slope_second_bias + k, load(row + k));
    }
    for (int o = 0; o < outputs; ++o) slope_last_bias[o] += total(load(slope_raw + o * LANES));
    for (int i = 0; i < LANES; ++i) {
        enter(i, entered + i * size);
        push_sine(entered + i * size, first_omega, hidden + i * size);
    }
    multiply(g, 1, width, hidden, rows, slope_second, width, true);
    multiply(g, width, 1, second, width, z, rows, false);
    for (int i = 0; i < LANES; ++i) {
        float* const row = z + i * size;
        pull_sine(entered + i * size, first_omega, row);
        for (int k = 0; k < width; k += LANES) add(slope_first_bias + k, load(row + k));
        for (int c = 0; c < channels; ++c)
            for (int n = 0; n < inputs; ++n) {
                const int at = (c * inputs + n) * LANES + i;
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
