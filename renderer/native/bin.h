// One splat in one tile, with the rows of the tile it may touch.
struct Entry {
    static Word make(int id, int tile, int first, int last) {
        return (Word)(unsigned)id << 32 | (Word)tile << 12 | (Word)first << 6 | (Word)last;
    }
    static int id(Word entry) { return (int)(entry >> 32); }
    static int tile(Word entry) { return (int)(entry >> 12) & 0xfffff; }
    static int first(Word entry) { return (int)(entry >> 6) & 63; }
    static int last(Word entry) { return (int)entry & 63; }
};

// A margin for rounding; the pixels themselves are tested when they are blended.
constexpr float SLACK = 1e-3f;

auto ceiling = [&](float x) -> int { return (int)__builtin_ceilf(x); };
auto flooring = [&](float x) -> int { return (int)__builtin_floorf(x); };
auto clamp = [&](int x, int low, int high) -> int { return x < low ? low : x > high ? high : x; };
auto bound = [&](float x, float low, float high) -> float { return x < low ? low : x > high ? high : x; };

// Rows [first, last] where the ellipse alpha = 1/255 meets the pixel columns from dx = left to
// right (from the center): its upper and lower arcs are monotonous but for their extremes.
auto rows_of = [&](const Splat& s, float y, float left, float right, int& first, int& last) {
    const float det = s.conic_xx * s.conic_yy - s.conic_xy * s.conic_xy;
    const float level = 2.f * (s.log_opacity - LOG_ALPHA_MIN) * s.conic_yy;
    const float peak = -s.conic_xy / s.conic_xx * s.reach_y;
    left = left < -s.reach_x ? -s.reach_x : left;
    right = right > s.reach_x ? s.reach_x : right;
    float a = level - det * left * left, b = level - det * right * right;
    a = __builtin_sqrtf(a > 0.f ? a : 0.f), b = __builtin_sqrtf(b > 0.f ? b : 0.f);
    const float tilt_a = s.conic_xy * left, tilt_b = s.conic_xy * right;
    float high = (a - tilt_a > b - tilt_b ? a - tilt_a : b - tilt_b) / s.conic_yy;
    float low = (-a - tilt_a < -b - tilt_b ? -a - tilt_a : -b - tilt_b) / s.conic_yy;
    if (peak >= left && peak <= right) high = s.reach_y;
    if (-peak >= left && -peak <= right) low = -s.reach_y;
    const int down = ceiling(y + low - SLACK), up = flooring(y + high + SLACK);
    first = down > first ? down : first;
    last = up < last ? up : last;
};

// List the tiles of a part of the slab. A part whose list is full says where it stopped.
auto bin_part = [&](int part) {
    const long length = state.slab_end - state.slab_begin;
    const int begin = state.slab_begin + (int)(length * part / PARTS);
    const int end = state.slab_begin + (int)(length * (part + 1) / PARTS);
    const int* order = ids[state.sorted];
    int* count = counts + (long)part * tiles;
    Word* list = lists + (long)part * list_size;
    for (int t = 0; t < tiles; ++t) count[t] = 0;
    int pending[LANES], waiting = 0, listed = 0, rank = begin;
    for (; rank < end; ++rank) {
        __builtin_prefetch(splats + order[rank + 16 < end ? rank + 16 : rank]);
        const int id = order[rank];
        const Splat& s = splats[id];
        // Pixel centers lie at +0.5; from here on a pixel is its index.
        const float x = s.x - 0.5f, y = s.y - 0.5f, w = (float)view.width, h = (float)view.height;
        const int x0 = ceiling(bound(x - s.reach_x - SLACK, 0.f, w)), x1 = flooring(bound(x + s.reach_x + SLACK, -1.f, w - 1.f));
        const int y0 = ceiling(bound(y - s.reach_y - SLACK, 0.f, h)), y1 = flooring(bound(y + s.reach_y + SLACK, -1.f, h - 1.f));
        if (x0 > x1 || y0 > y1) continue;
        const int column0 = x0 / LANES, column1 = x1 / LANES, row0 = y0 / ROWS, row1 = y1 / ROWS;
        if (listed + (column1 - column0 + 1) * (row1 - row0 + 1) > list_size) break;
        const int before = listed;
        for (int column = column0; column <= column1; ++column) {
            int first = y0, last = y1;
            if (column0 < column1) {
                const float left = (float)(column * LANES) - x;
                rows_of(s, y, left, left + LANES - 1.f, first, last);
            }
            for (int row = first / ROWS; row <= last / ROWS && first <= last; ++row) {
                const int tile = row * columns + column;
                const Tile& open = open_rows[tile];
                const int top = clamp(first - row * ROWS, open.first, ROWS), bottom = clamp(last - row * ROWS, -1, open.last);
                if (top > bottom) continue;
                ++count[tile];
                list[listed++] = Entry::make(id, tile, top, bottom);
            }
        }
        if (listed == before) continue;
        pending[waiting++] = id;
        if (waiting == LANES) shade(pending, LANES), waiting = 0;
    }
    if (waiting) shade(pending, waiting);
    state.part_count[part] = listed;
    state.part_stop[part] = rank < end ? rank : -1;
};

// Where each part's entries of each tile go. If a part was cut short, the slab ends there.
auto place_entries = [&]() {
    int parts = PARTS;
    for (int part = PARTS - 1; part >= 0; --part)
        if (state.part_stop[part] >= 0) parts = part + 1;
    if (parts < PARTS || state.part_stop[PARTS - 1] >= 0) state.slab_end = state.part_stop[parts - 1];
    state.slab_parts = parts;
    int place = 0;
    for (int t = 0; t < tiles; ++t) {
        starts[t] = place;
        for (int part = 0; part < parts; ++part) {
            const int count = counts[(long)part * tiles + t];
            counts[(long)part * tiles + t] = place;
            place += count;
        }
    }
    starts[tiles] = place;
    state.entries += place;
};

auto fill_part = [&](int part) {
    int* place = counts + (long)part * tiles;
    const Word* list = lists + (long)part * list_size;
    for (int i = 0; i < state.part_count[part]; ++i) entries[place[Entry::tile(list[i])]++] = list[i];
};
