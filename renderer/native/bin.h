// One splat in one tile.
struct Entry {
    static Word make(int id, int tile) { return (Word)(unsigned)id << 32 | (Word)tile; }
    static int id(Word entry) { return (int)(entry >> 32); }
    static int tile(Word entry) { return (int)entry; }
};

// Rows of the picture, between two of them, where ellipses alpha = 1/255 meet columns so wide,
// the first pixel centers of which are ``from`` right of the ellipses': none where last < first.
// Between its extremes the upper and the lower arc are monotonous, so their ends decide.
auto rows_of = [&](auto from, float wide, auto y, auto reach_x, auto reach_y, auto tilt, auto arc,
                   float above, float below, auto* first, auto* last) {
#pragma clang fp contract(fast)
    typedef decltype(from) V;
    const V begin = larger(from, -reach_x), end = smaller(from + (wide - 1.f), reach_x);
    const V square = reach_x * reach_x, peak = tilt * square / reach_y;
    const V a = root(larger(arc * (square - begin * begin), (V)0.f));
    const V b = root(larger(arc * (square - end * end), (V)0.f));
    const V tilt_a = tilt * begin, tilt_b = tilt * end;
    V high = larger(tilt_a + a, tilt_b + b), low = smaller(tilt_a - a, tilt_b - b);
    high = ((peak >= begin) & (peak <= end)) ? reach_y : high;
    low = ((-peak >= begin) & (-peak <= end)) ? -reach_y : low;
    const V top = smaller(larger(ceiling(y + low - (0.5f + SLACK)), (V)above), (V)(below + 1.f));
    V bottom = larger(smaller(flooring(y + high - (0.5f - SLACK)), (V)below), (V)(above - 1.f));
    bottom = begin > end + SLACK ? (V)(above - 1.f) : bottom;
    typedef decltype(*first + 0) I;
    *first = __builtin_convertvector(top, I);
    *last = __builtin_convertvector(bottom, I);
};

// The blocks of a tile that 16 splats may touch: a bit each, sixteen a column.
auto blocks_of = [&](const Word* entry, int many, int left, int top, Word* blocks) {
    Floats v[LANES];
    for (int k = 0; k < LANES; ++k)
        v[k] = *(const Floats*)&splats[Entry::id(entry[k < many ? k : 0])];
    transpose(v);
    Ints bits[COLUMN / SIDE];
    for (int c = 0; c < COLUMN / SIDE; ++c) {
        Ints first, last;
        rows_of((left + SIDE * c + 0.5f) - v[0], (float)SIDE, v[1] - (float)top, v[2], v[3], v[4],
                v[5], 0.f, ROWS - 1.f, &first, &last);
        bits[c] = first > last ? (Ints)0 : (2 << (last >> 2)) - (1 << (first >> 2));
    }
    const Ints low = bits[0] | bits[1] << 16, high = bits[2] | bits[3] << 16;
    for (int k = 0; k < many; ++k) blocks[k] = (unsigned)low[k] | (Word)high[k] << 32;
};

// Depth order is no order in memory: ask early for what the colour of a splat will need. Into the
// second cache: so many requests for the first one would stand in each other's way.
auto fetch_color = [&](int id) {
    const char* row = (const char*)(sh + (long)id * coefficients * 3);
    for (int byte = 0; byte < coefficients * 12; byte += 64) __builtin_prefetch(row + byte, 0, 2);
    __builtin_prefetch(row + coefficients * 12 - 1, 0, 2);
};

// All blocks of the columns, and of the rows, that bits of a number name.
auto whole_columns = [&](unsigned some) -> Word {
    return (some * 0x0000200040008001 & 0x0001000100010001) * 0xffff;
};
auto whole_rows = [&](unsigned some) -> Word { return some * 0x0001000100010001; };

