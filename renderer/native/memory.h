// The arrays of a frame, by name.
enum Phase { PROJECT, COUNT, SCATTER, BIN, FILL, BLEND, DONE };

struct State {
    Word ticket;
    int finished;
    int visible, lowest;
    int pass, passes, digit_bits, sorted;
    int slab_size, slab_begin, slab_end, slab_parts, last_slab;
    Word ticks[DONE];  // per phase, summed over threads
    long long entries;
    int part_count[PARTS], part_stop[PARTS];
    unsigned part_lowest[PARTS], part_highest[PARTS];
};

// The rows of a tile that are still open, and whether an earlier slab has kept them.
struct Tile {
    int first, last, touched;
};

// A projected splat is one cache line.
struct Splat {
    float x, y;  // center, px
    float conic_xx, conic_xy, conic_yy;
    float log_opacity;
    float reach_x, reach_y;  // half extent of alpha >= 1/255, px
    int left, right, top, bottom;  // the pixels it may touch, both ends included
    float red, green, blue, depth;
};

// A row of a tile: sums of colour and depth, and what is left of the light behind, whose sign
// is negative where the pixel is finished.
struct Row {
    Floats red, green, blue, depth, clear;
};

const float *means = means_in.data, *quats = quats_in.data, *scales = scales_in.data;
const float *opacities = opacities_in.data, *sh = sh_in.data;
float *rgb = rgb_out.data, *alphas = alpha_out.data, *depths = depth_out.data;

State& state = *(State*)memory.state.data;
Splat* splats = (Splat*)memory.splats.data;
unsigned* keys[2] = {(unsigned*)memory.keys.data, (unsigned*)memory.keys.data + n};
int* ids[2] = {memory.ids.data, memory.ids.data + n};
int *digits = memory.digits.data, *counts = memory.counts.data, *ends = memory.ends.data;
Word *lists = (Word*)memory.lists.data, *entries = (Word*)memory.entries.data;
Row* kept = (Row*)memory.kept.data;
Tile* open_rows = (Tile*)memory.open_rows.data;

const int list_size = (int)(memory.lists.shape[0] / PARTS);
const int columns = (view.width + LANES - 1) / LANES;
const int tiles = columns * ((view.height + ROWS - 1) / ROWS);
// A multiple of the vector, so that only the last block is cut.
const int part_size = ((n + PARTS - 1) / PARTS + LANES - 1) / LANES * LANES;
