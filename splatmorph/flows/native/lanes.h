// Sixteen floats at a time.
constexpr int LANES = 16;
typedef float Floats __attribute__((ext_vector_type(16)));
typedef int Ints __attribute__((ext_vector_type(16)));

auto sine = [](Floats x) -> Floats {
    // x = nπ + r, |r| ≤ π/2: sin x = (-1)ⁿ sin r, with Taylor's odd polynomial to r¹¹ (6e-8).
    #pragma clang fp contract(fast)
    const Floats n = __builtin_elementwise_floor(x * 0.318309886f + 0.5f);
    const Floats r = (x - n * 3.140625f) - n * 9.67653589793e-4f, s = r * r;
    Floats p = s * -2.5052108e-8f + 2.7557319e-6f;
    p = p * s + -1.9841270e-4f;
    p = p * s + 8.3333333e-3f;
    p = p * s + -1.6666667e-1f;
    p = r + r * s * p;
    const Ints odd = __builtin_convertvector(n, Ints) << 31;
    const Ints bits = *(Ints*)&p ^ odd;
    return *(Floats*)&bits;
};
