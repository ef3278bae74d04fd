// `from`, outer × points × dim, to `to`, the same.
for (long p = points * part / parts; p < end; p += LANES) {
#pragma clang fp contract(fast)
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, DIM, OUTER, p, count, state);
    turn(state, false);
    seed();
    run_network();
    meet();
    for (int row = 0; row < OUTER; ++row) {
        Floats product = factor[row] * scale[0];
        if (row) product += factor[0] * scale[row];
        if (row > OUTER_DIRECTIONS) {
            const int* const two = OUTER_PAIR + 2 * (row - 1 - OUTER_DIRECTIONS);
            const int i = 1 + two[0], j = 1 + two[1];
            product += factor[i] * scale[j] + factor[j] * scale[i];
        }
        store(state + (row * DIM + moved) * LANES, bound < 0 ? product : product + shift[row]);
    }
    scatter(state, DIM, OUTER, p, count, given.to);
}
