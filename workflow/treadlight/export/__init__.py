"""What other programs read: meshes, pictures, areal parameters of a profile."""

from treadlight.export.areal import ArealParameters, areal_parameters, scale_limited
from treadlight.export.mesh import block_sides, coarser, coarser_grid, to_cartesian, triangles
from treadlight.export.patches import Patch, rib_patches
from treadlight.export.picture import height_picture
from treadlight.export.settings import ExportSettings

__all__ = [
    "ArealParameters",
    "ExportSettings",
    "Patch",
    "areal_parameters",
    "block_sides",
    "coarser",
    "coarser_grid",
    "height_picture",
    "rib_patches",
    "scale_limited",
    "to_cartesian",
    "triangles",
]
