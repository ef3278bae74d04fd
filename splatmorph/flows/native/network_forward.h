// `from`, channels × points × inputs, to `to`, channels × points × outputs.
for (long p = points * part / parts; p < end; p += LANES) {
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, inputs, channels, p, count, x);
    run_network(p, count);
    scatter(raw, outputs, channels, p, count, given.to);
}
