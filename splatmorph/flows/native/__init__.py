"""The flow of a field, integrated in C++ that Warp compiles for this CPU."""
