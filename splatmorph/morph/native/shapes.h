// The shapes of splats under a path of Jacobians, 8 splats at a time. The plain twin is
// carried_shapes in covariance.py, which says what is computed and why.
// Compiled once for each (STRETCH, Stored); doubles inside, for needles and pancakes.
struct Arguments {                                   // the twin of shapes.py's
    const Stored *quats_in, *log_scales_in;          // count × 4 and × 3
    const Stored* jacobians;                         // knots × count × 3 × 3, `strides` apart
    Stored *quats_out, *log_scales_out, *turns_out;  // knots × count × 4, × 3 and × 4
    long long knots, count, strides[4];
};
const Arguments& given = *(const Arguments*)arguments;
constexpr int LANES = 8;
typedef double Doubles __attribute__((ext_vector_type(8)));
typedef decltype(Doubles() < Doubles()) Words;
struct Matrix {
    Doubles at[3][3];
};
struct Quat {
    Doubles at[4];
};

auto all = [](double x) -> Doubles { return (Doubles)x; };
auto root = [](Doubles x) { return __builtin_elementwise_sqrt(x); };
auto size = [](Doubles x) { return __builtin_elementwise_abs(x); };
auto any = [](Words mask) -> bool { return __builtin_reduce_or(mask) != 0; };
auto dot = [](const Doubles* a, const Doubles* b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
};

auto cofactors = [](const Matrix& m) -> Matrix {
    Matrix c;
    for (int i = 0; i < 3; ++i) {
        const Doubles* const a = m.at[(i + 1) % 3];
        const Doubles* const b = m.at[(i + 2) % 3];
        for (int j = 0; j < 3; ++j) {
            const int k = (j + 1) % 3, l = (j + 2) % 3;
            c.at[i][j] = a[k] * b[l] - a[l] * b[k];
        }
    }
    return c;
};

auto matrix_of = [&](const Quat& q) -> Matrix {
    Doubles squared = all(0);
    for (int i = 0; i < 4; ++i) squared += q.at[i] * q.at[i];
    const Doubles two = 2 / squared, w = q.at[0], x = q.at[1], y = q.at[2], z = q.at[3];
    return {{{1 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)},
             {two * (x * y + w * z), 1 - two * (x * x + z * z), two * (y * z - w * x)},
             {two * (x * z - w * y), two * (y * z + w * x), 1 - two * (x * x + y * y)}}};
};

// Newton's iteration begun at unit determinant; the identity where it finds nothing.
auto polar_rotation = [&](const Matrix& jacobian) -> Matrix {
    Matrix p = jacobian, c = cofactors(p);
    Doubles determinant = dot(p.at[0], c.at[0]), factor;
    for (int l = 0; l < LANES; ++l) factor[l] = 1 / cbrt(determinant[l]);
    for (int i = 0; i < 9; ++i) p.at[i / 3][i % 3] *= factor;
    for (int n = 0; n < SWEEPS; ++n) {
        c = cofactors(p);
        const Doubles inverse = 1 / dot(p.at[0], c.at[0]);
        Words far = (Words)0;
        for (int i = 0; i < 9; ++i) {
            Doubles& old = p.at[i / 3][i % 3];
            const Doubles next = 0.5 * (old + c.at[i / 3][i % 3] * inverse);
            far |= size(next - old) > NEWTON_STEP;
            old = next;
        }
        if (!any(far)) break;
    }
    Doubles sum = all(0);
    for (int i = 0; i < 9; ++i) sum += size(p.at[i / 3][i % 3]);
    const Words found = sum < 1e300;
    for (int i = 0; i < 9; ++i) {
        Doubles& entry = p.at[i / 3][i % 3];
        entry = found ? entry : all(i % 4 == 0);
    }
    return p;
};

// Shepperd's choice, on the side of `before`.
auto quaternion_of = [&](const Matrix& m, const Quat& before) -> Quat {
    const auto& [a, b, c] = m.at;
    const Doubles rows[4][4] = {{1 + a[0] + b[1] + c[2], c[1] - b[2], a[2] - c[0], b[0] - a[1]},
                                {c[1] - b[2], 1 + a[0] - b[1] - c[2], a[1] + b[0], a[2] + c[0]},
                                {a[2] - c[0], a[1] + b[0], 1 - a[0] + b[1] - c[2], b[2] + c[1]},
                                {b[0] - a[1], a[2] + c[0], b[2] + c[1], 1 - a[0] - b[1] + c[2]}};
    Quat q;
    Doubles largest = all(-1);
    for (int r = 0; r < 4; ++r) {
        const Words better = rows[r][r] > largest;
        largest = better ? rows[r][r] : largest;
        for (int i = 0; i < 4; ++i) q.at[i] = better ? rows[r][i] : q.at[i];
    }
    Doubles squared = all(0), along = all(0);
    for (int i = 0; i < 4; ++i) {
        squared += q.at[i] * q.at[i];
        along += q.at[i] * before.at[i];
    }
    const Doubles length = root(squared), factor = 1 / (along < 0 ? -length : length);
    for (int i = 0; i < 4; ++i) q.at[i] *= factor;
    return q;
};

auto product = [](const Quat& left, const Quat& right) -> Quat {
    const auto& [w, x, y, z] = left.at;
    const auto& [a, b, c, d] = right.at;
    return {{w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
             w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a}};
};

