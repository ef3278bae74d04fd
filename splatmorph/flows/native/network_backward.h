for (long p = points * part / parts; p < end; p += LANES) {
    const int count = end - p < LANES ? (int)(end - p) : LANES;
    gather(given.from, INPUTS, CHANNELS, p, count, x);
    gather(given.slope_to, OUTPUTS, CHANNELS, p, count, slope_raw);
    run_network();
    reverse_network();
    scatter(slope_x, INPUTS, CHANNELS, p, count, given.slope_from);
}
