"""Numba's cache files with a checksum, so that a damaged one counts as absent.

Unpickled, a damaged file raises what it likes or ends the process in LLVM.
"""

import hashlib
import io
import logging
import os
from contextlib import contextmanager

from numba.core.caching import IndexDataCacheFile

_log = logging.getLogger(__name__)


class SealedFiles(IndexDataCacheFile):
    """Index and data files of one function; each ends in a digest of its name and content.

    A data file says which version of the function it is: after an index was lost, others may take its place.
    """

    def save(self, key, data):
        """Add a version of the function under its key."""
        super().save(key, (key, data))

    def load(self, key):
        """Return the version under a key, None if there is no sound one."""
        found = super().load(key)
        return found[1] if found is not None and found[0] == key else None

    def _load_index(self):
        return super()._load_index() if _is_sound(self._index_path) else {}

    def _load_data(self, name):
        if not _is_sound(self._data_path(name)):
            raise OSError  # which `load` takes for no file
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, path):
        content = io.BytesIO()
        yield content
        with super()._open_for_write(path) as file:
            file.write(content.getvalue() + _digest(path, content.getvalue()))


def _digest(path, content) -> bytes:
    return hashlib.sha256(os.path.basename(path).encode() + content).digest()


def _is_sound(path) -> bool:
    try:
        with open(path, "rb") as file:
            data = file.read()
    except OSError:
        return False
    size = hashlib.sha256().digest_size
    sound = data[-size:] == _digest(path, data[:-size])
    if not sound:
        _log.warning("%s: damaged; its kernels are compiled anew", path)
    return sound
