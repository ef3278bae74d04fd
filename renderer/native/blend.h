// 2^p: a cubic for the fraction, which is between -1/2 and 1/2; the rest goes to the exponent.
auto exp2 = [&](Floats p) -> Floats {
#pragma clang fp contract(fast)
    const float whole = 12582912.f;  // 1.5 × 2^23: what is added to it is rounded
    const Floats rounded = p + whole, f = p - (rounded - whole);
    const Floats e = EXP0 + f * (EXP1 + f * (EXP2 + f * EXP3));
    const Ints bits = *(const Ints*)&e + (*(const Ints*)&rounded << 23);
    return *(const Floats*)&bits;
};

// A picture that no cache holds is written past them.
const bool past_caches = view.width % LANES == 0 && (long)view.width * view.height >= 1 << 20;
auto put = [&](float* to, Floats v) {
    if (past_caches)
        __builtin_nontemporal_store(v, (Floats*)to);
    else
        store(to, v);
};

// Three vectors of 16 pixels' red, green and blue as 48 floats in the order of the picture.
auto interleave = [&](Floats red, Floats green, Floats blue, float* out) {
    const auto a =
        __builtin_shufflevector(red, green, 0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5);
    const auto b =
        __builtin_shufflevector(red, green, 21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26);
    const auto c = __builtin_shufflevector(red, green, 0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30,
                                           0, 15, 31, 0);
    put(out,
        __builtin_shufflevector(a, blue, 0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15));
    put(out + 16,
        __builtin_shufflevector(b, blue, 0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15));
    put(out + 32,
        __builtin_shufflevector(c, blue, 26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31));
};

