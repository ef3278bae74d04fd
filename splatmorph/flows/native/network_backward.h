for (long p = points * part / parts; p < end; p += LANES) {
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, inputs, channels, p, count, x);
    gather(given.slope_to, outputs, channels, p, count, slope_raw);
    recall_network(p, count);
    reverse_network();
    scatter(slope_x, inputs, channels, p, count, given.slope_from);
}
