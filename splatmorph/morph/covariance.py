"""Covariances under a map: J Σ Jᵀ as a quaternion and log scales again.

The Jacobian is split as J = P H, a rotation P after a stretch H (polar decomposition). With
Σ = R S² Rᵀ the pushed covariance is P (H R S)(H R S)ᵀ Pᵀ, so its axes are P V where V are the left
singular vectors of H R S and its scales the singular values. V is found by one-sided Jacobi
rotations, which keep the relative accuracy of the smallest scale (needles, pancakes) that forming
Σ would lose. They start from axes that are nearly right, R or those of the moment before, and
turn by the least angle, so axes neither flip nor change places along a sequence.

``carried_shapes`` is the whole way of splats under a path of Jacobians, and the plain twin of the
C++ in ``native/shapes.h``.

Matrices here have their indices first and the splats last, (3, 3, n), in float64: every line is a
pass over contiguous memory.
"""

from __future__ import annotations

import torch
from torch import Tensor

from splatmorph.geometry.quaternions import from_matrices, product, to_matrices

PAIRS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Two axes that a Jacobi rotation mixes, and the one it turns about."""

PARALLEL = 1e-6
"""Cosine of two axes that counts as a right angle; below it lies the rounding of a Jacobian."""

LEAST = -30.0
"""Log of the thinnest to the thickest scale of a splat below which it is a plane or a line."""

SWEEPS = 12
"""Upper bound of Jacobi sweeps and of Newton steps; both converge quadratically in 2 to 6."""

NEWTON_STEP = 1e-4
"""A Newton step so small is the last: the error after it is about half its square."""


def carried_shapes(
    quats: Tensor, log_scales: Tensor, jacobians: Tensor, *, stretch: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Shapes of Gaussians along a path.

    Arguments:
        quats, log_scales: (n, 4) and (n, 3), where the path begins.
        jacobians: (k, n, 3, 3), of the way from there to each of k moments in their order.
        stretch: whether Σ becomes J Σ Jᵀ, or with P from J = P H only P Σ Pᵀ.

    Returns:
        at each moment the quaternions (k, n, 4), the log scales (k, n, 3), and P as unit
        quaternions (k, n, 4). None jumps or changes its sign from one moment to the next.
    """
    start, scales = quats.double(), log_scales.double()
    axes, pushed = start, scales
    turn = start.new_tensor([1.0, 0.0, 0.0, 0.0])
    moments = []
    for jacobian in jacobians:
        jacobian = jacobian.double().permute(1, 2, 0).contiguous()
        rotation = polar_rotation(jacobian)
        turned = from_matrices(rotation.permute(2, 0, 1))
        turn = turned * torch.where((turned * turn).sum(-1, keepdim=True) < 0, -1, 1)
        if stretch:
            stretching = (rotation[:, :, None] * jacobian[:, None]).sum(0)
            axes, pushed = (x.T for x in stretched_axes(stretching, start.T, scales.T, axes.T))
        moments.append((product(turn, axes), pushed, turn))
    found, grown, turns = (torch.stack(each).to(quats) for each in zip(*moments, strict=True))
    return found, grown, turns


def polar_rotation(jacobians: Tensor) -> Tensor:
    """The rotation P nearest to J, J = P H: (3, 3, n) -> (3, 3, n).

    Newton's iteration P ← (P + P⁻ᵀ)/2 (Higham 1986), begun at J scaled to unit determinant. Where
    J folds space over (det J < 0, which no flow does but a baseline may) it is the rotation
    nearest to -J, and where J is singular the identity.
    """
    cofactors, determinant = _cofactors(jacobians)
    rotation = jacobians / (determinant.sign() * determinant.abs() ** (1 / 3))
    for _ in range(SWEEPS):
        cofactors, determinant = _cofactors(rotation)
        following = 0.5 * (rotation + cofactors / determinant)
        change = (following - rotation).abs().nan_to_num(0).amax() if len(determinant) else 0
        rotation = following
        if change < NEWTON_STEP:
            break
    identity = torch.eye(3).to(rotation)[:, :, None]
    return torch.where(rotation.isfinite().all(0).all(0), rotation, identity)


def _cofactors(matrices: Tensor) -> tuple[Tensor, Tensor]:
    cofactors = torch.stack(
        [torch.linalg.cross(matrices[j], matrices[k], dim=0) for j, k in ((1, 2), (2, 0), (0, 1))]
    )
    return cofactors, (matrices[0] * cofactors[0]).sum(0)


def orthogonalise(columns: Tensor, quats: Tensor) -> tuple[Tensor, Tensor]:
    """Rotate matrices (3, 3, n) from the right until their columns [:, i] are orthogonal.

    Returns them and the quaternions (4, n) turned along. The angles are the least that do, at most
    45° a rotation; columns that are orthogonal already stay where they are.
    """
    x, turned = list(columns.unbind(1)), list(quats.unbind(0))
    for _ in range(SWEEPS):
        rested = True
        for i, j, k in PAIRS:
            product = (x[i] * x[j]).sum(0)
            first, second = x[i].square().sum(0), x[j].square().sum(0)
            skew = product.abs() > PARALLEL * (first * second).sqrt()
            if not skew.any():
                continue
            rested = False
            half = torch.where(skew, 0.25 * torch.atan(2 * product / (first - second)), 0)
            cosine, sine = half.cos(), half.sin()
            for a, b in ((1 + i, 1 + j), (1 + k, 0)):
                turned[a], turned[b] = (
                    cosine * turned[a] + sine * turned[b],
                    cosine * turned[b] - sine * turned[a],
                )
            cosine, sine = cosine**2 - sine**2, 2 * cosine * sine
            x[i], x[j] = (
                cosine * x[i] + sine * x[j],
                cosine * x[j] - sine * x[i],
            )
        if rested:
            break
    return torch.stack(x, 1), torch.stack(turned)


def stretched_axes(
    stretch: Tensor, quats: Tensor, log_scales: Tensor, nearby: Tensor
) -> tuple[Tensor, Tensor]:
    """Axes and scales of H Σ Hᵀ for the Gaussians Σ = R S² Rᵀ.

    Arguments:
        stretch: H, (3, 3, n).
        quats, log_scales: R (4, n) and log S (3, n).
        nearby: (4, n) quaternions of axes to begin from and to stay close to.

    Returns:
        quaternions (4, n), as long as ``nearby``, and log scales (3, n).
    """
    largest = log_scales.amax(0)
    relative = (log_scales - largest).clamp_min(LEAST).exp()
    axes = (stretch[:, :, None] * _axes(quats)[None]).sum(1) * relative
    rows = (axes[:, :, None] * _axes(nearby)[:, None]).sum(0)
    columns, turned = orthogonalise(rows, nearby)
    return turned, 0.5 * columns.square().sum(0).log() + largest


def _axes(quats: Tensor) -> Tensor:
    return to_matrices(quats.T).permute(1, 2, 0)
