"""Arrays in a file: what a stage reads and makes of a view may be larger than its memory."""

import mmap
import os
import tempfile
from pathlib import Path

import numpy as np


class Spool:
    """Makes arrays that lie in unnamed files of a folder; nothing is left there, even by a kill.

    Parameters
    ----------
    folder : Path
        On a disk with room for the arrays; made where it is not there.
    """

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._maps: list[mmap.mmap] = []

    def empty(self, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """An array whose content is undefined.

        Raises
        ------
        OSError
            The disk is full.
        """
        size = max(1, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        with tempfile.TemporaryFile(dir=self._folder) as file:
            # Taken now: a disk that is full later would end the process without a word.
            os.posix_fallocate(file.fileno(), 0, size)
            mapped = mmap.mmap(file.fileno(), size)
        self._maps.append(mapped)
        return np.frombuffer(mapped, dtype, count=int(np.prod(shape))).reshape(shape)

    def release(self) -> None:
        """Hand the memory of all arrays back; their content stays in the files."""
        for mapped in self._maps:
            mapped.madvise(mmap.MADV_DONTNEED)


class Memory:
    """As `Spool`, of arrays in memory."""

    def empty(self, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        return np.empty(shape, dtype)

    def release(self) -> None:
        pass


IN_MEMORY = Memory()
