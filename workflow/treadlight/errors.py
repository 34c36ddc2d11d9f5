"""The errors that a user can meet, each with one plain sentence as its message."""

_MAX_MESSAGE = 1000


def plain(text: str) -> str:
    """One printable line: what a file name or a value smuggles in is shown, never obeyed.

    Control characters, line breaks and undecodable bytes become escapes; what is too long for
    a sentence loses its middle.
    """
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(text) > _MAX_MESSAGE:
        text = f"{text[: _MAX_MESSAGE // 2]} ... {text[-_MAX_MESSAGE // 2 :]}"
    return text


class TreadlightError(Exception):
    """Anything that Treadlight refuses to do; the message is one plain sentence."""

    def __init__(self, message: str):
        super().__init__(plain(message))


class ConfigError(TreadlightError):
    """The config or the command line is wrong: nothing runs."""


class CaptureError(TreadlightError):
    """A capture cannot be used: it is left out, the others go on."""


class NoLineError(CaptureError):
    """No laser frame of a capture shows the laser's line."""


class CalibrationError(TreadlightError):
    """A calibration capture does not hold what a calibration needs."""


class StoreError(TreadlightError):
    """A product on disk is missing, incomplete or damaged."""


class MachineError(TreadlightError):
    """The machine gives a process too little; with more, the same command works."""


def sentence_of(error: BaseException) -> str:
    """What went wrong, in one line, for any error: never a traceback.

    A full disk, a missing right or too little memory are the machine's; what else is no
    `TreadlightError` is a defect, told with the place in the code that a report of it needs.
    """
    if isinstance(error, TreadlightError):
        return str(error)
    if isinstance(error, MemoryError):
        return "Not enough memory. Free some, or give the job more, and run the same command again."
    if isinstance(error, ImportError):
        return plain(
            f"A library cannot be loaded ({error}). Give the job more memory, or install again by"
            " make setup."
        )
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        reason = error.strerror or str(error)
        return plain(f"{place}{reason}. Mend that, and run the same command again.")
    return plain(
        f"Unexpected {type(error).__name__} ({error}) at {_place(error)}. This is a defect of"
        " Treadlight: please report this line."
    )


def _place(error: BaseException) -> str:
    """Module and line of the innermost frame of this package."""
    place, trace = "an unknown place", error.__traceback__
    while trace is not None:
        name = trace.tb_frame.f_globals.get("__name__", "")
        if name.split(".")[0] == __name__.split(".")[0]:
            place = f"{name}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return place
