// What a frame is given, and its arrays by name.
enum Phase { PROJECT, COUNT, SCATTER, BIN, FILL, BLEND, DONE };

// A camera; see View in renderer/views.py.
struct View {
    float viewmat[4][4], to_world[3][3];
    float focal[2], principal[2];  // px
    float slope_min[2], slope_max[2];
    float near, far;
    int width, height;
};

struct State {
    Word ticket;
    int finished;
    int visible, lowest;
    int pass, passes, digit_bits, sorted;
    int slab_size, slab_begin, slab_end, slab_parts, last_slab, searching;
    Word ticks[DONE];  // per phase, summed over threads
    long long entries;
    int part_count[PARTS], part_stop[PARTS];
    unsigned part_lowest[PARTS], part_highest[PARTS];
};

// The blocks of a tile that are still open, sixteen bits a column of blocks, and whether an earlier
// slab has kept what it blended.
struct Tile {
    Word blocks;
    int touched;
};

// A projected splat is one cache line, and one vector.
struct Splat {
    float x, y;              // center, px
    float reach_x, reach_y;  // half extent of alpha >= 1/255, px
    float tilt, arc;         // its edge: dy = tilt dx ± sqrt(arc (reach_x² - dx²))
    // The tile where it begins, in 20 bits, and of this and the next to the right which columns of
    // blocks it may touch, in 8; 0 where it reaches further. Then the rows of blocks of this tile
    // and of the next below.
    unsigned tile, rows;
    // log2 alpha at (dx, dy) from the center: log2 opacity + xx dx² + xy dx dy + yy dy²
    float xx, xy, yy, log2_opacity;
    float depth, red, green, blue;
};

// Of 16 pixels the sums of colour and depth, and what is left of the light behind, whose sign is
// negative where the pixel is finished.
struct Block {
    Floats red, green, blue, depth, clear;
};

struct Arguments {
    const float *means, *quats, *scales, *opacities, *sh;  // n rows
    const float* pictures;       // to be gathered, tiles × BLOCKS × channels × LANES, as sums
    long long* gathered;         // n × channels, in 1/grain; without channels there are made
    float *rgb, *alpha, *depth;  // height × width
    State* state;
    Splat* splats;                // n
    unsigned* keys;               // two of n, as
    int* ids;                     // are these
    int *digits, *counts, *ends;  // parts × radix, parts × (tiles + columns + 1), tiles
    Word *lists, *entries;        // parts × list_size, and as many in their order
    Block* kept;                  // tiles × BLOCKS
    Tile* open_blocks;            // tiles + columns + 1
    View view;
    float background[3];
    float share;  // of a pixel's alpha at which its depth is taken; 0: the mean depth
    double grain;
    int n, coefficients, degree, channels, list_size;
};

const Arguments& given = *(const Arguments*)arguments;
const View view = given.view;
const int n = given.n, coefficients = given.coefficients, degree = given.degree;
const float *means = given.means, *quats = given.quats, *scales = given.scales;
const float *opacities = given.opacities, *sh = given.sh;
const int channels = given.channels;
float *rgb = given.rgb, *alphas = given.alpha, *depths = given.depth;

State& state = *given.state;
Splat* splats = given.splats;
unsigned* keys[2] = {given.keys, given.keys + n};
int* ids[2] = {given.ids, given.ids + n};
int *digits = given.digits, *counts = given.counts, *ends = given.ends;
Word *lists = given.lists, *entries = given.entries;
Block* kept = given.kept;
Tile* open_blocks = given.open_blocks;

const int list_size = given.list_size;
const int columns = (view.width + COLUMN - 1) / COLUMN;
const int tiles = columns * ((view.height + ROWS - 1) / ROWS);
// Beyond the last tile are as many that are never open as a splat may try there.
const int tile_room = tiles + columns + 1;
// A multiple of the vector, so that only the last block is cut.
const int part_size = ((n + PARTS - 1) / PARTS + LANES - 1) / LANES * LANES;