// Turn the axes until the rows of columns[axis] are orthogonal, by the least angles that do.
auto orthogonalise = [&](Doubles (&columns)[3][3], Quat& axes) {
#pragma clang fp contract(fast)
    for (int n = 0; n < SWEEPS; ++n) {
        bool rested = true;
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            const Doubles shared = dot(columns[i], columns[j]);
            const Doubles first = dot(columns[i], columns[i]), second = dot(columns[j], columns[j]);
            const Words skew = size(shared) > PARALLEL * root(first * second);
            if (!any(skew)) continue;
            rested = false;
            const Doubles gap = first - second;
            const Doubles reach = root(gap * gap + 4 * shared * shared);
            const Doubles tangent = 2 * shared / (gap < 0 ? gap - reach : gap + reach);
            const Doubles slope = skew ? tangent : all(0);
            const Doubles cosine = 1 / root(1 + slope * slope), sine = slope * cosine;
            const Doubles half = root(0.5 + 0.5 * cosine), half_sine = 0.5 * sine / half;
            auto turn = [](Doubles& a, Doubles& b, Doubles c, Doubles s) {
                const Doubles kept = a;
                a = c * kept + s * b;
                b = c * b - s * kept;
            };
            for (int r = 0; r < 3; ++r) turn(columns[i][r], columns[j][r], cosine, sine);
            turn(axes.at[1 + i], axes.at[1 + j], half, half_sine);
            turn(axes.at[1 + k], axes.at[0], half, half_sine);
        }
        if (rested) break;
    }
};

const long count = given.count;
const long groups = (count + LANES - 1) / LANES;
const long end = groups * (part + 1) / parts;
for (long group = groups * part / parts; group < end; ++group) {
#pragma clang fp contract(fast)
    const long first = group * LANES;
    const int lanes = count - first < LANES ? (int)(count - first) : LANES;
    auto place = [&](int lane) -> long { return first + (lane < lanes ? lane : 0); };
    Quat start;
    Doubles log_scales[3], scales[3], largest;
    for (int l = 0; l < LANES; ++l) {
        for (int i = 0; i < 4; ++i) start.at[i][l] = given.quats_in[place(l) * 4 + i];
        for (int i = 0; i < 3; ++i) log_scales[i][l] = given.log_scales_in[place(l) * 3 + i];
    }
    largest = __builtin_elementwise_max(log_scales[0], log_scales[1]);
    largest = __builtin_elementwise_max(largest, log_scales[2]);
    for (int i = 0; i < 3; ++i)
        for (int l = 0; l < LANES; ++l) {
            const double relative = log_scales[i][l] - largest[l];
            scales[i][l] = exp(relative > LEAST ? relative : LEAST);
        }
    const Matrix rotation = matrix_of(start);
    Quat axes = start, turn = {{all(1), all(0), all(0), all(0)}};
    for (long knot = 0; knot < given.knots; ++knot) {
        Matrix jacobian;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                for (int l = 0; l < LANES; ++l) {
                    const long index[] = {knot, place(l), i, j};
                    long at = 0;
                    for (int k = 0; k < 4; ++k) at += index[k] * given.strides[k];
                    jacobian.at[i][j][l] = given.jacobians[at];
                }
        const Matrix polar = polar_rotation(jacobian);
        turn = quaternion_of(polar, turn);
        Doubles pushed[3] = {log_scales[0], log_scales[1], log_scales[2]};
        if constexpr (STRETCH) {
            Matrix stretch;
            for (int i = 0; i < 9; ++i) {
                stretch.at[i / 3][i % 3] = all(0);
                for (int k = 0; k < 3; ++k)
                    stretch.at[i / 3][i % 3] += polar.at[k][i / 3] * jacobian.at[k][i % 3];
            }
            // Row r of axis i: the stretched axis r of Σ's root, seen along the axis i of before.
            const Matrix nearby = matrix_of(axes);
            Doubles columns[3][3];
            for (int r = 0; r < 3; ++r) {
                Doubles stretched[3];
                for (int i = 0; i < 3; ++i) {
                    stretched[i] = all(0);
                    for (int k = 0; k < 3; ++k)
                        stretched[i] += stretch.at[i][k] * rotation.at[k][r];
                    stretched[i] *= scales[r];
                }
                for (int i = 0; i < 3; ++i) {
                    columns[i][r] = all(0);
                    for (int k = 0; k < 3; ++k) columns[i][r] += stretched[k] * nearby.at[k][i];
                }
            }
            orthogonalise(columns, axes);
            for (int i = 0; i < 3; ++i) {
                const Doubles squared = dot(columns[i], columns[i]);
                for (int l = 0; l < LANES; ++l) pushed[i][l] = 0.5 * log(squared[l]) + largest[l];
            }
        }
        const Quat turned = product(turn, axes);
        for (int l = 0; l < lanes; ++l) {
            const long row = knot * count + first + l;
            for (int i = 0; i < 4; ++i) given.quats_out[row * 4 + i] = (Stored)turned.at[i][l];
            for (int i = 0; i < 3; ++i) given.log_scales_out[row * 3 + i] = (Stored)pushed[i][l];
            for (int i = 0; i < 4; ++i) given.turns_out[row * 4 + i] = (Stored)turn.at[i][l];
        }
    }
}
