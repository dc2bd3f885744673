"""Teaches a network how the tip of an arm moves with its joints.

armsight describe MODEL --json > arm.json
python examples/train_policy.py arm.json policy.pt

It learns from random poses alone what inverse kinematics has in formulas: the motion of the joints that brings the tip
nearer by what is missing, and no farther than needed. No example of a solution is shown to it.
"""

import json
import sys
from pathlib import Path

import torch
from google.protobuf.json_format import ParseDict

from armsight.v1.description_pb2 import ArmDescription
from armsight_control import Chain, arm_of
from armsight_control.torch_kinematics import jacobian

STEPS, BATCH = 3000, 512
SMALL = 0.3  # m²/rad²: what a motion may cost, so that none is large where the arm is stretched


class Policy(torch.nn.Module):
    """From the joints' angles (..., n) and what the tip lacks (..., 3) to the joints' motion (..., n)."""

    def __init__(self, joints: int) -> None:
        """Knows nothing yet."""
        super().__init__()
        layers = [torch.nn.Linear(2 * joints, 128), torch.nn.Tanh(), torch.nn.Linear(128, 128), torch.nn.Tanh()]
        self.gains = torch.nn.Sequential(*layers, torch.nn.Linear(128, 3 * joints))

    def forward(self, q: torch.Tensor, missing: torch.Tensor) -> torch.Tensor:
        """Nothing is missing: no motion, however little was learnt."""
        gains = self.gains(torch.cat([torch.sin(q), torch.cos(q)], dim=-1)).unflatten(-1, (-1, 3))
        motion: torch.Tensor = (gains @ missing.unsqueeze(-1)).squeeze(-1)
        return motion

    @staticmethod
    def read(file: str) -> "Policy":
        """As it was saved."""
        weights = torch.load(file, weights_only=True)
        policy = Policy(len(weights["gains.4.bias"]) // 3)
        policy.load_state_dict(weights)
        return policy


def trained(chain: Chain, seed: int = 0) -> Policy:
    """A policy for an arm."""
    torch.manual_seed(seed)
    policy, limits = Policy(chain.count), torch.as_tensor(chain.limits, dtype=torch.float32)
    optimiser = torch.optim.Adam(policy.parameters(), lr=2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for _ in range(STEPS):
        q = limits[:, 0] + torch.rand(BATCH, chain.count) * (limits[:, 1] - limits[:, 0])
        missing = torch.randn(BATCH, 3)
        motion = policy(q, missing)
        left = (jacobian(chain, q) @ motion.unsqueeze(-1)).squeeze(-1) - missing
        loss = (left**2).sum(-1).mean() + SMALL * (motion**2).sum(-1).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return policy


if __name__ == "__main__":
    described = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["description"]
    torch.save(trained(arm_of(ParseDict(described, ArmDescription())).chain).state_dict(), sys.argv[2])
