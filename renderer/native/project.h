// Rows i to i + 15 of an (n, stride) array; the last block is completed with zeros.
auto block = [&](const float* rows, int stride, int i, float* spare) -> const float* {
    if (i + LANES <= n) return rows + (long)i * stride;
    for (int k = 0; k < LANES * stride; ++k)
        spare[k] = k < (n - i) * stride ? rows[(long)i * stride + k] : 0.f;
    return spare;
};

// Where splats are listed, from the pixels that they may touch; see Splat.
auto place = [&](Floats left, Floats right, Floats top, Floats bottom, Ints* tile, Ints* rows) {
    const Ints x0 = __builtin_convertvector(left, Ints), x1 = __builtin_convertvector(right, Ints);
    const Ints y0 = __builtin_convertvector(top, Ints), y1 = __builtin_convertvector(bottom, Ints);
    const Ints column = x0 / COLUMN, row = y0 / ROWS;
    const Ints columns_touched =
        (2 << (x1 - column * COLUMN) / SIDE) - (1 << (x0 - column * COLUMN) / SIDE);
    const Ints near = (x1 / COLUMN - column < 2) & (y1 / ROWS - row < 2);
    *tile = row * columns + column + (near ? columns_touched << 20 : (Ints)0);
    *rows = (2 << (y1 - row * ROWS) / SIDE) - (1 << (y0 - row * ROWS) / SIDE);
};

// Where the half axes of 16 splats, (u, v) in pixels, come to lie; their slopes and 1 / depth given.
auto half_axes = [&](int i, Floats slope_x, Floats slope_y, Floats inverse, Floats* u, Floats* v) {
#pragma clang fp contract(fast)
    const auto& V = view.viewmat;
    const Floats fx = view.focal[0] * inverse, fy = view.focal[1] * inverse;
    float spare[2][4 * LANES];
    const float* p = block(quats, 4, i, spare[0]);
    Floats qw = pick(p, 4), qx = pick(p + 1, 4), qy = pick(p + 2, 4), qz = pick(p + 3, 4);
    // A zero is no rotation, and what comes of it not finite.
    const Floats two = 2.f / (qw * qw + qx * qx + qy * qy + qz * qz);
    const Floats xx = two * qx * qx, yy = two * qy * qy, zz = two * qz * qz;
    const Floats xy = two * qx * qy, xz = two * qx * qz, yz = two * qy * qz;
    const Floats wx = two * qw * qx, wy = two * qw * qy, wz = two * qw * qz;
    const Floats rotation[3][3] = {{1.f - yy - zz, xy - wz, xz + wy},
                                   {xy + wz, 1.f - xx - zz, yz - wx},
                                   {xz - wy, yz + wx, 1.f - xx - yy}};
    p = block(scales, 3, i, spare[1]);
    for (int axis = 0; axis < 3; ++axis) {
        const Floats s = pick(p + axis, 3);
        u[axis] = v[axis] = all(0.f);
        for (int k = 0; k < 3; ++k) {
            const Floats r = rotation[k][axis] * s;
            u[axis] += (V[0][k] - slope_x * V[2][k]) * fx * r;
            v[axis] += (V[1][k] - slope_y * V[2][k]) * fy * r;
        }
    }
};

// What a part lists of its splats in projecting them.
struct Listing {
    unsigned* key;
    int *id, count;
    unsigned lowest, highest;  // of the keys
};

// Store sixteen projected splats, given as vectors, and list those that are drawn.
auto keep = [&](Floats* fields, Ints drawn, Floats depth, int i, int end, Listing& listing) {
    transpose(fields);
    const Ints bits = *(const Ints*)&depth;
    for (int lane = 0; lane < LANES && i + lane < end; ++lane) {
        *(Floats*)&splats[i + lane] = fields[lane];
        if (!drawn[lane]) continue;
        const unsigned key = bits[lane];
        listing.lowest = key < listing.lowest ? key : listing.lowest;
        listing.highest = key > listing.highest ? key : listing.highest;
        listing.key[listing.count] = key;
        listing.id[listing.count++] = i + lane;
    }
};

