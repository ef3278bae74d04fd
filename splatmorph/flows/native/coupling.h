// The axes turned by a matrix, then one coupling: z_i <- exp(bound tanh r₀) z_i + r₁ with r the
// network of the other coordinates, or with a negative bound its inverse, z_i <- exp(bound tanh r₀)
// (z_i - r₁); the plain twin is Coupling.push in flows/conjugate.py. The network is differentiated in
// its own inputs, and the chain rule brings that to the OUTER_DIRECTIONS and OUTER_PAIRS of the jet.
// Compiled once for each (OUTER_DIRECTIONS, OUTER_PAIRS, OUTER_PAIR).
constexpr int OUTER = 1 + OUTER_DIRECTIONS + OUTER_PAIRS, DIM = INPUTS + 1, ROW = 2 * LANES;
const int moved = given.moved;
const float bound = given.bound;

float state[OUTER * DIM * LANES];  // outer × DIM × points
float terms[CHANNELS * ROW];       // rows of exp(bound tanh r₀) and r₁
Floats scale[OUTER], shift[OUTER], factor[OUTER];
Floats slope, bend, twist;  // of r₀ -> exp(bound tanh r₀)
auto kept_at = [&](int row, int n) -> int { return (row * DIM + n + (n >= moved)) * LANES; };

// Points turned by the matrix before the coupling, or with `back` slopes by its transpose.
auto turn = [&](float* rows, bool back) {
#pragma clang fp contract(fast)
    if (!given.turn) return;
    for (int row = 0; row < OUTER; ++row) {
        Floats turned[DIM];
        for (int i = 0; i < DIM; ++i) {
            turned[i] = (Floats)0.f;
            for (int j = 0; j < DIM; ++j)
                turned[i] += given.turn[back ? j * DIM + i : i * DIM + j] *
                             load(rows + (row * DIM + j) * LANES);
        }
        for (int i = 0; i < DIM; ++i) store(rows + (row * DIM + i) * LANES, turned[i]);
    }
};

auto seed = [&]() {
    for (int k = 0; k < CHANNELS * INPUTS * LANES; ++k) x[k] = 0.f;
    for (int n = 0; n < INPUTS; ++n) store(x + n * LANES, load(state + kept_at(0, n)));
    for (int n = 0; n < DIRECTIONS; ++n) store(x + ((1 + n) * INPUTS + n) * LANES, (Floats)1.f);
};

// Rows of the jet for a function of the other coordinates with the rows q.
auto compose = [&](const float* q, Floats* rows) {
#pragma clang fp contract(fast)
    for (int row = 0; row < OUTER; ++row) {
        rows[row] = row ? (Floats)0.f : load(q);
        for (int n = 0; row && n < DIRECTIONS; ++n)
            rows[row] += load(q + (1 + n) * ROW) * load(state + kept_at(row, n));
    }
    for (int p = 0; p < OUTER_PAIRS; ++p) {
        const int i = 1 + OUTER_PAIR[2 * p], j = 1 + OUTER_PAIR[2 * p + 1];
        for (int c = 0; c < PAIRS; ++c) {
            const int n = PAIR[2 * c], m = PAIR[2 * c + 1];
            Floats by = load(state + kept_at(i, n)) * load(state + kept_at(j, m));
            if (n != m) by += load(state + kept_at(i, m)) * load(state + kept_at(j, n));
            rows[1 + OUTER_DIRECTIONS + p] += load(q + (1 + DIRECTIONS + c) * ROW) * by;
        }
    }
};

// `scale`, `shift` and the `factor` that `scale` multiplies, from `raw` and `state`.
auto meet = [&]() {
#pragma clang fp contract(fast)
    const Floats bent = 1.f - 2.f / (exponential(2.f * load(raw)) + 1.f);
    const Floats g = exponential(bound * bent), less = 1.f - bent * bent, u = bound * less,
                 du = -2.f * bent * u;
    slope = g * u;
    bend = g * (u * u + du);
    twist = g * (u * u * u + 3.f * u * du + u * (6.f * bent * bent - 2.f));
    push(raw, terms, ROW, g, slope, bend);
    for (int c = 0; c < CHANNELS; ++c) store(terms + c * ROW + LANES, load(raw + c * ROW + LANES));
    compose(terms, scale);
    compose(terms + LANES, shift);
    for (int row = 0; row < OUTER; ++row) {
        factor[row] = load(state + (row * DIM + moved) * LANES);
        if (bound < 0) factor[row] -= shift[row];
    }
};
