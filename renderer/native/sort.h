// Radix sort of (depth, id) from the low digit up. Every part of the input counts and then
// scatters its own stretch in order, so the sort is stable for any number of threads: splats of
// one depth stay in the order they came in.
auto stretch = [&](int part, int& begin, int& end) {
    if (state.pass == 0) {  // the parts as projection left them, with gaps between
        begin = part * part_size;
        end = begin + state.part_count[part];
    } else {
        begin = (long)state.visible * part / PARTS;
        end = (long)state.visible * (part + 1) / PARTS;
    }
};

auto count_digits = [&](int part) {
    int begin, end, *count = digits + part * RADIX;
    stretch(part, begin, end);
    const unsigned* key = keys[state.pass & 1];
    const int shift = state.pass * state.digit_bits, mask = (1 << state.digit_bits) - 1;
    for (int d = 0; d <= mask; ++d) count[d] = 0;
    for (int i = begin; i < end; ++i) ++count[((key[i] - state.lowest) >> shift) & mask];
};

// From counts per part and kind to the place of each part's first of each kind: kinds lie in
// order, within a kind the parts. Leaves in ends where each kind ends. Row by row, since a walk
// down a column misses the cache at every step.
auto place_counts = [&](int* count, int parts, int row, int kinds, int* ends) {
    for (int kind = 0; kind < kinds; ++kind) ends[kind] = 0;
    for (int part = 0; part < parts; ++part)
        for (int kind = 0; kind < kinds; ++kind) ends[kind] += count[(long)part * row + kind];
    for (int kind = 0, total = 0; kind < kinds; ++kind) {
        const int many = ends[kind];
        ends[kind] = total;
        total += many;
    }
    for (int part = 0; part < parts; ++part)
        for (int kind = 0; kind < kinds; ++kind) {
            const int many = count[(long)part * row + kind];
            count[(long)part * row + kind] = ends[kind];
            ends[kind] += many;
        }
};

auto place_digits = [&]() {
    int ends[RADIX];
    place_counts(digits, PARTS, RADIX, 1 << state.digit_bits, ends);
};

auto scatter_digits = [&](int part) {
    int begin, end, *place = digits + part * RADIX;
    stretch(part, begin, end);
    const int from = state.pass & 1;
    const int shift = state.pass * state.digit_bits, mask = (1 << state.digit_bits) - 1;
    for (int i = begin; i < end; ++i) {
        const unsigned key = keys[from][i];
        const int to = place[((key - state.lowest) >> shift) & mask]++;
        keys[!from][to] = key;
        ids[!from][to] = ids[from][i];
    }
};
