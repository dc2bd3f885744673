"""Errors of the operator's side: one clear line each, exit code 1."""

from armsight.errors import ArmsightError, ConfigError


class OperatorError(ArmsightError):
    """Base of what goes wrong on the operator's side."""


class MissingExecutableError(OperatorError):
    """A service's executable is not built or not installed."""


class PortInUseError(OperatorError):
    """Another process listens where the router should."""


class NoRouterError(OperatorError):
    """Nothing answers at the endpoint of the bus."""


class NoDataError(OperatorError):
    """Nothing was published in time."""


class CertificateError(OperatorError):
    """A key or certificate that is missing, in the way, or can't be used."""


class InsecureBindError(OperatorError, ConfigError):
    """A router would listen where anybody reaches it."""
