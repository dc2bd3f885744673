"""The whole stack as processes of one machine: found, started, watched, restarted, gone when we are gone."""

from armsight_operator.stack.backoff import Backoff
from armsight_operator.stack.stack import NAMES, PAGE, Stack, free_port
from armsight_operator.stack.supervision import Death, Supervisor

__all__ = ["NAMES", "PAGE", "Backoff", "Death", "Stack", "Supervisor", "free_port"]
