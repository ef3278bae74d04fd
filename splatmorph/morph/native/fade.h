// Opacities and scales under the ramp `calibrated`, whose plain twin is in ramps.py.
struct Arguments {                       // the twin of fade.py's
    const float *logits, *log_scales;    // count and count × 3
    const float* weights;                // count, or null: one weight, that of the table's row
    const float* table;                  // rows × (STEPS + 1) × 3: a/α, k, and a/α for 1 - w
    float *logits_out, *log_scales_out;  // as above, or the same
    long long count;
};
const Arguments& given = *(const Arguments*)arguments;
const long end = given.count * (part + 1) / parts;
for (long p = given.count * part / parts; p < end; ++p) {
    const float logit = given.logits[p];
    const float low = __builtin_expf(-__builtin_fabsf(logit)), shown = 1.f / (1.f + low);
    const float opacity = logit < 0.f ? low * shown : shown;
    const float clear = logit < 0.f ? shown : low * shown;
    const float drawn = __builtin_fminf(__builtin_fmaxf(opacity, 1e-12f), DENSEST);

    const float column = drawn * (STEPS / DENSEST);
    const int left = column < STEPS - 1 ? (int)column : STEPS - 1;
    const float along = column - left;
    float found[3];
    if (given.weights) {
        const float weight = given.weights[p];
        const float place = __builtin_fminf(__builtin_fmaxf(weight * WEIGHTS, 1.f), WEIGHTS - 1.f);
        const int above = place < WEIGHTS - 2 ? (int)place : WEIGHTS - 2;
        const float across = place - above;
        const float* const one = given.table + ((above - 1) * (STEPS + 1) + left) * 3;
        const float* const other = one + (STEPS + 1) * 3;
        for (int i = 0; i < 3; ++i) {
            const float first = one[i] + along * (one[i + 3] - one[i]);
            const float second = other[i] + along * (other[i + 3] - other[i]);
            found[i] = first + across * (second - first);
        }
        // Before the first weight of the table and after its last, straight on to 0 and to 1.
        const float faint = __builtin_fminf(weight * WEIGHTS, 1.f);
        const float near = __builtin_fminf((1.f - weight) * WEIGHTS, 1.f);
        found[0] = __builtin_fmaxf(faint * (1.f - (1.f - found[0]) * near), 1e-12f);
        found[1] = 1.f + (found[1] - 1.f) * near;
        found[2] = __builtin_fmaxf(near * (1.f - (1.f - found[2]) * faint), 1e-12f);
    } else {
        const float* const row = given.table + left * 3;
        for (int i = 0; i < 3; ++i) found[i] = row[i] + along * (row[i + 3] - row[i]);
    }
    const float raised = found[0] * (1.f + FAINTEST / drawn);
    const float factor = __builtin_fminf(__builtin_fminf(raised, found[0] / found[2]), 1.f);

    // The logit of factor × opacity in logarithms, since either may be next to 0 or to 1.
    const float left_over = __builtin_fmaxf((1.f - factor) + factor * clear, 1e-38f);
    given.logits_out[p] = __builtin_fminf(logit, 0.f) + __builtin_logf(factor * shown / left_over);
    const float narrower = 0.5f * __builtin_logf(found[1]);
    for (int i = 0; i < 3; ++i)
        given.log_scales_out[p * 3 + i] = given.log_scales[p * 3 + i] - narrower;
}
