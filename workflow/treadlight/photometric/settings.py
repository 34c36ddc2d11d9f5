"""What a user can choose in the photometric stage."""

from dataclasses import dataclass

from treadlight.photometric.sps import MAX_REFINEMENTS


@dataclass(frozen=True)
class PhotometrySettings:
    """The config's section ``photometry``.

    Attributes
    ----------
    max_refinements : int
        How often algorithm 4 takes the diffuse light out and fits again, at most.
    """

    max_refinements: int = MAX_REFINEMENTS
