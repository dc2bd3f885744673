"""Errors of the contract and the bus."""


class ArmsightError(Exception):
    """Base of every error that armsight raises on purpose: its text says what was wrong and what to do."""


class ConfigError(ArmsightError):
    """A flag, an environment variable or a configuration file that can't be used."""


class NoReplyError(ArmsightError):
    """Nobody answered a query in time."""


class RefusedError(ArmsightError):
    """A service refused a request: the text is the service's own reason."""


class SessionClosedError(ArmsightError):
    """The session ended while something was waiting on it."""


class ParameterError(ArmsightError):
    """A parameter that does not exist, or can't have this value; the text says what it may be."""
