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

const Floats lane_index = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

auto load = [&](const float* p) -> Floats { return *(const UnalignedFloats*)p; };
auto store = [&](float* p, Floats v) { *(UnalignedFloats*)p = v; };
auto larger = [&](auto a, decltype(a) b) { return __builtin_elementwise_max(a, b); };
auto smaller = [&](auto a, decltype(a) b) { return __builtin_elementwise_min(a, b); };
auto root = [&](auto a) { return __builtin_elementwise_sqrt(a); };
auto ceiling = [&](auto a) { return __builtin_elementwise_ceil(a); };
auto flooring = [&](auto a) { return __builtin_elementwise_floor(a); };
auto all = [&](float x) -> Floats { return (Floats)x; };

auto pick = [&](const float* rows, int stride) -> Floats {
    Floats v;
    for (int lane = 0; lane < LANES; ++lane) v[lane] = rows[lane * stride];
    return v;
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
