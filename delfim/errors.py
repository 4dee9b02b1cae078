"""The five exceptions of Delfim. Foreign ones become one of these where they enter; loops do not catch, supervisors do."""


class DelfimError(Exception):
    """What a person can read and act on; the command line prints it without a traceback."""


class ConfigError(DelfimError):
    """A vehicle file or mission file that is not obeyed. Carries what a tired person needs to mend it."""

    def __init__(self, file: str, key: str, reason: str, allowed: str = "") -> None:
        self.file, self.key, self.reason, self.allowed = file, key, reason, allowed
        super().__init__(f"{file}: {key}: {reason}" + (f" (allowed: {allowed})" if allowed else ""))


class FormatError(DelfimError, ValueError):
    """Bytes or text from outside that do not mean anything: a malformed frame, message, command or log."""


class BusError(DelfimError, OSError):
    """A CAN bus that cannot be opened, went bus-off or went away."""


class Refused(DelfimError):
    """A command that was understood and not carried out; the text is the reason, in words for the operator."""


class PermanentFailure(DelfimError):
    """A service that must not be started again: trying harder cannot help (missing device file, wrong settings)."""


def in_words(error: BaseException) -> str:
    """What went wrong, for people: ours as it is, the system's without its number, and of a defect its kind, too."""
    if isinstance(error, DelfimError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return f"{type(error).__name__}: {error}".removesuffix(": ")
