"""Whether a service on the bus fulfils the contract: the suite plays the other parts and judges what it says.

``judge`` knows no bus: messages in, a fault out; ``station`` and ``control`` ask and listen.
"""

from armsight_operator.conformance.check import Check, Outcome, Result
from armsight_operator.conformance.suite import OccupiedError, Suite, UnknownCheckError, run, suite_of

__all__ = ["Check", "OccupiedError", "Outcome", "Result", "Suite", "UnknownCheckError", "run", "suite_of"]
