float slopes[MOST_OUTER * MOST_INPUTS * LANES];            // ∂loss/∂to, then ∂loss/∂from

// `compose` in reverse: from ∂loss/∂rows to ∂loss/∂q, and on to `slopes`.
auto decompose = [&](const float* q, const Floats* rows, float* slope_q) {
    #pragma clang fp contract(fast)
    store(slope_q, rows[0]);
    for (int n = 0; n < inputs; ++n) {
        const Floats along = load(q + (1 + n) * ROW);
        Floats sum = (Floats)0.f;
        for (int row = 1; row < outer; ++row) {
            sum += rows[row] * load(state + kept_at(row, n));
            add(slopes + kept_at(row, n), rows[row] * along);
        }
        store(slope_q + (1 + n) * ROW, sum);
    }
    for (int c = 0; c < pairs; ++c) {
        const int row = (1 + directions + c) * ROW, n = pair[2 * c], m = pair[2 * c + 1];
        const Floats bent = load(q + row);
        Floats sum = (Floats)0.f;
        for (int p = 0; p < outer_pairs; ++p) {
            const Floats by = rows[1 + outer_directions + p], back = by * bent;
            const int i = 1 + outer_pair[2 * p], j = 1 + outer_pair[2 * p + 1];
            for (int twice = 0; twice <= (n != m); ++twice) {
                const int in = kept_at(i, twice ? m : n), jm = kept_at(j, twice ? n : m);
                sum += by * load(state + in) * load(state + jm);
                add(slopes + in, back * load(state + jm));
                add(slopes + jm, back * load(state + in));
            }
        }
        store(slope_q + row, sum);
    }
};

for (long p = points * part / parts; p < end; p += LANES) {
    #pragma clang fp contract(fast)
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, dim, outer, p, count, state);
    gather(given.slope_to, dim, outer, p, count, slopes);
    seed();
    recall_network(p, count);
    meet();
    Floats by_factor[MOST_OUTER], by_scale[MOST_OUTER], by_shift[MOST_OUTER];
    by_factor[0] = by_scale[0] = (Floats)0.f;
    for (int row = 0; row < outer; ++row) {
        const Floats by = load(slopes + (row * dim + moved) * LANES);
        by_shift[row] = by;
        by_factor[0] += by * scale[row];
        by_scale[0] += by * factor[row];
        if (row) by_factor[row] = by * scale[0], by_scale[row] = by * factor[0];
    }
    for (int q = 0; q < outer_pairs; ++q) {
        const int i = 1 + outer_pair[2 * q], j = 1 + outer_pair[2 * q + 1];
        const Floats by = by_shift[1 + outer_directions + q];
        by_factor[i] += by * scale[j];
        by_factor[j] += by * scale[i];
        by_scale[i] += by * factor[j];
        by_scale[j] += by * factor[i];
    }
    for (int row = 0; row < outer; ++row) {
        store(slopes + (row * dim + moved) * LANES, by_factor[row]);
        if (bound < 0) by_shift[row] = -by_factor[row];
    }
    decompose(terms, by_scale, slope_raw);
    decompose(terms + LANES, by_shift, slope_raw + LANES);
    pull(raw, slope_raw, ROW, slope, bend, twist);
    reverse_network();
    for (int n = 0; n < inputs; ++n) add(slopes + kept_at(0, n), load(slope_x + n * LANES));
    scatter(slopes, dim, outer, p, count, given.slope_from);
}
