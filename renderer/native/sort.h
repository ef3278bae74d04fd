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

// From counts to the place of the first of each digit of each part.
auto place_digits = [&]() {
    int place = 0;
    for (int d = 0; d < (1 << state.digit_bits); ++d)
        for (int part = 0; part < PARTS; ++part) {
            const int count = digits[part * RADIX + d];
            digits[part * RADIX + d] = place;
            place += count;
        }
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
