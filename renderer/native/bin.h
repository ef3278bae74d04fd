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


// Rows [first, last] where the ellipse alpha = 1/255 meets the pixel columns from dx = left to
// right (from the center): its upper and lower arcs are monotonous but for their extremes.
auto rows_of = [&](const Splat& s, float left, float right, int& first, int& last) {
    const float det = s.conic_xx * s.conic_yy - s.conic_xy * s.conic_xy;
    const float inverse = 1.f / s.conic_yy;
    const float level = 2.f * (s.log_opacity - LOG_ALPHA_MIN) * s.conic_yy;
    const float peak = -s.conic_xy / s.conic_xx * s.reach_y;
    left = left < -s.reach_x ? -s.reach_x : left;
    right = right > s.reach_x ? s.reach_x : right;
    float a = level - det * left * left, b = level - det * right * right;
    a = __builtin_sqrtf(a > 0.f ? a : 0.f), b = __builtin_sqrtf(b > 0.f ? b : 0.f);
    const float tilt_a = s.conic_xy * left, tilt_b = s.conic_xy * right;
    float high = (a - tilt_a > b - tilt_b ? a - tilt_a : b - tilt_b) * inverse;
    float low = (-a - tilt_a < -b - tilt_b ? -a - tilt_a : -b - tilt_b) * inverse;
    if (peak >= left && peak <= right) high = s.reach_y;
    if (-peak >= left && -peak <= right) low = -s.reach_y;
    const int down = (int)__builtin_ceilf(s.y + low - (0.5f + SLACK));
    const int up = (int)__builtin_floorf(s.y + high - (0.5f - SLACK));
    first = down > first ? down : first;
    last = up < last ? up : last;
};

// Depth order is no order in memory: ask early for what the colour of a splat will need.
auto fetch_color = [&](int id) {
    __builtin_prefetch(means + 3L * id);
    const char* row = (const char*)(sh + (long)id * coefficients * 3);
    for (int byte = 0; byte < coefficients * 12; byte += 64) __builtin_prefetch(row + byte);
    __builtin_prefetch(row + coefficients * 12 - 1);
};

// List the tiles of one splat that are still open; returns how many. Room is checked before.
auto list_splat = [&](int id, Word* list, int* count) -> int {
    const Splat& s = splats[id];
    const int column0 = s.left / LANES, column1 = s.right / LANES;
    int listed = 0;
    for (int column = column0; column <= column1; ++column) {
        int first = s.top, last = s.bottom;
        if (column0 < column1) {
            const float left = column * LANES + 0.5f - s.x;
            rows_of(s, left, left + LANES - 1.f, first, last);
            if (first > last) continue;
        }
        for (int row = first / ROWS; row <= last / ROWS; ++row) {
            const int tile = row * columns + column;
            const Tile& open = open_rows[tile];
            const int top = first - row * ROWS > open.first ? first - row * ROWS : open.first;
            const int bottom = last - row * ROWS < open.last ? last - row * ROWS : open.last;
            if (top > bottom) continue;
            ++count[tile];
            list[listed++] = Entry::make(id, tile, top, bottom);
        }
    }
    return listed;
};

// List the tiles of a part of the slab, and colour what is listed. A part whose list is full
// says where it stopped.
auto bin_part = [&](int part) {
    const long length = state.slab_end - state.slab_begin;
    const int begin = state.slab_begin + (int)(length * part / PARTS);
    const int end = state.slab_begin + (int)(length * (part + 1) / PARTS);
    const int* order = ids[state.sorted];
    int* count = counts + (long)part * tiles;
    Word* list = lists + (long)part * list_size;
    for (int t = 0; t < tiles; ++t) count[t] = 0;
    int waiting[2 * LANES], pending = 0, listed = 0, rank = begin;
    for (; rank < end; ++rank) {
        __builtin_prefetch(splats + order[rank + 16 < end ? rank + 16 : rank]);
        const Splat& s = splats[order[rank]];
        const int area = (s.right / LANES - s.left / LANES + 1) * (s.bottom / ROWS - s.top / ROWS + 1);
        if (listed + area > list_size) break;
        const int more = list_splat(order[rank], list + listed, count);
        if (!more) continue;
        listed += more;
        fetch_color(order[rank]);
        waiting[pending++] = order[rank];
        if (pending == 2 * LANES) {  // the older half has had time to arrive
            shade(waiting, LANES);
            for (int i = 0; i < LANES; ++i) waiting[i] = waiting[i + LANES];
            pending = LANES;
        }
    }
    shade(waiting, pending < LANES ? pending : LANES);
    if (pending > LANES) shade(waiting + LANES, pending - LANES);
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
