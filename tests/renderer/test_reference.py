"""The twin itself: its harmonics and its projection are what they claim."""

from __future__ import annotations

import numpy as np
from random_scenes import pinhole, random_scene

from renderer.reference import BLUR, project, rasterize_reference, rotations, sh_basis


def test_harmonics_are_orthonormal():
    # Gauss-Legendre in z and even steps round the axis are exact for these degrees.
    z, weight = np.polynomial.legendre.leggauss(12)
    angle = np.arange(24) * 2 * np.pi / 24
    rho = np.sqrt(1 - z * z)
    directions = np.stack(
        [np.outer(rho, np.cos(angle)), np.outer(rho, np.sin(angle)), np.outer(z, np.ones(24))], -1
    ).reshape(-1, 3)
    basis = sh_basis(directions, 4)
    weights = np.repeat(weight, 24) * 2 * np.pi / 24
    np.testing.assert_allclose(basis.T @ (weights[:, None] * basis), np.eye(25), atol=1e-12)


def test_rotations_are_rotations_and_ignore_length():
    quats = np.random.default_rng(0).normal(size=(20, 4))
    R = rotations(quats)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(rotations(-3 * quats), R)
    quarter = rotations(np.array([[1.0, 0, 0, 1]]))[0]
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_the_covariance_is_that_of_projected_samples():
    rng = np.random.default_rng(1)
    camera = pinhole(400, 300)
    mean, quat = np.array([[0.3, -0.2, 0.5]]), rng.normal(size=(1, 4))
    scale = np.array([[2e-3, 5e-3, 1e-3]])
    splat = project(mean, quat, scale, **camera)
    points = mean + (rng.normal(size=(200_000, 3)) * scale) @ rotations(quat)[0].T
    pixels = points @ camera["viewmat"][:3, :3].T + camera["viewmat"][:3, 3]
    pixels = pixels @ camera["K"].T
    pixels = pixels[:, :2] / pixels[:, 2:]
    np.testing.assert_allclose(splat.centers[0], pixels.mean(0), atol=0.01)
    wanted = np.cov(pixels.T) + BLUR * np.eye(2)
    np.testing.assert_allclose(splat.covariances[0], wanted, rtol=0.02, atol=5e-3)


def test_alpha_and_depth_of_two_layers():
    scene = random_scene(2, 0, 2)
    scene["means"] = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    scene["scales"][:] = 100.0
    scene["opacities"] = np.array([0.5, 0.25])
    scene["sh"][:] = 0
    rgb, alpha, depth = rasterize_reference(**scene, **pinhole(3, 3), background=(1, 0, 0))
    seen = 0.25 + 0.75 * 0.5
    np.testing.assert_allclose(alpha[1, 1], seen, rtol=1e-4)
    np.testing.assert_allclose(depth[1, 1], (0.25 * 3 + 0.75 * 0.5 * 5) / seen, rtol=1e-4)
    np.testing.assert_allclose(
        rgb[1, 1], [0.5 * seen + 1 - seen, 0.5 * seen, 0.5 * seen], rtol=1e-4
    )
