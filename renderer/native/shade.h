// Colours of 16 splats. The harmonics are computed for all of them at once; then each splat
// sums its own coefficients, which lie together in memory, three floats in one load of four.
auto shade = [&](const int* id, int count) {
#pragma clang fp contract(fast)
    if (!count || channels) return;
    float basis[25][LANES];
    Floats across, down;
    for (int lane = 0; lane < LANES; ++lane) {
        const Splat& splat = splats[id[lane < count ? lane : 0]];
        across[lane] = splat.x, down[lane] = splat.y;
    }
    // Where a splat is seen tells its direction; its center lies elsewhere in memory.
    across = (across - view.principal[0]) / view.focal[0];
    down = (down - view.principal[1]) / view.focal[1];
    const auto& W = view.to_world;
    Floats x = W[0][0] * across + W[0][1] * down + W[0][2];
    Floats y = W[1][0] * across + W[1][1] * down + W[1][2];
    Floats z = W[2][0] * across + W[2][1] * down + W[2][2];
    const Floats inverse = 1.f / root(x * x + y * y + z * z);
    x *= inverse, y *= inverse, z *= inverse;
    const Floats xx = x * x, yy = y * y, zz = z * z;
    store(basis[0], all(0.28209479177387814f));
    if (degree > 0) {
        store(basis[1], -0.4886025119029199f * y);
        store(basis[2], 0.4886025119029199f * z);
        store(basis[3], -0.4886025119029199f * x);
    }
    if (degree > 1) {
        store(basis[4], 1.0925484305920792f * x * y);
        store(basis[5], -1.0925484305920792f * y * z);
        store(basis[6], 0.31539156525252005f * (2.f * zz - xx - yy));
        store(basis[7], -1.0925484305920792f * x * z);
        store(basis[8], 0.5462742152960396f * (xx - yy));
    }
    if (degree > 2) {
        store(basis[9], -0.5900435899266435f * y * (3.f * xx - yy));
        store(basis[10], 2.890611442640554f * x * y * z);
        store(basis[11], -0.4570457994644658f * y * (4.f * zz - xx - yy));
        store(basis[12], 0.3731763325901154f * z * (2.f * zz - 3.f * xx - 3.f * yy));
        store(basis[13], -0.4570457994644658f * x * (4.f * zz - xx - yy));
        store(basis[14], 1.445305721320277f * z * (xx - yy));
        store(basis[15], -0.5900435899266435f * x * (xx - 3.f * yy));
    }
    if (degree > 3) {
        store(basis[16], 2.5033429417967046f * x * y * (xx - yy));
        store(basis[17], -1.7701307697799304f * y * z * (3.f * xx - yy));
        store(basis[18], 0.9461746957575601f * x * y * (7.f * zz - 1.f));
        store(basis[19], -0.6690465435572892f * y * z * (7.f * zz - 3.f));
        store(basis[20], 0.10578554691520431f * (zz * (35.f * zz - 30.f) + 3.f));
        store(basis[21], -0.6690465435572892f * x * z * (7.f * zz - 3.f));
        store(basis[22], 0.47308734787878004f * (xx - yy) * (7.f * zz - 1.f));
        store(basis[23], -1.7701307697799304f * x * z * (xx - 3.f * yy));
        store(basis[24], 0.6258357354491761f * (xx * (xx - 3.f * yy) - yy * (3.f * xx - yy)));
    }
    const int used = (degree + 1) * (degree + 1);
    for (int lane = 0; lane < count; ++lane) {
        const float* c = sh + (long)id[lane] * coefficients * 3;
        // The last coefficient of all has no fourth float behind it.
        const int wide = used - (id[lane] == n - 1);
        Float4 even = (Float4)0.5f, odd = (Float4)0.f;
        for (int k = 0; k + 1 < wide; k += 2) {
            even += basis[k][lane] * *(const UnalignedFloat4*)(c + 3 * k);
            odd += basis[k + 1][lane] * *(const UnalignedFloat4*)(c + 3 * k + 3);
        }
        Float4 color = even + odd;
        for (int k = wide & ~1; k < used; ++k)
            for (int channel = 0; channel < 3; ++channel)
                color[channel] += basis[k][lane] * c[3 * k + channel];
        // fmax of a NaN and 0 is 0: a broken colour is black.
        color = __builtin_elementwise_max(color, (Float4)0.f);
        Splat& splat = splats[id[lane]];
        splat.red = color[0], splat.green = color[1], splat.blue = color[2];
    }
};
