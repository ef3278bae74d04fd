// Sixteen floats at a time.
constexpr int LANES = 16;
typedef float Floats __attribute__((ext_vector_type(16)));
typedef int Ints __attribute__((ext_vector_type(16)));

// sin x, and cos x beside it.
auto sine_cosine = [](Floats x, Floats& cosine) -> Floats {
// x = nπ + r, |r| ≤ π/2: (-1)ⁿ times the Taylor polynomials to r¹¹ and r¹² (6e-8 and 6e-9).
#pragma clang fp contract(fast)
    const Floats n = __builtin_elementwise_floor(x * 0.318309886f + 0.5f);
    const Floats r = (x - n * 3.140625f) - n * 9.67653589793e-4f, s = r * r;
    Floats p = s * -2.5052108e-8f + 2.7557319e-6f;
    p = p * s + -1.9841270e-4f;
    p = p * s + 8.3333333e-3f;
    p = p * s + -1.6666667e-1f;
    p = r + r * s * p;
    Floats q = s * 2.0876757e-9f + -2.7557319e-7f;
    q = q * s + 2.4801587e-5f;
    q = q * s + -1.3888889e-3f;
    q = q * s + 4.1666667e-2f;
    q = q * s + -0.5f;
    q = 1.f + s * q;
    const Ints odd = __builtin_convertvector(n, Ints) << 31;
    const Ints sine_bits = *(Ints*)&p ^ odd, cosine_bits = *(Ints*)&q ^ odd;
    cosine = *(Floats*)&cosine_bits;
    return *(Floats*)&sine_bits;
};

auto exponential = [](Floats x) -> Floats {
// eˣ = 2ⁿ eʳ, |r| ≤ log(2)/2, with Taylor's polynomial to r⁶ (1e-7), clamped to finite floats.
#pragma clang fp contract(fast)
    const Floats y =
        __builtin_elementwise_min(__builtin_elementwise_max(x, (Floats)-87.f), (Floats)88.f);
    const Floats n = __builtin_elementwise_floor(y * 1.44269504f + 0.5f);
    const Floats r = (y - n * 0.693359375f) + n * 2.12194440e-4f;
    Floats p = r * 1.3888889e-3f + 8.3333333e-3f;
    p = p * r + 4.1666667e-2f;
    p = p * r + 1.6666667e-1f;
    p = p * r + 0.5f;
    p = p * r * r + r + 1.f;
    const Ints bits = (__builtin_convertvector(n, Ints) + 127) << 23;
    return p * *(const Floats*)&bits;
};
