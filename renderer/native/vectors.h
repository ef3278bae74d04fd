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

// Sixteen vectors as the columns of what they were the rows of.
auto transpose = [&](Floats* v) {
    for (int i = 0; i < LANES; ++i)
        if (!(i & 8)) {
            const Floats a = v[i], b = v[i + 8];
            v[i] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22,
                                           23);
            v[i + 8] = __builtin_shufflevector(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27,
                                               28, 29, 30, 31);
        }
    for (int i = 0; i < LANES; ++i)
        if (!(i & 4)) {
            const Floats a = v[i], b = v[i + 4];
            v[i] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25,
                                           26, 27);
            v[i + 4] = __builtin_shufflevector(a, b, 4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28,
                                               29, 30, 31);
        }
    for (int i = 0; i < LANES; ++i)
        if (!(i & 2)) {
            const Floats a = v[i], b = v[i + 2];
            v[i] = __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13,
                                           28, 29);
            v[i + 2] = __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14,
                                               15, 30, 31);
        }
    for (int i = 0; i < LANES; ++i)
        if (!(i & 1)) {
            const Floats a = v[i], b = v[i + 1];
            v[i] = __builtin_shufflevector(a, b, 0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28,
                                           14, 30);
            v[i + 1] = __builtin_shufflevector(a, b, 1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13,
                                               29, 15, 31);
        }
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
