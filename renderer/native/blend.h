// exp(16 p) for p in [-0.36, 0]: a cubic to the power of 16, relative error 8e-5.
auto exp16 = [&](Floats p) -> Floats {
#pragma clang fp contract(fast)
    Floats e = EXP0 + p * (EXP1 + p * (EXP2 + p * EXP3));
    e *= e, e *= e, e *= e;
    return e * e;
};

// Three vectors of 16 pixels' red, green and blue as 48 floats in the order of the picture.
auto interleave = [&](Floats red, Floats green, Floats blue, float* out) {
    const auto a =
        __builtin_shufflevector(red, green, 0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5);
    const auto b =
        __builtin_shufflevector(red, green, 21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26);
    const auto c = __builtin_shufflevector(red, green, 0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30,
                                           0, 15, 31, 0);
    store(out, __builtin_shufflevector(a, blue, 0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20,
                                       15));
    store(out + 16, __builtin_shufflevector(b, blue, 0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12,
                                            25, 14, 15));
    store(out + 32, __builtin_shufflevector(c, blue, 26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30,
                                            13, 14, 31));
};

// Rows of a tile that no later splat changes go to the picture.
auto write_rows = [&](const Row* rows, int left, int top, int first, int last) {
#pragma clang fp contract(fast)
    const int wide = view.width - left;
    for (int r = first; r <= last; ++r) {
        const long at = (long)(top + r) * view.width + left;
        const Floats clear = __builtin_elementwise_abs(rows[r].clear), alpha = 1.f - clear;
        const Floats depth = rows[r].depth / (alpha > 0.f ? alpha : all(1.f));
        float pixels[5 * LANES];
        float* out[3] = {pixels, pixels + 3 * LANES, pixels + 4 * LANES};
        if (wide >= LANES) out[0] = rgb + 3 * at, out[1] = alphas + at, out[2] = depths + at;
        interleave(rows[r].red + clear * given.background[0],
                   rows[r].green + clear * given.background[1],
                   rows[r].blue + clear * given.background[2], out[0]);
        store(out[1], alpha);
        store(out[2], depth);
        for (int i = 0; i < wide && wide < LANES; ++i) {
            for (int channel = 0; channel < 3; ++channel)
                rgb[3 * (at + i) + channel] = pixels[3 * i + channel];
            alphas[at + i] = pixels[3 * LANES + i];
            depths[at + i] = pixels[4 * LANES + i];
        }
    }
};

// The surface lies where a share of the alpha is gathered, which is known only when all is
// blended: the second time round, ``red`` holds what is to be gathered, and a pixel is finished
// when it is.
auto goal_of = [&](int left, int y) -> Row {
    Row row = {all(0.f), all(0.f), all(0.f), all(0.f), all(1.f)};
    const float* alpha = alphas + (long)y * view.width + left;
    for (int i = 0; i < LANES; ++i)
        row.red[i] = left + i < view.width ? alpha[i] * given.share : 0.f;
    row.clear = row.red > 0.f ? row.clear : all(-1.f);
    return row;
};

auto write_depths = [&](const Row* rows, int left, int top, int first, int last) {
    for (int r = first; r <= last; ++r) {
        float* out = depths + (long)(top + r) * view.width + left;
        for (int i = 0; i < LANES && left + i < view.width; ++i) out[i] = rows[r].depth[i];
    }
};

// One splat over rows first to last of a tile; what it adds to each row's pixels goes to ``add``.
auto blend_splat = [&](const Splat& s, Floats x, float y, Row* rows, int first, int last,
                       auto add) {
#pragma clang fp contract(fast)
    const Floats none = all(0.f);
    const Floats dx = x - s.x;
    const float yy = s.conic_yy * (-0.5f / 16);
    const Floats across = dx * dx * (s.conic_xx * (-0.5f / 16)) + s.log_opacity * (1.f / 16);
    const Floats slant = dx * (s.conic_xy * (-1.f / 16));
    const Floats depth = all(s.depth);
    float dy = first + y - s.y;
    for (int r = first; r <= last; ++r, dy += 1.f) {
        const Floats power = across + (slant + yy * dy) * dy;
        // Far outside, the polynomial may overflow; such lanes are not taken.
        const Floats alpha =
            power >= LOG_ALPHA_MIN / 16 ? smaller(exp16(power), all(ALPHA_MAX)) : none;
        const Floats before = rows[r].clear;
        const Floats after = before - alpha * before;
        const Ints finished = after < CLEAR_MIN;
        if (state.searching) {
            const Ints reached = (before > 0.f) & (1.f - after >= rows[r].red);
            rows[r].depth = reached ? depth : rows[r].depth;
            rows[r].clear = reached ? -before : after;
            continue;
        }
        const Floats weight = finished ? none : alpha * before;
        rows[r].clear = finished ? -__builtin_elementwise_abs(before) : after;
        add(r, weight);
    }
};

