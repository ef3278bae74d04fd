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


// Rows first to last where the ellipse alpha = 1/255 meets four columns of tiles, the first of
// which begins at dx = left from its center. Between its extremes the upper and the lower arc
// are monotonous, so their ends decide.
constexpr int COLUMNS = 4;  // few splats meet more
auto rows_of = [&](const Splat& s, float left, int* first, int* last) {
#pragma clang fp contract(fast)
    const Float4 step = {0.f, LANES, 2.f * LANES, 3.f * LANES};
    const float det = s.conic_xx * s.conic_yy - s.conic_xy * s.conic_xy;
    const float level = 2.f * (s.log_opacity - LOG_ALPHA_MIN) * s.conic_yy;
    const float inverse = 1.f / s.conic_yy, peak = -s.conic_xy / s.conic_xx * s.reach_y;
    const Float4 begin = larger(left + step, (Float4)-s.reach_x);
    const Float4 end = smaller(left + step + (LANES - 1.f), (Float4)s.reach_x);
    const Float4 a = root(larger(level - det * begin * begin, (Float4)0.f));
    const Float4 b = root(larger(level - det * end * end, (Float4)0.f));
    const Float4 tilt_a = s.conic_xy * begin, tilt_b = s.conic_xy * end;
    Float4 high = larger(a - tilt_a, b - tilt_b) * inverse;
    Float4 low = smaller(-a - tilt_a, -b - tilt_b) * inverse;
    high = ((peak >= begin) & (peak <= end)) ? (Float4)s.reach_y : high;
    low = ((-peak >= begin) & (-peak <= end)) ? (Float4)-s.reach_y : low;
    const Float4 top = larger(ceiling(s.y + low - (0.5f + SLACK)), (Float4)(float)s.top);
    const Float4 bottom = smaller(flooring(s.y + high - (0.5f - SLACK)), (Float4)(float)s.bottom);
    *(Int4*)first = __builtin_convertvector(top, Int4);
    *(Int4*)last = __builtin_convertvector(bottom, Int4);
};

// Depth order is no order in memory: ask early for what the colour of a splat will need.
auto fetch_color = [&](int id) {
    __builtin_prefetch(means + 3L * id);
    const char* row = (const char*)(sh + (long)id * coefficients * 3);
    for (int byte = 0; byte < coefficients * 12; byte += 64) __builtin_prefetch(row + byte);
    __builtin_prefetch(row + coefficients * 12 - 1);
};

// Whether a tile has open rows among the picture's rows top to bottom; trims them to those.
auto meets = [&](int tile_row, int column, int& top, int& bottom) -> bool {
    const Tile& open = open_rows[tile_row * columns + column];
    top -= tile_row * ROWS, bottom -= tile_row * ROWS;
    top = top > open.first ? top : open.first;
    bottom = bottom < open.last ? bottom : open.last;
    return top <= bottom;
};

// List the open tiles of one splat; returns how many. Room is checked before.
auto list_splat = [&](int id, Word* list, int* count) -> int {
    const Splat s = splats[id];
    const int column0 = s.left / LANES, column1 = s.right / LANES;
    const int row0 = s.top / ROWS, row1 = s.bottom / ROWS;
    // Before its rows are worked out, see that any tile of its box is open at all.
    bool seen = column0 == column1;
    for (int row = row0; row <= row1 && !seen; ++row)
        for (int column = column0; column <= column1; ++column) {
            int top = s.top, bottom = s.bottom;
            seen |= meets(row, column, top, bottom);
        }
    if (!seen) return 0;
    alignas(16) int first[COLUMNS], last[COLUMNS];
    first[0] = s.top, last[0] = s.bottom;
    int listed = 0;
    for (int column = column0; column <= column1; ++column) {
        const int lane = (column - column0) % COLUMNS;
        if (!lane && column0 < column1) rows_of(s, column * LANES + 0.5f - s.x, first, last);
        for (int row = first[lane] / ROWS; row <= last[lane] / ROWS; ++row) {
            int top = first[lane], bottom = last[lane];
            if (top > bottom || !meets(row, column, top, bottom)) continue;
            ++count[row * columns + column];
            list[listed++] = Entry::make(id, row * columns + column, top, bottom);
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
        const int area =
            (s.right / LANES - s.left / LANES + 1) * (s.bottom / ROWS - s.top / ROWS + 1);
        if (listed + area > list_size) break;
        const int more = list_splat(order[rank], list + listed, count);
        if (!more) continue;
        listed += more;
        if (state.searching) continue;
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

// Where each part's entries of each tile go. If a part was cut short, the slab ends there, and
// the next ones are so long that as dense a part would fit.
auto place_entries = [&]() {
    const long length = state.slab_end - state.slab_begin;
    int parts = 0;
    while (parts < PARTS && state.part_stop[parts++] < 0) {}
    if (state.part_stop[parts - 1] >= 0) {
        const int begin = state.slab_begin + (int)(length * (parts - 1) / PARTS);
        state.slab_end = state.part_stop[parts - 1];
        state.slab_size = PARTS * (state.slab_end - begin);
        state.slab_size = state.slab_size < PARTS ? PARTS : state.slab_size;
    }
    state.slab_parts = parts;
    place_counts(counts, parts, tiles, tiles, ends);
    state.entries += ends[tiles - 1];
};

auto fill_part = [&](int part) {
    int* place = counts + (long)part * tiles;
    const Word* list = lists + (long)part * list_size;
    for (int i = 0; i < state.part_count[part]; ++i)
        entries[place[Entry::tile(list[i])]++] = list[i];
};
