// exp(16 p) for p in [-0.36, 0]: a cubic to the power of 16, relative error 8e-5.
auto exp16 = [&](Floats p) -> Floats {
    #pragma clang fp contract(fast)
    Floats e = EXP0 + p * (EXP1 + p * (EXP2 + p * EXP3));
    e *= e, e *= e, e *= e;
    return e * e;
};

auto write_pixels = [&](const Pixels& tile, int left, int top) {
    #pragma clang fp contract(fast)
    const int wide = view.width - left < LANES ? view.width - left : LANES;
    const int high = view.height - top < ROWS ? view.height - top : ROWS;
    for (int r = 0; r < high; ++r) {
        const long at = (long)(top + r) * view.width + left;
        const Floats clear = __builtin_elementwise_abs(tile.clear[r]), alpha = 1.f - clear;
        const Floats red = tile.red[r] + clear * background[0], green = tile.green[r] + clear * background[1],
                     blue = tile.blue[r] + clear * background[2];
        const Floats depth = tile.depth[r] / (alpha > 0.f ? alpha : all(1.f));
        for (int lane = 0; lane < wide; ++lane) {
            rgb[3 * (at + lane)] = red[lane];
            rgb[3 * (at + lane) + 1] = green[lane];
            rgb[3 * (at + lane) + 2] = blue[lane];
            alphas[at + lane] = alpha[lane];
            depths[at + lane] = depth[lane];
        }
    }
};

// Blend the slab's splats into one tile, front to back.
auto blend_tile = [&](int t) {
    #pragma clang fp contract(fast)
    Tile& open = open_rows[t];
    const int begin = starts[t], end = starts[t + 1];
    if (open.first > open.last || (begin == end && !state.last_slab)) return;
    const int left = t % columns * LANES, top = t / columns * ROWS;
    const Floats x = lane_index + (left + 0.5f);
    Pixels tile;
    if (open.touched) tile = kept[t];
    else for (int r = 0; r < ROWS; ++r) {
        tile.red[r] = tile.green[r] = tile.blue[r] = tile.depth[r] = all(0.f);
        tile.clear[r] = all(1.f);
    }
    int first = open.first, last = open.last;
    const Floats none = all(0.f), dimmest = all(CLEAR_MIN);
    const Floats threshold = all(LOG_ALPHA_MIN / 16);
    for (int j = begin; j < end; ++j) {
        __builtin_prefetch(splats + Entry::id(entries[j + 8 < end ? j + 8 : j]));
        const Word entry = entries[j];
        const Splat& s = splats[Entry::id(entry)];
        const int r0 = Entry::first(entry) > first ? Entry::first(entry) : first;
        const int r1 = Entry::last(entry) < last ? Entry::last(entry) : last;
        const Floats dx = x - s.x;
        const float yy = s.conic_yy * (-0.5f / 16);
        const Floats across = dx * dx * (s.conic_xx * (-0.5f / 16)) + s.log_opacity * (1.f / 16);
        const Floats slant = dx * (s.conic_xy * (-1.f / 16));
        const Floats red = all(s.red), green = all(s.green), blue = all(s.blue), depth = all(s.depth);
        float dy = (float)(top + r0) + 0.5f - s.y;
        for (int r = r0; r <= r1; ++r, dy += 1.f) {
            const Floats power = across + (slant + yy * dy) * dy;
            Floats alpha = smaller(exp16(larger(power, all(-0.36f))), all(ALPHA_MAX));
            alpha = power >= threshold ? alpha : none;
            const Floats before = tile.clear[r];
            Floats weight = alpha * before;
            const Floats after = before - weight;
            const Ints finished = after < dimmest;
            tile.clear[r] = finished ? -__builtin_elementwise_abs(before) : after;
            weight = finished ? none : weight;
            tile.red[r] += weight * red;
            tile.green[r] += weight * green;
            tile.blue[r] += weight * blue;
            tile.depth[r] += weight * depth;
        }
        if ((j & 15) == 15 || j == end - 1) {
            while (first <= last && __builtin_reduce_max(tile.clear[first]) < 0.f) ++first;
            while (last >= first && __builtin_reduce_max(tile.clear[last]) < 0.f) --last;
            if (first > last) break;
        }
    }
    open.first = first, open.last = last, open.touched = 1;
    if (state.last_slab || first > last) write_pixels(tile, left, top);
    else kept[t] = tile;
};
