"""The two people of the sample pair, as parameters."""

from __future__ import annotations

from dataclasses import dataclass

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Person:
    """Measures in millimetres, colours in sRGB [0, 1].

    The origin lies between the eyes' level and the middle of the head: x to the person's left,
    y up, z forward.
    """

    name: str
    seed: int
    # skull and face
    cranium: tuple[float, float, float] = (75, 82, 96)
    face: tuple[float, float, float] = (59, 84, 66)
    forehead_z: float = 84
    brow_ridge: float = 8.0
    brow_drop: float = 0.0
    cheekbone: tuple[float, float, float] = (46, -24, 58)
    cheekbone_size: float = 18
    cheek_fill: float = 0.0
    jaw_half_width: float = 47
    jaw_y: float = -70
    jaw_radius: float = 15
    chin: tuple[float, float, float] = (0, -102, 78)
    chin_radii: tuple[float, float, float] = (17, 14, 14)
    # eyes
    eye_x: float = 31.5
    eye_z: float = 69
    eye_half_width: float = 14.5
    lid_upper: float = 5.6
    lid_lower: float = 4.6
    eye_tilt: float = 0.08
    lid_fold: float = 1.0
    # nose
    nose_tip: tuple[float, float, float] = (0, -38, 114)
    nose_tip_radius: float = 9
    bridge_radius: float = 6.5
    bridge_bump: float = 0.0
    nostril_x: float = 11
    nostril_radius: float = 7.2
    # mouth
    mouth_y: float = -70
    mouth_z: float = 92
    mouth_half_width: float = 25
    lip_upper: float = 5.0
    lip_lower: float = 6.0
    smile: float = 0.5
    # ears and neck
    ear_x: float = 70
    ear_height: float = 62
    ear_flare: float = 22
    neck_radius: float = 54
    throat: float = 0.0
    age: float = 0.0
    # colours
    skin: Rgb = (0.85, 0.66, 0.56)
    blush: Rgb = (0.80, 0.45, 0.38)
    lips: Rgb = (0.72, 0.40, 0.38)
    iris: Rgb = (0.35, 0.45, 0.50)
    hair: Rgb = (0.25, 0.15, 0.10)
    hair_tip: Rgb = (0.45, 0.28, 0.18)
    brow: Rgb = (0.20, 0.13, 0.10)
    cloth: Rgb = (0.20, 0.28, 0.40)
    brow_arch: float = 5.0
    brow_width: float = 6.0
    brow_hairs: int = 420
    # hair: |azimuth| in degrees from the front -> height of the hairline
    hairline: tuple[tuple[float, float], ...] = ()
    bun: bool = False
    studs: bool = False
    beard: bool = False
    collar_y: float = -165
    collar_lift: float = 4.0


INES = Person(
    name="ines",
    seed=11,
    cranium=(72, 80, 93),
    face=(50, 80, 64),
    forehead_z=85,
    brow_ridge=4.0,
    brow_drop=-2.0,
    cheekbone=(42, -21, 58),
    cheekbone_size=16,
    cheek_fill=0.5,
    jaw_half_width=32,
    jaw_y=-62,
    jaw_radius=12,
    chin=(0, -98, 79),
    chin_radii=(10, 11, 12),
    eye_x=31,
    eye_half_width=16.0,
    lid_upper=6.9,
    lid_lower=5.6,
    eye_tilt=0.14,
    nose_tip=(0, -34, 111),
    nose_tip_radius=7.2,
    bridge_radius=4.4,
    nostril_x=8.6,
    nostril_radius=5.8,
    mouth_y=-64,
    mouth_half_width=23.0,
    lip_upper=7.4,
    lip_lower=8.6,
    smile=2.2,
    ear_x=66,
    ear_height=53,
    ear_flare=15,
    neck_radius=40,
    skin=(0.80, 0.58, 0.44),
    blush=(0.78, 0.40, 0.32),
    lips=(0.66, 0.30, 0.28),
    iris=(0.26, 0.34, 0.17),
    hair=(0.16, 0.085, 0.055),
    hair_tip=(0.36, 0.20, 0.12),
    brow=(0.20, 0.12, 0.085),
    cloth=(0.12, 0.42, 0.40),
    hairline=(
        (0, 70),
        (20, 66),
        (36, 54),
        (50, 34),
        (62, 15),
        (74, 2),
        (84, 8),
        (100, 16),
        (125, -30),
        (180, -52),
    ),
    bun=True,
    studs=True,
    brow_arch=7.0,
    brow_width=4.0,
    brow_hairs=360,
    collar_y=-170,
)

OTTO = Person(
    name="otto",
    seed=23,
    cranium=(79, 83, 99),
    face=(63, 86, 67),
    forehead_z=84,
    brow_ridge=10.5,
    brow_drop=2.0,
    cheekbone=(47, -27, 57),
    cheekbone_size=18,
    jaw_half_width=54,
    jaw_y=-74,
    jaw_radius=17,
    chin=(0, -108, 80),
    chin_radii=(24, 16, 15),
    eye_x=33,
    eye_z=67.5,
    eye_half_width=13.8,
    lid_upper=4.7,
    lid_lower=4.4,
    eye_tilt=-0.04,
    nose_tip=(0, -43, 120),
    nose_tip_radius=11.5,
    bridge_radius=8.0,
    bridge_bump=3.0,
    nostril_x=14,
    nostril_radius=8.8,
    mouth_y=-77,
    mouth_z=93,
    mouth_half_width=26,
    lip_upper=4.6,
    lip_lower=6.4,
    smile=0.2,
    ear_x=74,
    ear_height=68,
    ear_flare=22,
    neck_radius=60,
    throat=1.0,
    age=1.0,
    skin=(0.90, 0.71, 0.63),
    blush=(0.84, 0.46, 0.40),
    lips=(0.72, 0.48, 0.44),
    iris=(0.30, 0.48, 0.62),
    hair=(0.50, 0.49, 0.48),
    hair_tip=(0.86, 0.85, 0.83),
    brow=(0.45, 0.42, 0.40),
    cloth=(0.11, 0.29, 0.36),
    hairline=(
        (0, 88),
        (18, 92),
        (34, 98),
        (48, 72),
        (62, 34),
        (76, -18),
        (86, -10),
        (100, 18),
        (125, -40),
        (180, -66),
    ),
    beard=True,
    brow_arch=5.0,
    brow_width=7.5,
    brow_hairs=520,
    collar_y=-142,
    collar_lift=6.0,
)
