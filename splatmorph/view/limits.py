"""How much the viewers show, known without loading them."""

MAX_SPLATS = 200_000
"""Of a scene; more are thinned out."""
