r"""The report's inverse kinematics to the letter, section 4.2, on torch: gradient descent on the mean squared error.

.. math:: E(q) = \tfrac13 \sum (target - K(q))^2, \qquad
    q \leftarrow q - \alpha \frac{\partial E}{\partial q}, \qquad
    \frac{\partial E}{\partial q} = -\tfrac23 J(q)^T (target - K(q))

It ends when the mean absolute error over x, y and z is below the tolerance, or after so many steps. The gradient is
autograd's. The angles are kept inside the limits after every step. Joint 2 stays at 0.
"""

import torch

from armsight_control.chain import Array
from armsight_control.kinematics import Links
from armsight_control.solvers.options import GradientDescentOptions


def forward(links: Links, q: torch.Tensor) -> torch.Tensor:
    """The report's K(q) of theta, phi, psi, (3,): see :func:`armsight_control.kinematics.report_forward`."""
    (s_theta, s_phi, s_psi), (c_theta, c_phi, c_psi) = torch.sin(q).unbind(), torch.cos(q).unbind()
    l4_s, reach = links.l4 * s_psi, links.l4 * c_psi + links.l3
    return torch.stack(
        [
            c_theta * l4_s + s_theta * s_phi * reach,
            s_theta * l4_s - c_theta * s_phi * reach,
            c_phi * reach + links.l1,
        ]
    )


def gradient(links: Links, q: torch.Tensor, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The gradient of E at q by autograd, and the mean absolute error there."""
    q = q.detach().requires_grad_()
    error = target - forward(links, q)
    (slope,) = torch.autograd.grad((error * error).mean(), q)
    return slope, error.detach().abs().mean()


def descend(
    links: Links, limits: Array, target: Array, start: Array, options: GradientDescentOptions
) -> tuple[Array, int, bool]:
    """Descends from a configuration.

    Args:
        links: the lengths.
        limits: (3, 2), of theta, phi and psi.
        target: base frame, metres.
        start: theta, phi, psi.
        options: step size, tolerance, greatest number of steps.

    Returns:
        Theta, phi and psi, the number of steps, and whether the tolerance was met.
    """
    aim = torch.tensor(target, dtype=torch.float64)
    lower, upper = torch.tensor(limits, dtype=torch.float64).unbind(dim=1)
    q = torch.tensor(start, dtype=torch.float64)
    for iteration in range(options.max_steps):
        slope, error = gradient(links, q, aim)
        if error.item() < options.tolerance_m:
            return q.numpy(), iteration, True
        q = torch.clamp(q - options.alpha * slope, lower, upper)
    met = (aim - forward(links, q)).abs().mean().item() < options.tolerance_m
    return q.numpy(), options.max_steps, met
