// `from`, channels × points × inputs, to `to`, channels × points × outputs.
for (long p = points * part / parts; p < end; p += LANES) {
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, INPUTS, CHANNELS, p, count, x);
    run_network();
    scatter(raw, OUTPUTS, CHANNELS, p, count, given.to);
}
