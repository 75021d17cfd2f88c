"""An arm from the file that describes it."""

from pathlib import Path

from estimator.kinematics.arm import Arm, ArmError
from estimator.kinematics.urdf import URDF_BYTES_MAX, read_arm
from teleop.errors import UsageError
from teleop.runtime.files import read_small_file


def load_arm(path: str | Path, *, tip: str, base: str | None = None) -> Arm:
    """Return the chain of joints between two links of a URDF file.

    Parameters
    ----------
    path
        The file, of at most 5 MB; xacro is to be expanded before.
    tip, base
        Names of the links that are the tip and the base; the base is the root if None.

    Raises
    ------
    UsageError
        The file cannot be read, or holds no such arm; one line with place and remedy.
    """
    try:
        return read_arm(
            read_small_file(Path(path), URDF_BYTES_MAX), tip=tip, base=base, source=str(path)
        )
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ArmError as error:
        raise UsageError(str(error)) from None
