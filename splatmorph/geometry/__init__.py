"""Rotations and similarities of space, and what they do to colours that depend on direction."""
