"""What a user can choose in the photometric stage."""

from dataclasses import dataclass

from treadlight.photometric.sps import MAX_REFINEMENTS


@dataclass(frozen=True)
class PhotometrySettings:
    """The config's section ``photometry``.

    Attributes
    ----------
    method : str
        map (`map_normals`) or sps (`sps`, algorithm 4 of the dissertation).
    max_refinements : int
        How often algorithm 4 takes the diffuse light out and fits again, at most.
    """

    method: str = "map"
    max_refinements: int = MAX_REFINEMENTS
