"""What a user may set of the integration."""

from dataclasses import dataclass


@dataclass(frozen=True)
class IntegrateSettings:
    """Settings of the integration.

    Attributes
    ----------
    held_out_every : int
        Every n-th laser section is kept out of a first solve and compared with it, before the
        profile is solved with all; 0 compares none.
    most_cells : int
        Cells that are solved together: wider ones where there would be more.
    """

    held_out_every: int = 10
    most_cells: int = 16_000_000
