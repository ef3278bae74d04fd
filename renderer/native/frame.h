// A frame is a row of phases, each a number of tasks. Threads draw tasks from one ticket that
// names phase, count and next task; whoever ends the last task of a phase opens the next. So a
// thread may come late or not at all, and what is computed never depends on who computes it.
auto clock = [&]() -> Word {
#if defined(__x86_64__)
    return __builtin_ia32_rdtsc();
#elif defined(__aarch64__)
    Word ticks;
    asm volatile("mrs %0, cntvct_el0" : "=r"(ticks));
    return ticks;
#else
    return 0;
#endif
};

auto open_phase = [&](int phase, int tasks) {
    state.finished = 0;
    __atomic_store_n(&state.ticket, (Word)phase << 56 | (Word)tasks << 28, __ATOMIC_RELEASE);
};

auto begin_sort = [&]() {
    unsigned lowest = ~0u, highest = 0;
    state.visible = 0;
    for (int part = 0; part < PARTS; ++part) {
        state.visible += state.part_count[part];
        lowest = state.part_lowest[part] < lowest ? state.part_lowest[part] : lowest;
        highest = state.part_highest[part] > highest ? state.part_highest[part] : highest;
    }
    state.lowest = lowest;
    int bits = 1;
    while (state.visible && bits < 32 && (highest - lowest) >> bits) ++bits;
    state.passes = (bits + RADIX_BITS - 1) / RADIX_BITS;
    state.digit_bits = (bits + state.passes - 1) / state.passes;
    state.pass = 0;
    // A slab hides what is behind it from listing and colouring, but its pixels are kept and
    // fetched again: worth it where splats are many for the pixels.
    const long dense = 8L * state.visible / ((long)view.width * view.height);
    state.slab_size = state.visible / (dense < 2 ? dense + 1 : 3 + dense / 4) + 1;
};

auto open_tiles = [&]() {
    for (int t = 0; t < tile_room; ++t) {
        const int wide = view.width - t % columns * COLUMN;
        const int beside = (wide < COLUMN ? wide + SIDE - 1 : COLUMN) / SIDE;
        const unsigned rows = rows_between(0, view.height - 1, t / columns);
        open_blocks[t] = Tile{whole_columns((1u << beside) - 1) & whole_rows(rows), 0};
    }
};

auto begin_slab = [&](int begin) {
    state.slab_begin = begin;
    const int end = begin + state.slab_size;
    state.slab_end = end < state.visible ? end : state.visible;
};

auto next_phase = [&](int phase) {
    switch (phase) {
    case PROJECT:
        begin_sort();
        open_tiles();
        return open_phase(COUNT, PARTS);
    case COUNT: place_digits(); return open_phase(SCATTER, PARTS);
    case SCATTER:
        if (++state.pass < state.passes) return open_phase(COUNT, PARTS);
        state.sorted = state.pass & 1;
        begin_slab(0);
        return open_phase(BIN, PARTS);
    case BIN:
        place_entries();
        state.last_slab = state.slab_end == state.visible;
        return open_phase(FILL, state.slab_parts);
    case FILL: return open_phase(BLEND, tiles);
    case BLEND:
        if (state.last_slab && (state.searching || !(given.share > 0.f)))
            return open_phase(DONE, 0);
        if (state.last_slab) {  // once more through the lists, for the depth of the surface
            state.searching = 1;
            open_tiles();
        }
        begin_slab(state.last_slab ? 0 : state.slab_end);
        return open_phase(BIN, PARTS);
    }
};

const Word TASKS = (1 << 28) - 1;
for (;;) {
    Word ticket = __atomic_load_n(&state.ticket, __ATOMIC_ACQUIRE);
    if (ticket >> 56 == DONE) break;
    if ((ticket & TASKS) >= (ticket >> 28 & TASKS)) {
#if defined(__x86_64__)
        __builtin_ia32_pause();
#endif
        continue;
    }
    ticket = __atomic_fetch_add(&state.ticket, 1, __ATOMIC_ACQ_REL);
    const int phase = (int)(ticket >> 56), task = (int)(ticket & TASKS),
              tasks = (int)(ticket >> 28 & TASKS);
    if (task >= tasks) continue;
    const Word began = clock();
    switch (phase) {
    case PROJECT: project_part(task); break;
    case COUNT: count_digits(task); break;
    case SCATTER: scatter_digits(task); break;
    case BIN: bin_part(task); break;
    case FILL: fill_part(task); break;
    case BLEND: blend_tile(task); break;
    }
    __atomic_fetch_add(&state.ticks[phase], clock() - began, __ATOMIC_RELAXED);
    if (__atomic_add_fetch(&state.finished, 1, __ATOMIC_ACQ_REL) == tasks) next_phase(phase);
}