// The rows of blocks of a tile that lie among rows top to bottom of the picture.
auto rows_between = [&](int top, int bottom, int row) -> unsigned {
    top -= row * ROWS, bottom -= row * ROWS;
    top = top > 0 ? top : 0, bottom = bottom < ROWS ? bottom : ROWS - 1;
    return bottom < top ? 0 : (2u << bottom / SIDE) - (1u << top / SIDE);
};

// List the open tiles of a splat that meets more than two by two; ``offer`` takes a tile and the
// blocks of it that count.
auto list_large = [&](const Splat& s, auto offer) {
    const int left = (int)larger(s.x - s.reach_x, 0.f);
    const int right = (int)smaller(s.x + s.reach_x, view.width - 1.f);
    Int4 first, last;
    for (int column = left / COLUMN, k = 0; column <= right / COLUMN; ++column, ++k) {
        if (k % 4 == 0)
            rows_of(column * COLUMN + 0.5f - s.x + COLUMN * (Float4){0.f, 1.f, 2.f, 3.f},
                    (float)COLUMN, (Float4)s.y, (Float4)s.reach_x, (Float4)s.reach_y,
                    (Float4)s.tilt, (Float4)s.arc, 0.f, view.height - 1.f, &first, &last);
        if (first[k % 4] > last[k % 4]) continue;
        for (int row = first[k % 4] / ROWS; row <= last[k % 4] / ROWS; ++row)
            offer(row * columns + column, whole_rows(rows_between(first[k % 4], last[k % 4], row)));
    }
};

// List the open tiles of one splat; returns how many. Room for one more is checked before.
auto list_splat = [&](int id, Word* list, int* count) -> int {
    const Splat& s = splats[id];
    int listed = 0;
    // Without a branch that may be guessed wrong.
    const auto offer = [&](int tile, Word blocks) {
        const int hit = (blocks & open_blocks[tile].blocks) != 0;
        list[listed] = Entry::make(id, tile);
        count[tile] += hit;
        listed += hit;
    };
    const unsigned touched = s.tile >> 20, tile = s.tile & 0xfffff;
    if (touched) {
        const Word left = whole_columns(touched & 15), right = whole_columns(touched >> 4);
        const Word upper = whole_rows(s.rows & 0xffff), lower = whole_rows(s.rows >> 16);
        offer(tile, left & upper);
        offer(tile + 1, right & upper);
        offer(tile + columns, left & lower);
        offer(tile + columns + 1, right & lower);
    } else
        list_large(s, offer);
    return listed;
};

// The tiles in the box of a splat: no fewer than it is listed in.
auto tiles_of = [&](const Splat& s) -> int {
    if (s.tile >> 20) return 4;
    const float wide = smaller(2.f * s.reach_x, (float)view.width) / COLUMN + 2.f;
    const float high = smaller(2.f * s.reach_y, (float)view.height) / ROWS + 2.f;
    return (int)smaller(wide * high, (float)tiles);
};

// List the tiles of a part of the slab, and colour what is listed. A part whose list is full
// says where it stopped.
auto bin_part = [&](int part) {
    const long length = state.slab_end - state.slab_begin;
    const int begin = state.slab_begin + (int)(length * part / PARTS);
    const int end = state.slab_begin + (int)(length * (part + 1) / PARTS);
    const int* order = ids[state.sorted];
    int* count = counts + (long)part * tile_room;
    Word* list = lists + (long)part * list_size;
    for (int t = 0; t < tile_room; ++t) count[t] = 0;
    int waiting[2 * LANES], pending = 0, listed = 0, rank = begin;
    for (; rank < end; ++rank) {
        __builtin_prefetch(splats + order[rank + 32 < end ? rank + 32 : rank]);
        if (listed + tiles_of(splats[order[rank]]) >= list_size) break;
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
    place_counts(counts, parts, tile_room, tiles, ends);
    state.entries += ends[tiles - 1];
};

auto fill_part = [&](int part) {
    int* place = counts + (long)part * tile_room;
    const Word* list = lists + (long)part * list_size;
    for (int i = 0; i < state.part_count[part]; ++i)
        entries[place[Entry::tile(list[i])]++] = list[i];
};
