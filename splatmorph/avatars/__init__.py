"""Rigged heads (GaussianAvatars on FLAME): local splats in, world space and landmarks out."""

from splatmorph.avatars.avatar import Avatar, baked, load_avatar, track_of
from splatmorph.avatars.drive import Drive
from splatmorph.avatars.landmark_sets import LANDMARK_SETS, thin
from splatmorph.avatars.places import is_avatar
from splatmorph.avatars.posing import pose_warnings
from splatmorph.avatars.summary import AvatarSummary, summarize
from splatmorph.avatars.track import Track

__all__ = [
    "LANDMARK_SETS",
    "Avatar",
    "AvatarSummary",
    "Drive",
    "Track",
    "baked",
    "is_avatar",
    "load_avatar",
    "pose_warnings",
    "summarize",
    "thin",
    "track_of",
]
