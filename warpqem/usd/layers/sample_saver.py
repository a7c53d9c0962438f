"""Save the samples of a layer to its file while they are authored, so that they need no memory."""

from __future__ import annotations

from pxr import Sdf

from warpqem.errors import StageError

__all__ = ["SampleSaver"]

# Samples are saved when so many bytes of them are in memory.
UNSAVED_BYTES = 8 * 2**20
# A binary file has a time and a place in the file for each sample, 8 bytes each. They are written anew at each save,
# and may come to one byte in four.
SAMPLE_ENTRY_BYTES, TABLE_SHARE = 16, 4


class SampleSaver:
    """Saves a layer now and then: what is saved USD drops from memory, and reads from the file when asked for.

    To be called with the bytes of each sample that was authored. A layer in memory stays there.
    """

    def __init__(self, layer: Sdf.Layer) -> None:
        self._layer, self._unsaved, self._samples = layer, 0, 0

    def __call__(self, size: int) -> None:
        """A sample of so many bytes was authored.

        Raises:
            StageError: the layer cannot be written.
        """
        self._unsaved += size
        self._samples += 1
        # Each time the table of all samples is written again, so that it must not become most of what is written.
        if self._unsaved >= max(UNSAVED_BYTES, TABLE_SHARE * SAMPLE_ENTRY_BYTES * self._samples):
            self.save()

    def save(self) -> None:
        """Save what was authored since the last time.

        Raises:
            StageError: the layer cannot be written.
        """
        self._unsaved = 0
        if not self._layer.anonymous and not self._layer.Save():
            raise StageError(f"{self._layer.realPath}: USD cannot write it")
