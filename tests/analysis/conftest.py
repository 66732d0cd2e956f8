from pathlib import Path

import pytest

from acquisition.session._reader import Session
from analysis.validation._document import Validation
from analysis.validation._session import validated
from calibration.files import read_psf, write_psf
from calibration.psf import PsfCalibration, edge_images, psf_of_images
from tests.analysis.bench_session import PSF, bench_session


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is asked of the session as slow: the first to ask waits until it is measured."""
    folder = Path(__file__).parent
    costly = {"session", "psf_path", "validation"}
    for item in items:
        used = item.fixturenames if isinstance(item, pytest.Function) else ()
        if item.path.is_relative_to(folder) and not costly.isdisjoint(used):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Edges and a texture at three heights; nobody may change it."""
    return bench_session(tmp_path_factory.mktemp("bench") / "series")


@pytest.fixture(scope="session")
def validation(session: Session) -> Validation:
    return validated(session, PSF, psf_name="psf.json")


@pytest.fixture(scope="session")
def psf_path(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("psf") / "psf.json"
    write_psf(path, psf_of_images(edge_images(session)))
    return path


@pytest.fixture(scope="session")
def psf(psf_path: Path) -> PsfCalibration:
    return read_psf(psf_path)
