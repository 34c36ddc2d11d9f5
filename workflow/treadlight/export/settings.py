"""What a user may set of the exports."""

from dataclasses import dataclass

from treadlight.errors import ConfigError


@dataclass(frozen=True)
class ExportSettings:
    """Settings of the exports.

    Attributes
    ----------
    step_mm : float
        Cells of at least this size in every export but NetCDF; 0 = as measured.
    s_filter_mm, l_filter_mm : float
        Nesting indices of the Gaussian S-filter and L-filter (ISO 25178-3, ISO 16610-61) before
        areal parameters.
    """

    step_mm: float = 0.0
    s_filter_mm: float = 2.5
    l_filter_mm: float = 8.0

    def __post_init__(self) -> None:
        for name in ("step_mm", "s_filter_mm", "l_filter_mm"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
                raise ConfigError(f"export.{name} must be a number of at least 0. Got {value!r}.")
        if not 0 < self.s_filter_mm < self.l_filter_mm:
            raise ConfigError(
                "export.s_filter_mm must be above 0 and below export.l_filter_mm. Got"
                f" {self.s_filter_mm:g} and {self.l_filter_mm:g}."
            )