auto paint_splat = [&](const Splat& s, Floats x, float y, Row* rows, int first, int last) {
    const Floats red = all(s.red), green = all(s.green), blue = all(s.blue), depth = all(s.depth);
    blend_splat(s, x, y, rows, first, last, [&](int r, Floats weight) {
#pragma clang fp contract(fast)
        rows[r].red += weight * red;
        rows[r].green += weight * green;
        rows[r].blue += weight * blue;
        rows[r].depth += weight * depth;
    });
};

// What splat ``id`` adds to a tile's pixels, times the pictures there, goes to its sums. These are
// whole numbers, so that their order doesn't matter.
auto gather_splat = [&](int id, int tile, Floats x, float y, Row* rows, int first, int last) {
    Floats sums[MAX_CHANNELS];
    for (int k = 0; k < channels; ++k) sums[k] = all(0.f);
    const float* picture = given.pictures + (long)tile * ROWS * channels * LANES;
    blend_splat(splats[id], x, y, rows, first, last, [&](int r, Floats weight) {
#pragma clang fp contract(fast)
        for (int k = 0; k < channels; ++k)
            sums[k] += weight * load(picture + (r * channels + k) * LANES);
    });
    for (int k = 0; k < channels; ++k) {
        double sum = 0;
        for (int lane = 0; lane < LANES; ++lane) sum += sums[k][lane];
        const long long whole = (long long)(sum * given.grain);
        long long* to = given.gathered + (long)id * channels + k;
        if (whole) __atomic_fetch_add(to, whole, __ATOMIC_RELAXED);
    }
};

// Blend the slab's splats into one tile, front to back.
auto blend_tile = [&](int t) {
    Tile& open = open_rows[t];
    const int begin = t ? ends[t - 1] : 0, end = ends[t];
    if (open.first > open.last || (begin == end && !state.last_slab)) return;
    const int left = t % columns * LANES, top = t / columns * ROWS;
    int first = open.first, last = open.last;
    Row rows[ROWS];
    for (int r = first; r <= last; ++r)
        rows[r] = open.touched      ? kept[t * ROWS + r]
                  : state.searching ? goal_of(left, top + r)
                                    : Row{all(0.f), all(0.f), all(0.f), all(0.f), all(1.f)};
    for (int j = begin; j < end; ++j) {
        __builtin_prefetch(splats + Entry::id(entries[j + 8 < end ? j + 8 : j]));
        const int id = Entry::id(entries[j]);
        const int r0 = Entry::first(entries[j]), r1 = Entry::last(entries[j]);
        const int from = r0 > first ? r0 : first, to = r1 < last ? r1 : last;
        const Floats x = lane_index + (left + 0.5f);
        if (channels)
            gather_splat(id, t, x, top + 0.5f, rows, from, to);
        else
            paint_splat(splats[id], x, top + 0.5f, rows, from, to);
        if ((j & 15) == 15 || j == end - 1) {
            while (first <= last && __builtin_reduce_max(rows[first].clear) < 0.f) ++first;
            while (last >= first && __builtin_reduce_max(rows[last].clear) < 0.f) --last;
            if (first > last) break;
        }
    }
    if (state.last_slab) first = last + 1;
    const auto write = [&](int from, int to) {
        if (channels) return;
        if (state.searching) return write_depths(rows, left, top, from, to);
        write_rows(rows, left, top, from, to);
    };
    write(open.first, first - 1);
    write(last + 1, open.last);
    for (int r = first; r <= last; ++r) kept[t * ROWS + r] = rows[r];
    open = Tile{first, last, 1};
};
