float turned[MOST_WIDTH * MOST_WIDTH];                     // `second` with the inputs down
for (int o = 0; o < width; ++o)
    for (int k = 0; k < width; ++k) turned[k * width + o] = second[o * width + k];

// From x to `raw` for the `count` points from p on.
auto run_network = [&](long p, int count) {
    const int size = channels * width;
    for (int i = 0; i < LANES; ++i) {
        enter(i, z + i * size);
        push_sine(z + i * size, first_omega, hidden + i * size);
    }
    multiply(hidden, width, 1, turned, width, z, LANES * channels, false);
    for (int i = 0; i < LANES; ++i) {
        float* const row = z + i * size;
        for (int k = 0; k < width; k += LANES) add(row + k, load(given.second_bias + k));
        if (given.kept && i < count)
            for (int k = 0; k < size; k += LANES) store(given.kept + (p + i) * size + k, load(row + k));
        push_sine(row, omega, hidden);
        leave(i, hidden);
    }
};