// EWA projection of the splats of one part; the visible ones are listed with their depth.
auto project_part = [&](int part) {
#pragma clang fp contract(fast)
    const auto& V = view.viewmat;
    const int begin = part * part_size, end = begin + part_size < n ? begin + part_size : n;
    Listing listing = {keys[0] + begin, ids[0] + begin, 0, ~0u, 0};
    for (int i = begin; i < end; i += LANES) {
        float spare[2][4 * LANES];
        const float* p = block(means, 3, i, spare[0]);
        const Floats x = pick(p, 3), y = pick(p + 1, 3), z = pick(p + 2, 3);
        const Floats depth = V[2][0] * x + V[2][1] * y + V[2][2] * z + V[2][3];
        const Floats inverse = 1.f / larger(depth, all(view.near));
        const Floats slope_x = (V[0][0] * x + V[0][1] * y + V[0][2] * z + V[0][3]) * inverse;
        const Floats slope_y = (V[1][0] * x + V[1][1] * y + V[1][2] * z + V[1][3]) * inverse;
        const Floats bent_x = between(slope_x, view.slope_min[0], view.slope_max[0]);
        const Floats bent_y = between(slope_y, view.slope_min[1], view.slope_max[1]);
        Floats u[3], v[3];
        half_axes(i, bent_x, bent_y, inverse, u, v);
        const Floats cov_xx = u[0] * u[0] + u[1] * u[1] + u[2] * u[2] + BLUR;
        const Floats cov_xy = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        const Floats cov_yy = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + BLUR;
        // |u × v|² keeps the determinant of a needle, where xx·yy - xy² would cancel.
        const Floats n0 = u[1] * v[2] - u[2] * v[1], n1 = u[2] * v[0] - u[0] * v[2],
                     n2 = u[0] * v[1] - u[1] * v[0];
        const Floats det = n0 * n0 + n1 * n1 + n2 * n2 + BLUR * (cov_xx + cov_yy - BLUR);

        const Floats opacity = pick(block(opacities, 1, i, spare[1]), 1);
        const Floats log2_opacity = LOG2_E * logarithm(opacity);
        const Floats reach = larger((2.f / LOG2_E) * (log2_opacity - LOG2_ALPHA_MIN), all(0.f));
        const Floats reach_x = root(reach * cov_xx), reach_y = root(reach * cov_yy);
        const Floats px = slope_x * view.focal[0] + view.principal[0];
        const Floats py = slope_y * view.focal[1] + view.principal[1];
        // Pixel centers lie at +0.5, so pixel i is covered where i + 0.5 is within reach.
        const Floats left = ceiling(larger(px - reach_x - (0.5f + SLACK), all(0.f)));
        const Floats right =
            flooring(smaller(px + reach_x - (0.5f - SLACK), all(view.width - 1.f)));
        const Floats top = ceiling(larger(py - reach_y - (0.5f + SLACK), all(0.f)));
        const Floats bottom =
            flooring(smaller(py + reach_y - (0.5f - SLACK), all(view.height - 1.f)));
        // What is not finite fails one of these comparisons.
        const Ints drawn = (depth > view.near) & (depth < view.far) & (opacity >= ALPHA_MIN) &
                           (opacity < 1e30f) & (det > 0.f) & (det < 1e30f) & (left <= right) &
                           (top <= bottom);

        const Floats bend = (-0.5f * LOG2_E) / det;
        Ints tile, rows;
        place(left, right, top, bottom, &tile, &rows);
        Floats fields[LANES] = {px,
                                py,
                                reach_x,
                                reach_y,
                                cov_xy / cov_xx,
                                det / (cov_xx * cov_xx),
                                *(const Floats*)&tile,
                                *(const Floats*)&rows,
                                cov_yy * bend,
                                -2.f * cov_xy * bend,
                                cov_xx * bend,
                                log2_opacity,
                                depth};
        keep(fields, drawn, depth, i, end, listing);
    }
    state.part_count[part] = listing.count;
    state.part_lowest[part] = listing.lowest;
    state.part_highest[part] = listing.highest;
};
