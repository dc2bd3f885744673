r"""What the batched solvers iterate: several steps in one function, the form in which it is compiled.

A column is one start of one target; all columns step at once, and none of them sees another. Chain, limits and
options are tensors that are passed in, not numbers baked in: the arm is described while the service runs, long after
the image was built, and one package then serves every chain with so many free joints. Baked in for the report's arm, a
step would save the links' turns, about a third of its multiplications; its sines, which cost most, stay.

Units are metres and radians; angles are u = q + offset of :class:`~armsight_control.folded.Folded`, targets in its
first frame.
"""

import torch

from armsight_control.torch_kinematics import Link, Vector, sines, split, tip_and_columns

DESCENT_STEPS = 10
"""Per call: a call costs some 5 µs, a step of 64 columns 1 µs; compiling takes longer with every step."""
DAMPED_STEPS = 1
"""Per call: a start takes about ten, and every further one in a call would be compiled for minutes."""

# Of the damping, m²/rad², between steps: the customary factors of Levenberg-Marquardt.
_TRUST, _DISTRUST = 0.2, 4.0
_LEAST_DAMPING, _MOST_DAMPING = 1e-10, 1e6


class Descent(torch.nn.Module):
    r"""Projected gradient descent with momentum on :math:`\tfrac12 \|p(u) - target\|^2`.

    .. math:: v \leftarrow \beta v - \gamma\, J^T (p - target), \qquad u \leftarrow clamp(u + v)

    After a limit stopped a joint, v is what it really moved. The gradient is the adjoint of the chain's product:
    each joint's is the moment of the error about its axis. Columns within the tolerance stay where they are.
    """

    def forward(
        self,
        u: torch.Tensor,
        v: torch.Tensor,
        target: torch.Tensor,
        links: torch.Tensor,
        bounds: torch.Tensor,
        scalars: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Takes :data:`DESCENT_STEPS` steps.

        Args:
            u: (n, columns).
            v: (n, columns), 0 at the start.
            target: (3, columns).
            links: (n, 5).
            bounds: (n, 3): lower, upper, step size gamma.
            scalars: (2,): momentum beta, square of the tolerance in m².

        Returns:
            u, v, and the squared error (columns,) before the last step; below the tolerance it is u's own.
        """
        angles, speeds = list(u.unbind()), list(v.unbind())
        n, chain, within, aim = len(angles), split(links), _rows(bounds), _vector(target)
        beta, tolerance = scalars.unbind()
        squared = aim[0]
        for _ in range(DESCENT_STEPS):
            turns = sines(angles)
            (x, y, z), arms = _tip_and_arms(turns, chain)
            error = (x - aim[0], y - aim[1], z - aim[2])
            squared = _dot(error, error)
            going = squared > tolerance
            for i in range(n):
                ex, ey, ez = error
                gradient = arms[i][0] * ey - arms[i][1] * ex
                if i + 1 < n:
                    (s, c), (*_, cosine, sine) = turns[i], chain[i]
                    ex, ey = c * ex + s * ey, c * ey - s * ex
                    error = (ex, cosine * ey + sine * ez, cosine * ez - sine * ey)
                lower, upper, size = within[i]
                moved = angles[i] + beta * speeds[i] - size * gradient
                moved = torch.minimum(torch.maximum(moved, lower), upper)
                moved = torch.where(going, moved, angles[i])
                speeds[i], angles[i] = moved - angles[i], moved
        return torch.stack(angles), torch.stack(speeds), squared


class Damped(torch.nn.Module):
    r"""Levenberg-Marquardt within limits, damped in task space.

    .. math:: \Delta u = -J^T (J J^T + \lambda I)^{-1} (p - target)

    The 3 x 3 system is solved by its adjugate. A joint that stands at a limit and would leave it is taken out, and the
    step computed again without it; what remains is clamped. Only a step that brings the tip nearer is taken.
    """

    def forward(
        self,
        u: torch.Tensor,
        damping: torch.Tensor,
        target: torch.Tensor,
        links: torch.Tensor,
        bounds: torch.Tensor,
        scalars: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Takes :data:`DAMPED_STEPS` steps.

        Args:
            u: (n, columns).
            damping: (columns,), lambda in m²/rad².
            target: (3, columns).
            links: (n, 5).
            bounds: (n, 2): lower, upper.
            scalars: (1,): square of the tolerance in m²; columns below stay where they are.

        Returns:
            u, lambda, the squared error (columns,), and the square of the projected gradient (columns,), m⁴/rad²: 0
            where within the limits no motion brings the tip nearer.
        """
        angles = list(u.unbind())
        chain, within, aim = split(links), _rows(bounds), _vector(target)
        error, columns = _error_and_columns(angles, aim, chain)
        squared = _dot(error, error)
        for _ in range(DAMPED_STEPS):
            step = _damped_step(columns, error, damping, None)
            inside = [_inside(a, d, limits) for a, d, limits in zip(angles, step, within, strict=True)]
            step = _damped_step(columns, error, damping, inside)
            tried = [
                torch.minimum(torch.maximum(a + d, lower), upper)
                for a, d, (lower, upper) in zip(angles, step, within, strict=True)
            ]
            tried_error, tried_columns = _error_and_columns(tried, aim, chain)
            tried_squared = _dot(tried_error, tried_error)
            going = squared > scalars[0]
            nearer = tried_squared < squared
            take = torch.logical_and(going, nearer)
            damping = torch.clamp(
                torch.where(nearer, damping * _TRUST, damping * _DISTRUST), _LEAST_DAMPING, _MOST_DAMPING
            )
            angles = [torch.where(take, t, a) for t, a in zip(tried, angles, strict=True)]
            error = _chosen(take, tried_error, error)
            columns = [_chosen(take, t, c) for t, c in zip(tried_columns, columns, strict=True)]
            squared = torch.where(take, tried_squared, squared)
        slope = torch.zeros_like(squared)
        for i, angle in enumerate(angles):
            gradient = _dot(columns[i], error)
            gradient = gradient * _inside(angle, -gradient, within[i])
            slope = slope + gradient * gradient
        return torch.stack(angles), damping, squared, slope


def _rows(table: torch.Tensor) -> list[tuple[torch.Tensor, ...]]:
    """The numbers of a table as scalars, once for all steps."""
    return [row.unbind() for row in table.unbind()]


def _vector(rows: torch.Tensor) -> Vector:
    x, y, z = rows.unbind()
    return x, y, z


def _tip_and_arms(
    turns: list[tuple[torch.Tensor, torch.Tensor]], links: list[Link]
) -> tuple[Vector, list[tuple[torch.Tensor, torch.Tensor]]]:
    """The tip in the first frame, and its x and y in every joint's own."""
    n = len(turns)
    x, y, z = links[n - 1][:3]
    arms = []
    for i in reversed(range(n)):
        s, c = turns[i]
        x, y = c * x - s * y, s * x + c * y
        arms.append((x, y))
        if i > 0:
            along, across, up, cosine, sine = links[i - 1]
            x, y, z = along + x, across + cosine * y - sine * z, up + sine * y + cosine * z
    return (x, y, z), arms[::-1]


def _error_and_columns(angles: list[torch.Tensor], target: Vector, links: list[Link]) -> tuple[Vector, list[Vector]]:
    (x, y, z), columns = tip_and_columns(sines(angles), links)
    return (x - target[0], y - target[1], z - target[2]), columns


def _inside(angle: torch.Tensor, step: torch.Tensor, bounds: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """1 where a joint may go that way, 0 where a limit stands in it."""
    at_limit = torch.logical_or(
        torch.logical_and(angle <= bounds[0], step < 0), torch.logical_and(angle >= bounds[1], step > 0)
    )
    return torch.where(at_limit, 0.0, 1.0).to(angle.dtype)


def _damped_step(
    columns: list[Vector], error: Vector, damping: torch.Tensor, shares: list[torch.Tensor] | None
) -> list[torch.Tensor]:
    xx = yy = zz = damping
    xy = xz = yz = torch.zeros_like(damping)
    for i, (x, y, z) in enumerate(columns):
        sx, sy, sz = (x, y, z) if shares is None else (shares[i] * x, shares[i] * y, shares[i] * z)
        xx, yy, zz = xx + sx * x, yy + sy * y, zz + sz * z
        xy, xz, yz = xy + sx * y, xz + sx * z, yz + sy * z
    # the adjugate of a symmetric matrix
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = -1.0 / (xx * a + xy * b + xz * c)
    ex, ey, ez = error
    pull = (
        scale * (a * ex + b * ey + c * ez),
        scale * (b * ex + d * ey + e * ez),
        scale * (c * ex + e * ey + f * ez),
    )
    step = [_dot(column, pull) for column in columns]
    return step if shares is None else [share * angle for share, angle in zip(shares, step, strict=True)]


def _chosen(take: torch.Tensor, new: Vector, old: Vector) -> Vector:
    return (torch.where(take, new[0], old[0]), torch.where(take, new[1], old[1]), torch.where(take, new[2], old[2]))


def _dot(a: Vector, b: Vector) -> torch.Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
