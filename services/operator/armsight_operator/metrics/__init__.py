"""What the services say of themselves, as OpenMetrics."""

from armsight_operator.metrics.registry import registry
from armsight_operator.metrics.server import MetricsServer
from armsight_operator.metrics.watch import Watch

__all__ = ["MetricsServer", "Watch", "registry"]