// Four blocks beside each other as four rows of 16 pixels.
auto rows_of_blocks = [&](const Floats& a, const Floats& b, const Floats& c, const Floats& d,
                          Floats& row0, Floats& row1, Floats& row2, Floats& row3) {
    const auto ab =
        __builtin_shufflevector(a, b, 0, 1, 2, 3, 16, 17, 18, 19, 4, 5, 6, 7, 20, 21, 22, 23);
    const auto cd =
        __builtin_shufflevector(c, d, 0, 1, 2, 3, 16, 17, 18, 19, 4, 5, 6, 7, 20, 21, 22, 23);
    const auto AB =
        __builtin_shufflevector(a, b, 8, 9, 10, 11, 24, 25, 26, 27, 12, 13, 14, 15, 28, 29, 30, 31);
    const auto CD =
        __builtin_shufflevector(c, d, 8, 9, 10, 11, 24, 25, 26, 27, 12, 13, 14, 15, 28, 29, 30, 31);
    row0 = __builtin_shufflevector(ab, cd, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
    row1 = __builtin_shufflevector(ab, cd, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30,
                                   31);
    row2 = __builtin_shufflevector(AB, CD, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
    row3 = __builtin_shufflevector(AB, CD, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30,
                                   31);
};

// Four rows of a tile go to the picture.
auto write_rows = [&](const Block* rows, int left, int top) {
#pragma clang fp contract(fast)
    const int wide = view.width - left;
    for (int r = 0; r < SIDE && top + r < view.height; ++r) {
        const long at = (long)(top + r) * view.width + left;
        const Floats clear = __builtin_elementwise_abs(rows[r].clear), alpha = 1.f - clear;
        const Floats depth = rows[r].depth / (alpha > 0.f ? alpha : all(1.f));
        alignas(64) float pixels[5 * LANES];
        float* out[3] = {pixels, pixels + 3 * LANES, pixels + 4 * LANES};
        if (wide >= LANES) out[0] = rgb + 3 * at, out[1] = alphas + at, out[2] = depths + at;
        interleave(rows[r].red + clear * given.background[0],
                   rows[r].green + clear * given.background[1],
                   rows[r].blue + clear * given.background[2], out[0]);
        put(out[1], alpha);
        put(out[2], depth);
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
auto goal_of = [&](int left, int top) -> Block {
    Block block = {all(0.f), all(0.f), all(0.f), all(0.f), all(1.f)};
    for (int i = 0; i < LANES; ++i) {
        const int x = left + i % SIDE, y = top + i / SIDE;
        if (x < view.width && y < view.height)
            block.red[i] = alphas[(long)y * view.width + x] * given.share;
    }
    block.clear = block.red > 0.f ? block.clear : all(-1.f);
    return block;
};

auto write_depths = [&](const Block* rows, int left, int top) {
    for (int r = 0; r < SIDE && top + r < view.height; ++r) {
        float* out = depths + (long)(top + r) * view.width + left;
        for (int i = 0; i < LANES && left + i < view.width; ++i) out[i] = rows[r].depth[i];
    }
};

// Where the rows of blocks of a tile begin: looked up faster than converted.
float row_offset[ROWS / SIDE];
for (int r = 0; r < ROWS / SIDE; ++r) row_offset[r] = (float)(SIDE * r);

// One splat over blocks of a tile, of which those are struck out of ``open`` whose pixels are all
// finished; what it adds to each block's pixels goes to ``add``.
auto blend_splat = [&](const Splat& s, float left, float top, Block* blocks, Word some, Word& open,
                       auto add) {
#pragma clang fp contract(fast)
    const Floats none = all(0.f), depth = all(s.depth);
    Floats across[COLUMN / SIDE], slant[COLUMN / SIDE];
    for (int c = 0; c < COLUMN / SIDE; ++c) {
        const Floats dx = lane_x + (left + (float)(SIDE * c) - s.x);
        across[c] = dx * dx * s.xx + s.log2_opacity;
        slant[c] = dx * s.xy;
    }
    const Floats y = lane_y + (top - s.y);
    for (; some; some &= some - 1) {
        const int b = __builtin_ctzll(some);
        const Floats dy = y + row_offset[b & 15];
        const Floats power = across[b >> 4] + (slant[b >> 4] + s.yy * dy) * dy;
        // Far outside, the exponent overflows; such lanes are not taken.
        const Floats alpha = power >= LOG2_ALPHA_MIN ? smaller(exp2(power), all(ALPHA_MAX)) : none;
        const Floats before = blocks[b].clear;
        const Floats after = before - alpha * before;
        if (state.searching) {
            const Ints reached = (before > 0.f) & (1.f - after >= blocks[b].red);
            blocks[b].depth = reached ? depth : blocks[b].depth;
            blocks[b].clear = reached ? -before : after;
            if (__builtin_reduce_and(blocks[b].clear < 0.f)) open &= ~(1ull << b);
            continue;
        }
        const Ints finished = after < CLEAR_MIN;
        const Floats weight = finished ? none : alpha * before;
        blocks[b].clear = finished ? -__builtin_elementwise_abs(before) : after;
        add(b, weight);
        if (__builtin_reduce_and(finished)) open &= ~(1ull << b);
    }
};

auto paint_splat = [&](const Splat& s, float left, float top, Block* blocks, Word some,
                       Word& open) {
    const Floats red = all(s.red), green = all(s.green), blue = all(s.blue), depth = all(s.depth);
    blend_splat(s, left, top, blocks, some, open, [&](int b, Floats weight) {
#pragma clang fp contract(fast)
        blocks[b].red += weight * red;
        blocks[b].green += weight * green;
        blocks[b].blue += weight * blue;
        blocks[b].depth += weight * depth;
    });
};

// What splat ``id`` adds to a tile's pixels, times the pictures there, goes to its sums. These are
// whole numbers, so that their order doesn't matter.
auto gather_splat = [&](int id, int tile, float left, float top, Block* blocks, Word some,
                        Word& open) {
    Floats sums[MAX_CHANNELS];
    for (int k = 0; k < channels; ++k) sums[k] = all(0.f);
    const float* picture = given.pictures + (long)tile * BLOCKS * channels * LANES;
    blend_splat(splats[id], left, top, blocks, some, open, [&](int b, Floats weight) {
#pragma clang fp contract(fast)
        for (int k = 0; k < channels; ++k)
            sums[k] += weight * load(picture + (b * channels + k) * LANES);
    });
    for (int k = 0; k < channels; ++k) {
        double sum = 0;
        for (int lane = 0; lane < LANES; ++lane) sum += sums[k][lane];
        const long long whole = (long long)(sum * given.grain);
        long long* to = given.gathered + (long)id * channels + k;
        if (whole) __atomic_fetch_add(to, whole, __ATOMIC_RELAXED);
    }
};

// A tile that no later splat changes goes to the picture.
auto write_tile = [&](const Block* blocks, int left, int top) {
    Floats Block::* const sums[] = {&Block::red, &Block::green, &Block::blue, &Block::depth,
                                    &Block::clear};
    for (int r = 0; r < ROWS / SIDE && top + SIDE * r < view.height; ++r) {
        const Block *a = blocks + r, *b = a + 16, *c = b + 16, *d = c + 16;
        Block rows[SIDE];
        for (auto sum : sums)
            rows_of_blocks(a->*sum, b->*sum, c->*sum, d->*sum, rows[0].*sum, rows[1].*sum,
                           rows[2].*sum, rows[3].*sum);
        if (state.searching)
            write_depths(rows, left, top + SIDE * r);
        else
            write_rows(rows, left, top + SIDE * r);
    }
};

// A tile that no splat meets.
auto write_nothing = [&](int left, int top) {
    const Block clear = {all(0.f), all(0.f), all(0.f), all(0.f), all(1.f)};
    const Block rows[SIDE] = {clear, clear, clear, clear};
    for (int r = 0; r < ROWS / SIDE && top + SIDE * r < view.height; ++r)
        write_rows(rows, left, top + SIDE * r);
};

// Blend the slab's splats into one tile, front to back.
auto blend_tile = [&](int t) {
    Tile& tile = open_blocks[t];
    const int begin = t ? ends[t - 1] : 0, end = ends[t];
    if (!tile.blocks || (begin == end && !state.last_slab)) return;
    const int left = t % columns * COLUMN, top = t / columns * ROWS;
    if (begin == end && !tile.touched && !state.searching && !channels)
        return write_nothing(left, top);
    Block blocks[BLOCKS];
    Block* before = kept + (long)t * BLOCKS;
    const auto copy = [&](const Block* from, Block* to, Word some) {
        for (; some; some &= some - 1) to[__builtin_ctzll(some)] = from[__builtin_ctzll(some)];
    };
    if (tile.touched)
        copy(before, blocks, tile.blocks);
    else
        for (int b = 0; b < BLOCKS; ++b)
            blocks[b] = state.searching ? goal_of(left + SIDE * (b >> 4), top + SIDE * (b & 15))
                                        : Block{all(0.f), all(0.f), all(0.f), all(0.f), all(1.f)};
    Word open = tile.blocks;
    for (int j = begin; j < end && open; j += LANES) {
        // The masks of some splats before any is blended: what a loop's end hangs on is then known.
        Word masks[LANES];
        const int many = end - j < LANES ? end - j : LANES;
        for (int k = 0; k < many; ++k) {
            const int next = j + LANES + k;
            __builtin_prefetch(splats + Entry::id(entries[next < end ? next : j]));
        }
        blocks_of(entries + j, many, left, top, masks);
        for (int k = 0; k < many; ++k) {
            const Word some = masks[k] & open;
            if (!some) continue;
            const int id = Entry::id(entries[j + k]);
            if (channels)
                gather_splat(id, t, left + 0.5f, top + 0.5f, blocks, some, open);
            else
                paint_splat(splats[id], left + 0.5f, top + 0.5f, blocks, some, open);
        }
    }
    if (state.last_slab) open = 0;
    if (open)
        copy(blocks, before, tile.touched ? tile.blocks : ~0ull);
    else if (tile.touched)
        copy(before, blocks, ~tile.blocks);
    if (!open && !channels) write_tile(blocks, left, top);
    tile = Tile{open, 1};
};
