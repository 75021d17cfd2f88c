import pytest

from studies.rigs.models.board import COMPILER, compile_firmware


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """The firmware's protocol code, compiled for this machine."""
    if COMPILER is None:
        pytest.skip("no C++ compiler, so the firmware is not compiled")
    return compile_firmware(tmp_path_factory.mktemp("firmware"))
