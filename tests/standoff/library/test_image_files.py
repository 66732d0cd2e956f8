import errno
from pathlib import Path

import numpy as np
import pytest

from acquisition.photographs import write_float_tiff, write_mask
from standoff.errors import ImageFileError


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "o.tif"
    write_float_tiff(path, np.zeros((4, 5), np.float32), "first")
    before = path.read_bytes()

    def full_disk(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(ImageFileError) as refused:
        write_float_tiff(path, np.ones((4, 5), np.float32), "second")
    assert isinstance(refused.value.__cause__, OSError)
    assert refused.value.__cause__.errno == errno.ENOSPC
    assert path.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_mask_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImageFileError) as refused:
        write_mask(tmp_path / "nowhere" / "m.png", np.ones((4, 5), np.bool_))
    assert str(tmp_path / "nowhere" / "m.png") in str(refused.value)
