"""Every estimator by its name, for `treadlight normals` and the benchmarks."""

from collections.abc import Callable, Mapping
from functools import partial

from treadlight.photometric.dps import dps, dps_l1
from treadlight.photometric.map import map_normals
from treadlight.photometric.nips import nips
from treadlight.photometric.observations import Estimate, Observations
from treadlight.photometric.sps import sps

Method = Callable[[Observations], Estimate]

METHODS: Mapping[str, Method] = {
    "map": map_normals,
    "sps": sps,
    "sps-2": partial(sps, algorithm=2),
    "sps-3": partial(sps, algorithm=3),
    "dps": dps,
    "dps-l1": dps_l1,
    "nips": nips,
}
