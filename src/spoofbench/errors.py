"""The errors that spoofbench raises on purpose: one base class, one sentence each."""


class SpoofbenchError(Exception):
    """Base of every error that a user can cause; its text is one sentence that says what to do."""


class RecordingError(SpoofbenchError):
    """A recording lacks what was asked of it, or was built from columns that do not fit
    together.
    """


class FormatError(SpoofbenchError):
    """A file is not what it claims to be, or is damaged."""


class LimitError(SpoofbenchError):
    """An input asks for more memory than the declared limits allow."""


class ConversionError(SpoofbenchError):
    """A raw log cannot be converted."""


class PluginError(SpoofbenchError):
    """A plugin cannot be found, loaded or used; the text names it, its distribution and the
    reason.
    """


class NotApplicable(SpoofbenchError):
    """An attack cannot be made on this recording, or a detector cannot be fitted on these; the task
    is skipped with this reason.
    """


class ConfigError(SpoofbenchError):
    """A value of a configuration is missing, unknown or invalid."""


class SuiteError(SpoofbenchError):
    """A suite file asks for something that does not exist or is invalid."""


class ResultsError(SpoofbenchError):
    """A results folder cannot be written, resumed or read."""
