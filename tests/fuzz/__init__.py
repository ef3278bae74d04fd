"""Damaged files for every reader, made of whole ones: ``python -m tests.fuzz --minutes 5``."""
