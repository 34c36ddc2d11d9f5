"""The errors that a user can meet, each with one plain sentence as its message."""


class TreadlightError(Exception):
    """Anything that Treadlight refuses to do; the message is one plain sentence."""


class ConfigError(TreadlightError):
    """The config is wrong: nothing runs."""


class CaptureError(TreadlightError):
    """A capture cannot be used: it is left out, the others go on."""


class CalibrationError(TreadlightError):
    """A calibration capture does not hold what a calibration needs."""


class StoreError(TreadlightError):
    """A product on disk is missing, incomplete or damaged."""
