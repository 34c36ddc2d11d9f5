"""What a user may set of the registration."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CylinderSettings:
    """Settings of `register_to_cylinder`.

    Attributes
    ----------
    step_mm : float or None
        Step of the profile's grid along the tread, mm; None takes a pixel's size on the tread.
    """

    step_mm: float | None = None
