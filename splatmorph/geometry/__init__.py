"""Rotations of space, and what they do to colours that depend on the direction."""
