"""What a user may set of the wear stage."""

from dataclasses import dataclass

from treadlight.errors import ConfigError


@dataclass(frozen=True)
class WearSettings:
    """Settings of the wear stage.

    Attributes
    ----------
    wear_limit_mm : float
        Tread depth at which the tire counts as worn out; projections run to it.
    break_in_km : float
        Captures before this mileage do not enter rates (ASTM F1016 leaves the break-in out).
    """

    wear_limit_mm: float = 1.6
    break_in_km: float = 0.0

    def __post_init__(self) -> None:
        for name in ("wear_limit_mm", "break_in_km"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
                raise ConfigError(f"wear.{name} must be a number of at least 0. Got {value!r}.")
