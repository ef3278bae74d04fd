// A vector of 16 floats is one register with AVX-512, two with AVX2, four with SSE or NEON:
// the compiler splits it, so that the code below says what is done and not on which machine.
constexpr int LANES = 16;
typedef float Floats __attribute__((ext_vector_type(16)));
typedef int Ints __attribute__((ext_vector_type(16)));
typedef float Float4 __attribute__((ext_vector_type(4)));
typedef int Int4 __attribute__((ext_vector_type(4)));
typedef Floats UnalignedFloats __attribute__((aligned(4)));
typedef Float4 UnalignedFloat4 __attribute__((aligned(4)));
typedef unsigned long long Word;

// The pixels of a block are the lanes of a vector, row by row.
const Floats lane_x = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
const Floats lane_y = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};

auto load = [&](const float* p) -> Floats { return *(const UnalignedFloats*)p; };
auto store = [&](float* p, Floats v) { *(UnalignedFloats*)p = v; };
// Of a NaN and a number these are the number where it comes second; one instruction, where the
// builtin's are three.
auto larger = [&](auto a, decltype(a) b) { return a > b ? a : b; };
auto smaller = [&](auto a, decltype(a) b) { return a < b ? a : b; };
auto root = [&](auto a) { return __builtin_elementwise_sqrt(a); };
auto ceiling = [&](auto a) { return __builtin_elementwise_ceil(a); };
auto flooring = [&](auto a) { return __builtin_elementwise_floor(a); };
auto all = [&](float x) -> Floats { return (Floats)x; };

auto between = [&](Floats v, float low, float high) -> Floats {
    return smaller(larger(v, all(low)), all(high));
};

auto pick = [&](const float* rows, int stride) -> Floats {
    Floats v;
    for (int lane = 0; lane < LANES; ++lane) v[lane] = rows[lane * stride];
    return v;
};

// One step of a transposition: between vectors so far apart, swap the lanes so far apart.
auto swap_lanes = [&](Floats* v, auto apart) {
    constexpr int d = apart();
    // Of a the lanes without the bit d, of b those with it; from there d lanes on, or none.
    constexpr auto from = [](int k, int on) { return (k & d ? LANES + k - d : k) + on; };
    for (int i = 0; i < LANES; ++i) {
        if (i & d) continue;
        const Floats a = v[i], b = v[i + d];
        v[i] = __builtin_shufflevector(a, b, from(0, 0), from(1, 0), from(2, 0), from(3, 0),
                                       from(4, 0), from(5, 0), from(6, 0), from(7, 0), from(8, 0),
                                       from(9, 0), from(10, 0), from(11, 0), from(12, 0),
                                       from(13, 0), from(14, 0), from(15, 0));
        v[i + d] = __builtin_shufflevector(a, b, from(0, d), from(1, d), from(2, d), from(3, d),
                                           from(4, d), from(5, d), from(6, d), from(7, d),
                                           from(8, d), from(9, d), from(10, d), from(11, d),
                                           from(12, d), from(13, d), from(14, d), from(15, d));
    }
};

// Sixteen vectors as the columns of what they were the rows of.
auto transpose = [&](Floats* v) {
    swap_lanes(v, [] { return 8; });
    swap_lanes(v, [] { return 4; });
    swap_lanes(v, [] { return 2; });
    swap_lanes(v, [] { return 1; });
};

// Natural logarithm, relative error 1e-7 (Cephes' polynomial on [sqrt(1/2), sqrt(2))).
auto logarithm = [&](Floats x) -> Floats {
#pragma clang fp contract(fast)
    Ints bits = *(Ints*)&x;
    Ints exponent = (bits - 0x3f3504f3) >> 23;
    bits -= exponent << 23;
    const Floats f = *(Floats*)&bits - 1.f, ff = f * f;
    Floats p = all(7.0376836292e-2f);
    const float c[] = {-1.1514610310e-1f, 1.1676998740e-1f, -1.2420140846e-1f, 1.4249322787e-1f,
                       -1.6668057665e-1f, 2.0000714765e-1f, -2.4999993993e-1f, 3.3333331174e-1f};
    for (int i = 0; i < 8; ++i) p = p * f + c[i];
    const Floats e = __builtin_convertvector(exponent, Floats);
    return e * 0.693359375f + (f * ff * p + (e * -2.12194440e-4f - 0.5f * ff) + f);
};
