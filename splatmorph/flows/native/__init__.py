"""C++ that Warp compiles for this CPU: the paths of a field, and networks with derivatives."""
