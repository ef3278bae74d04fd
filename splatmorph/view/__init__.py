"""Pictures of a run: a page to share, streamlines, diagnostics, a contact sheet, a live viewer.

Nothing here is loaded by ``import splatmorph``; each module loads its own drawing package when
it draws.
"""
