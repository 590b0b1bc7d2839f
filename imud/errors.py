"""What can go wrong, each with its exit code (docs/settings.md). A message says what, where, and what to do."""


class ImudError(Exception):
    """A failure that ends a command with a message and no traceback."""

    exit_code = 1


class UsageError(ImudError):
    exit_code = 64


class BadDataError(ImudError):
    exit_code = 65


class InputMissingError(ImudError):
    exit_code = 66


class DeviceAbsentError(ImudError):
    exit_code = 69


class CannotCreateError(ImudError):
    exit_code = 73


class InputOutputError(ImudError):
    exit_code = 74


class PermissionDeniedError(ImudError):
    exit_code = 77


class ConfigError(ImudError):
    exit_code = 78
