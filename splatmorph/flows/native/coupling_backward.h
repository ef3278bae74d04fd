float slope_state[OUTER * DIM * LANES];  // ∂loss/∂to, then ∂loss/∂from

// `compose` in reverse: from ∂loss/∂rows to ∂loss/∂q, and on to `slope_state`.
auto decompose = [&](const float* q, const Floats* rows, float* slope_q) {
#pragma clang fp contract(fast)
    store(slope_q, rows[0]);
    for (int n = 0; n < DIRECTIONS; ++n) {
        const Floats along = load(q + (1 + n) * ROW);
        Floats sum = (Floats)0.f;
        for (int row = 1; row < OUTER; ++row) {
            sum += rows[row] * load(state + kept_at(row, n));
            add(slope_state + kept_at(row, n), rows[row] * along);
        }
        store(slope_q + (1 + n) * ROW, sum);
    }
    for (int c = 0; c < PAIRS; ++c) {
        const int row = (1 + DIRECTIONS + c) * ROW, n = PAIR[2 * c], m = PAIR[2 * c + 1];
        const Floats bent = load(q + row);
        Floats sum = (Floats)0.f;
        for (int p = 0; p < OUTER_PAIRS; ++p) {
            const Floats by = rows[1 + OUTER_DIRECTIONS + p], back = by * bent;
            const int i = 1 + OUTER_PAIR[2 * p], j = 1 + OUTER_PAIR[2 * p + 1];
            for (int twice = 0; twice <= (n != m); ++twice) {
                const int in = kept_at(i, twice ? m : n), jm = kept_at(j, twice ? n : m);
                sum += by * load(state + in) * load(state + jm);
                add(slope_state + in, back * load(state + jm));
                add(slope_state + jm, back * load(state + in));
            }
        }
        store(slope_q + row, sum);
    }
};

for (long p = points * part / parts; p < end; p += LANES) {
#pragma clang fp contract(fast)
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, DIM, OUTER, p, count, state);
    gather(given.slope_to, DIM, OUTER, p, count, slope_state);
    turn(state, false);
    seed();
    run_network();
    meet();
    Floats by_factor[OUTER], by_scale[OUTER], by_shift[OUTER];
    by_factor[0] = by_scale[0] = (Floats)0.f;
    for (int row = 0; row < OUTER; ++row) {
        const Floats by = load(slope_state + (row * DIM + moved) * LANES);
        by_shift[row] = by;
        by_factor[0] += by * scale[row];
        by_scale[0] += by * factor[row];
        if (row) by_factor[row] = by * scale[0], by_scale[row] = by * factor[0];
    }
    for (int q = 0; q < OUTER_PAIRS; ++q) {
        const int i = 1 + OUTER_PAIR[2 * q], j = 1 + OUTER_PAIR[2 * q + 1];
        const Floats by = by_shift[1 + OUTER_DIRECTIONS + q];
        by_factor[i] += by * scale[j];
        by_factor[j] += by * scale[i];
        by_scale[i] += by * factor[j];
        by_scale[j] += by * factor[i];
    }
    for (int row = 0; row < OUTER; ++row) {
        store(slope_state + (row * DIM + moved) * LANES, by_factor[row]);
        if (bound < 0) by_shift[row] = -by_factor[row];
    }
    decompose(terms, by_scale, slope_raw);
    decompose(terms + LANES, by_shift, slope_raw + LANES);
    pull(raw, slope_raw, ROW, slope, bend, twist);
    reverse_network();
    for (int n = 0; n < INPUTS; ++n) add(slope_state + kept_at(0, n), load(slope_x + n * LANES));
    turn(slope_state, true);
    scatter(slope_state, DIM, OUTER, p, count, given.slope_from);
}
