"""The exceptions that mavkf raises for a user's eyes.

MavkfError                 everything below; its text is one sentence that says the remedy
  UsageError               an option, key or value is wrong (command line: exit 2)
  InputError               a file or a stream cannot be used (command line: exit 1)
    LogError               ... because of what the log file is or holds
    EndpointError          ... because a port, host or device cannot be opened
"""


class MavkfError(Exception):
    """Base of all errors of this package."""


class UsageError(MavkfError):
    """A bad option, configuration key or value; the text names it and says what would be right."""


class InputError(MavkfError):
    """An input that cannot be used; the text says what is missing and what to do."""


class LogError(InputError):
    """A log file that cannot be read or holds nothing usable."""


class EndpointError(InputError):
    """A port, host, device or zenoh endpoint that cannot be opened."""
