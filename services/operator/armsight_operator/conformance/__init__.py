"""Whether a service on the bus fulfils the contract: the suite plays the other parts and judges what it says.

``judge``, ``scene`` and ``draw`` know no bus; ``station`` and a module for each kind of service ask and listen.
"""

from armsight_operator.conformance.check import Check, Outcome, Result
from armsight_operator.conformance.suite import OccupiedError, Suite, UnknownCheckError, run, suite_of

__all__ = ["Check", "OccupiedError", "Outcome", "Result", "Suite", "UnknownCheckError", "run", "suite_of"]
