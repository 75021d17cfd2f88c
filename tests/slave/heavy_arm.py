"""The arm of NOTES with links that weigh something."""

from tests.root import ROOT

INERTIAL = '<inertial><origin xyz="0.01 0 0.02"/><mass value="0.1"/></inertial>'


def write_heavy_urdf(folder):
    """Write its URDF to a folder, with 0.1 kg a link, and return the file."""
    text = (ROOT / "configs" / "notes-arm.urdf").read_text()
    for name in ("upper", "lower", "hand"):
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{INERTIAL}')
    file = folder / "heavy.urdf"
    file.write_text(text)
    return file
