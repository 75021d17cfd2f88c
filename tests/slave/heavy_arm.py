"""The arm of NOTES with links that weigh something."""

from tests.root import ROOT

INERTIAL = (
    '<inertial><origin xyz="0.01 0 0.02" rpy="0.5 0 0.2"/><mass value="0.1"/>'
    '<inertia ixx="1e-5" ixy="0" ixz="2e-6" iyy="2e-5" iyz="0" izz="3e-5"/></inertial>'
)


def write_heavy_urdf(folder):
    """Write its URDF to a folder, with 0.1 kg a link, and return the file."""
    text = (ROOT / "configs" / "notes-arm.urdf").read_text()
    for name in ("upper", "lower", "hand"):
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{INERTIAL}')
    file = folder / "heavy.urdf"
    file.write_text(text)
    return file
