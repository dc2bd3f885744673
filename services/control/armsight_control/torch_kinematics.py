"""Forward kinematics and Jacobians of any serial chain for batches on torch, in float64 or float32.

Not imported by the package itself: loading torch takes seconds. The mathematics is written column by column (one tensor
per joint and coordinate, all of one shape), the form in which the solvers' compiled blocks use it too.
"""

from collections.abc import Sequence

import torch

from armsight_control.chain import Chain
from armsight_control.errors import JointCountError
from armsight_control.folded import Folded, fold

Vector = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
Link = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""x, y, z, cos alpha and sin alpha of one link: see :class:`~armsight_control.folded.Folded`."""


def forward(chain: Chain, q: torch.Tensor) -> torch.Tensor:
    """The tip in the base frame, (..., 3) metres; arguments as :func:`tip_and_jacobian`."""
    return tip_and_jacobian(chain, q)[0]


def jacobian(chain: Chain, q: torch.Tensor) -> torch.Tensor:
    """The tip's derivative by the angles, (..., 3, n) metres per radian; arguments as :func:`tip_and_jacobian`."""
    return tip_and_jacobian(chain, q)[1]


def tip_and_jacobian(chain: Chain, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Both at once, in the precision of ``q``.

    Args:
        chain: the arm.
        q: (..., n) radians. Limits are not checked here.

    Raises:
        JointCountError: the last dimension is not the number of joints.
    """
    if q.shape[-1:] != (chain.count,):
        raise JointCountError(f"{q.shape[-1] if q.ndim else 0} angles for an arm of {chain.count} joints")
    folded = fold(chain, tuple(range(chain.count)), ())
    u = q + torch.as_tensor(folded.offsets, dtype=q.dtype)
    tip, columns = tip_and_columns(sines(u.unbind(-1)), links_of(folded, q.dtype))
    turn = torch.as_tensor(folded.R_base_first, dtype=q.dtype)
    tips = torch.stack(tip, dim=-1) @ turn.T + torch.as_tensor(folded.p_base_first, dtype=q.dtype)
    slopes = turn @ torch.stack([torch.stack(column, dim=-1) for column in columns], dim=-1)
    return tips, slopes


def links_of(folded: Folded, dtype: torch.dtype) -> list[Link]:
    """The links of a folded chain."""
    return split(torch.as_tensor(folded.links, dtype=dtype))


def split(links: torch.Tensor) -> list[Link]:
    """A tensor (n, 5) of links as scalars, once for all that is computed with them."""
    return [(x, y, z, cosine, sine) for x, y, z, cosine, sine in (link.unbind() for link in links.unbind())]


def sines(u: Sequence[torch.Tensor]) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Sine and cosine of every joint's angle."""
    return [(torch.sin(angle), torch.cos(angle)) for angle in u]


def tip_and_columns(
    turns: Sequence[tuple[torch.Tensor, torch.Tensor]], links: Sequence[Link]
) -> tuple[Vector, list[Vector]]:
    """The tip and the columns of its Jacobian in the frame of the first joint, from the tip inwards.

    Args:
        turns: of :func:`sines`, of u = q + offset.
        links: of every joint.
    """
    n = len(turns)
    nothing = torch.zeros_like(turns[0][0])
    x, y, z = (place + nothing for place in links[n - 1][:3])
    columns: list[Vector] = []
    for i in reversed(range(n)):
        s, c = turns[i]
        x, y = c * x - s * y, s * x + c * y
        columns = [(c * a - s * b, s * a + c * b, d) for a, b, d in columns]
        columns.insert(0, (-y, x, nothing))
        if i > 0:
            along, across, up, cosine, sine = links[i - 1]
            x, y, z = along + x, across + cosine * y - sine * z, up + sine * y + cosine * z
            columns = [(a, cosine * b - sine * d, sine * b + cosine * d) for a, b, d in columns]
    return (x, y, z), columns
