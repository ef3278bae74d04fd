// `from`, outer × points × dim, to `to`, the same.
for (long p = points * part / parts; p < end; p += LANES) {
    #pragma clang fp contract(fast)
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, dim, outer, p, count, state);
    seed();
    run_network(p, count);
    meet();
    for (int row = 0; row < outer; ++row) {
        Floats product = factor[row] * scale[0];
        if (row) product += factor[0] * scale[row];
        if (row > outer_directions) {
            const int* const two = outer_pair + 2 * (row - 1 - outer_directions);
            const int i = 1 + two[0], j = 1 + two[1];
            product += factor[i] * scale[j] + factor[j] * scale[i];
        }
        store(state + (row * dim + moved) * LANES, bound < 0 ? product : product + shift[row]);
    }
    scatter(state, dim, outer, p, count, given.to);
}
